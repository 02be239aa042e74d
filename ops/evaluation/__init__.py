"""This package evaluates results: precision and recall of labels, overlaps of segments, and rankings."""
