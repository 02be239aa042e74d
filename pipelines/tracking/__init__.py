"""Track recordings, and stabilise tracks by the archive (thesis, Chapter 6), for stages and commands."""
