"""The measures of the thesis (Eq. 5.8 to 5.12) with Python sets."""

from __future__ import annotations

import math

Segments = dict[str, list[tuple[int, int]]]  # class → half-open ranges


def frames(segments: Segments) -> set[tuple[int, str]]:
    return {(n, p) for p, ranges in segments.items() for start, stop in ranges for n in range(start, stop)}


def measures(automatic: Segments, manual: Segments) -> dict[str, float]:
    a, m = frames(automatic), frames(manual)

    def ratio(part: int, whole: int) -> float:
        return part / whole if whole else math.nan

    def overlapping(mine: Segments, theirs: set[tuple[int, str]]) -> int:
        every = [(p, one) for p, ranges in mine.items() for one in ranges]
        return sum(any((n, p) in theirs for n in range(*one)) for p, one in every)

    return {
        "p1": ratio(len(a & m), len(a)),
        "r1": ratio(len(a & m), len(m)),
        "p2": ratio(overlapping(automatic, m), sum(map(len, automatic.values()))),
        "r2": ratio(overlapping(manual, a), sum(map(len, manual.values()))),
    }
