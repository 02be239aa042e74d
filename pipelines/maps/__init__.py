"""The map of an archive: its takes or windows in two dimensions, with clusters and what sets each apart."""
