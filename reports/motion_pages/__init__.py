"""Pages of motions that commands write: hits, takes and templates as moving figures, and strips of pictures."""

FIGURES = 60
"""The default number of figures of a page or a picture; a page with as many has a few megabytes at most."""
