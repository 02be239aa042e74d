"""Keyframe queries, and readers and writers of query files."""
