"""This package searches, explains and proposes keyframe queries, and learns them from clips."""
