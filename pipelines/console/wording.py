"""How counts and lists of names are put into words, on the terminal and in remarks."""

from __future__ import annotations

from collections.abc import Sequence

_MOST = 8

F_FRAMES, F_SEGMENTS = "F (frames)", "F (segments)"
"""Headings of the F-measures; the thesis calls them F1 and F2, and so do the keys of files."""

THESIS_NAMES = "F (frames) and F (segments) are F1 and F2 of the thesis (Section 5.4); P is precision, R recall"
"""The remark about these names, once per page or table."""


def few(names: Sequence[str]) -> str:
    """The names, or the first eight and how many more there are."""
    return ", ".join(names[:_MOST]) + (f" and {len(names) - _MOST} more" if len(names) > _MOST else "")


def counted(number: int, noun: str, plural: str | None = None) -> str:
    """Say how many of something there are."""
    return f"{number:,} {noun if number == 1 else plural or noun + 's'}"
