"""Templates of an archive: learn them from clips, mirrored clips, files and combinations, and display them."""
