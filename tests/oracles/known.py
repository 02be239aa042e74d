"""Naive twins of what is known: features one by one, None for an unknown one, and no masks."""

from __future__ import annotations

from collections.abc import Sequence

from tests.oracles import dtw, keyframes

Seen = list[int | None]
"""The features of one frame: 0, 1, or None where the body lacks the joints."""

Column = Sequence[int | None]
"""The entries of a column or a keyframe: 0, 1, or None for a wildcard."""


def share(columns: Sequence[Column], frame: Seen) -> float:
    """The share of fixed entries whose feature is known."""
    fixed = [seen for column in columns for entry, seen in zip(column, frame, strict=True) if entry is not None]
    return sum(seen is not None for seen in fixed) / len(fixed) if fixed else 1.0


def is_applied(columns: Sequence[Column], frame: Seen) -> bool:
    return 5 * sum(1 for c in columns for e, s in zip(c, frame, strict=True) if None not in (e, s)) >= 3 * sum(
        1 for c in columns for e in c if e is not None
    )


def local_cost(column: Column, frame: Seen) -> float:
    """Contradicted entries as a share of those that are fixed and known; an unknown feature costs nothing."""
    both = [(entry, seen) for entry, seen in zip(column, frame, strict=True) if entry is not None and seen is not None]
    return sum(entry != seen for entry, seen in both) / len(both) if both else 0.0


def curve(columns: Sequence[Column], take: Sequence[Seen]) -> list[float]:
    """The distance curve with these local costs, by the recursion of `tests.oracles.dtw`."""
    costs = [[local_cost(column, frame) for frame in take] for column in columns]
    total: list[list[float]] = []
    for n, row in enumerate(costs):
        total.append([])
        for frame, cost in enumerate(row):
            ways = [total[k][m] + c for k, m, c in dtw._ways(n, frame, cost)]
            total[n].append(cost if n == 0 else min(ways, default=float("inf")))
    return [value / len(columns) for value in total[-1]]


def hits(
    chains: Sequence[tuple[Sequence[Column], Sequence[tuple[int, float]]]], take: Sequence[Seen]
) -> list[tuple[int, int]]:
    """The ranges of a query with alternatives in one take: entries on unknown features are not asked."""
    found: list[tuple[int, int]] = []
    for poses, gaps in chains:
        if take and not is_applied(poses, take[0]):
            continue
        matches = [
            [all(e is None or s is None or e == s for e, s in zip(pose, frame, strict=True)) for frame in take]
            for pose in poses
        ]
        found += [(start, stop - 1) for start, stop in keyframes.ranges_by_sets(matches, gaps)] if take else []
    return keyframes.covered(found)


def feature_runs(take: Sequence[Seen], feature: int) -> list[tuple[int, int]]:
    """The runs of a feature: of an unknown one there are none."""
    return keyframes.covered((n, n) for n, frame in enumerate(take) if frame[feature] == 1)
