"""Figures of this checkout beside those of another commit, measured in one run by turns."""
