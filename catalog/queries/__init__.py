"""Keyframe queries: the query itself, and query files that are read and written."""
