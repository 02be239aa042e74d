"""Keyframe search: runs, inverted lists, bit slices, and the ranges around hits in which templates are matched."""
