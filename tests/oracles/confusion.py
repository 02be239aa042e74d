"""An oracle of the confusion of classes, frame by frame, with sets and fractions."""

from __future__ import annotations

from collections import defaultdict
from fractions import Fraction

Segment = tuple[str, int, int]


def confusion(mine: list[Segment], true: list[Segment], frames: int) -> dict[tuple[str, str], Fraction]:
    """(what it is, what it is labelled) → frames; "-": no label, "+": a label more than the other side has."""
    found: dict[tuple[str, str], Fraction] = defaultdict(Fraction)
    for frame in range(frames):
        is_, said = ({label for label, start, stop in side if start <= frame < stop} for side in (true, mine))
        if not is_ and not said:
            found["-", "-"] += 1
        for label in is_ & said:
            found[label, label] += 1
        rows, columns = sorted(is_ - said), sorted(said - is_)
        rows += ["+" if is_ else "-"] * (len(columns) - len(rows))
        columns += ["+" if said else "-"] * (len(rows) - len(columns))
        for row in rows:
            for column in columns:
                found[row, column] += Fraction(1, len(rows))
    return {pair: value for pair, value in found.items() if value}
