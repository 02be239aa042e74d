"""Measures of results: precision and recall of labels, of overlaps, and of rankings."""
