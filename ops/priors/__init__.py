"""This package stabilises tracks by priors learned from an archive (thesis, Sections 6.3 and 6.4)."""
