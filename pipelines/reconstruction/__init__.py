"""Reconstruction of recordings of a depth camera (thesis, Chapter 8): services of stages and commands."""
