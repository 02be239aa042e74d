"""Keyframe search: runs, inverted lists, bitmaps, and what is done with hits."""
