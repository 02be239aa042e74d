"""Reconstruct takes from recordings of a depth camera (thesis, Chapter 8), for stages and commands."""
