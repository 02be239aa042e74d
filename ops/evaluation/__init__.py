"""How good it is: precision and recall of labels, of overlaps, of rankings."""
