"""Rank the places of whole archives by their distance to templates, and evaluate rankings."""
