"""Track camera recordings, and stabilise the tracks with priors learned from the archive (thesis, Chapter 6)."""
