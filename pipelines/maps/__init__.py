"""Compute the map of an archive: its takes or windows in two dimensions, with clusters and their characteristics."""
