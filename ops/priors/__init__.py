"""Priors that an archive lends to a track (thesis, Sections 6.3 and 6.4)."""
