"""The names of the measures of an evaluation, in tables and on pages."""

from __future__ import annotations

F_FRAMES, F_SEGMENTS = "F (frames)", "F (segments)"
"""Headings of the F-measures; the thesis calls them F1 and F2, and so do the keys of files."""

THESIS_NAMES = "F (frames) and F (segments) are F1 and F2 of the thesis (Section 5.4); P is precision, R recall"
"""The remark that explains these names, shown once per page or table."""
