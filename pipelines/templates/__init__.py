"""Templates of an archive: learning from clips, mirrored clips, files and combinations, and their display."""
