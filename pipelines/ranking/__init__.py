"""Ranking of whole archives, and its evaluation."""
