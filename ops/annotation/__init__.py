"""Annotation: from distance curves to labelled segments, frame by frame or for a whole take at once."""
