"""An oracle of the confusion of classes, frame by frame, with sets and fractions."""

from __future__ import annotations

from collections import defaultdict
from fractions import Fraction

Segment = tuple[str, int, int]


def confusion(mine: list[Segment], true: list[Segment], frames: int) -> dict[tuple[str, str], Fraction]:
    """(what it is, what it is labelled) → frames; "-": no label, "+": a label more than the other side has."""
    found: dict[tuple[str, str], Fraction] = defaultdict(Fraction)
    for frame in range(frames):
        wanted, labelled = ({label for label, start, stop in side if start <= frame < stop} for side in (true, mine))
        if not wanted and not labelled:
            found["-", "-"] += 1
        for label in wanted & labelled:
            found[label, label] += 1
        rows, columns = sorted(wanted - labelled), sorted(labelled - wanted)
        rows += ["+" if wanted else "-"] * (len(columns) - len(rows))
        columns += ["+" if labelled else "-"] * (len(rows) - len(columns))
        for row in rows:
            for column in columns:
                found[row, column] += Fraction(1, len(rows))
    return {pair: value for pair, value in found.items() if value}
