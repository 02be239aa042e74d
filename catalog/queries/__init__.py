"""This package defines keyframe queries, and reads and writes query files."""
