"""Tracking of recordings, and its stabilisation by the archive (thesis, Chapter 6): services of stages and commands."""
