"""Track camera recordings, stabilise tracks by priors (thesis, Chapter 6), and store takes made of recordings."""
