"""Ranking of whole archives, and how good it is."""
