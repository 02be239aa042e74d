"""Learning keyframe queries from examples (thesis, Chapter 4)."""
