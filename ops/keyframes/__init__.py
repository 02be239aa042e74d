"""This package learns keyframe queries from examples (thesis, Chapter 4)."""
