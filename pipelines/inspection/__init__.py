"""Inspect motion, depth and sensor files: their content, how they are read, and duplicates among takes."""
