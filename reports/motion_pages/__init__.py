"""Pages of motions that commands write: hits, takes and templates as moving figures, and strips of pictures."""

FIGURES = 60
"""Figures of a page or a picture unless more are asked for; a page of so many has a few megabytes at most."""
