"""This package reconstructs full-body motion from one depth camera (thesis, Chapter 8)."""
