"""Annotation turns distance curves into labelled segments, frame by frame or for a whole take at once."""
