"""This package computes the map of an archive: descriptions of takes and windows, a layout in 2D, and clusters."""
