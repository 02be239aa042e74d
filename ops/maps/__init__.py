"""The map of an archive: numbers of takes and windows, their places in two dimensions, and clusters."""
