"""This module formats counts, lists of names, values and durations as text for the terminal, pages and messages."""

from __future__ import annotations

import math
from collections.abc import Sequence

_MOST = 8


def few(names: Sequence[str]) -> str:
    """Join names with commas; of more than eight, only the first eight, and the number of the others."""
    return ", ".join(names[:_MOST]) + (f" and {len(names) - _MOST} more" if len(names) > _MOST else "")


def digits(value: float | None) -> str:
    """Return a value with two digits, or a dash for None."""
    return "–" if value is None or math.isnan(value) else f"{value:.2f}"


def counted(number: int, noun: str, plural: str | None = None) -> str:
    """Return a count with its noun: "1 take", "2,000 takes"."""
    return f"{number:,} {noun if number == 1 else plural or noun + 's'}"


def duration(seconds: float) -> str:
    """Return a duration in its two largest units: "40 s", "3 min 20 s", "2 h 5 min"."""
    whole = max(1, round(seconds))
    if whole < 60:
        return f"{whole} s"
    minutes, rest = divmod(whole, 60)
    if minutes < 60:
        return f"{minutes} min {rest} s" if minutes < 10 and rest else f"{minutes} min"
    return f"{minutes // 60} h {minutes % 60} min"
