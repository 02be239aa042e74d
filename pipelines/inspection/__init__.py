"""Inspect motion, depth and sensor files before they are read, and archives: duplicates, and the map of takes."""
