"""This module assigns to each frame the hit that gives its priors, and the frame whose pose it uses (thesis, 6.4.1)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kinedex.ops.arrays import F64, I64, Bool
from kinedex.ops.priors.hits import MotionHit
from kinedex.ops.priors.motion import Motion

LEAST_QUALITY = 0.1
"""The smallest quality of a hit; a hit's priors are weighted by its quality."""

POSE, ARCHIVE = "pose", "archive"
"""Kinds of priors other than the constraints of `ops.priors.constraints.CONSTRAINTS`."""


@dataclass(frozen=True, eq=False)
class Allocation:
    """The hit that is assigned to each frame.

    Attributes
    ----------
    hits : tuple of MotionHit
        The hits, in frames of the recording.
    owners : int64 array (T,)
        The hit of lowest cost that covers each frame, −1 for none.
    columns : int64 array (T,)
        The column of the hit's template, −1 for none.
    qualities : float64 array (H,)
        The quality of each hit.
    lenders : int64 array (T,)
        The frame whose pose serves as a prior for each frame, −1 for none.
    """

    hits: tuple[MotionHit, ...]
    owners: I64
    columns: I64
    qualities: F64
    lenders: I64

    def frames(self, hit: int) -> I64:
        """Return the frames whose priors come from a hit."""
        return np.flatnonzero(self.owners == hit)


def allocate(hits: Sequence[MotionHit], frames: int, threshold: float) -> Allocation:
    """Assign to each frame the hit of lowest cost that covers it, and the frame whose pose is its prior.

    Parameters
    ----------
    hits : sequence of MotionHit
        The hits; ties go to the first.
    frames : int
        The number of frames T.
    threshold : float
        τ, which the quality max(`LEAST_QUALITY`, 1 − cost / τ) of a hit is measured against.

    Returns
    -------
    Allocation
    """
    owners, columns = np.full(frames, -1, np.int64), np.full(frames, -1, np.int64)
    costs = np.array([hit.cost for hit in hits], np.float64)
    # the cheapest hit is written last, so it overwrites the others
    for place in np.argsort(costs, kind="stable")[::-1].tolist():
        hit = hits[place]
        owners[hit.start : hit.stop] = place
        columns[hit.start : hit.stop] = np.rint(hit.columns).astype(np.int64)
    qualities = np.maximum(LEAST_QUALITY, 1.0 - costs / threshold)
    lenders = np.full(frames, -1, np.int64)
    for place, hit in enumerate(hits):
        source = _source(hits, place)
        if source >= 0:
            own = owners[hit.start : hit.stop] == place
            lenders[hit.start : hit.stop][own] = _lenders(hit, hits[source])[own]
    return Allocation(tuple(hits), owners, columns, qualities, lenders)


def _source(hits: Sequence[MotionHit], place: int) -> int:
    """Return the cheapest hit of the same motion that costs less and does not overlap, −1 if there is none."""
    hit, best = hits[place], -1
    for other, lender in enumerate(hits):
        if lender.motion != hit.motion or not lender.cost < hit.cost:
            continue
        apart = lender.stop <= hit.start or hit.stop <= lender.start
        if apart and (best < 0 or lender.cost < hits[best].cost):
            best = other
    return best


def _lenders(hit: MotionHit, source: MotionHit) -> I64:
    """Return for each frame of a hit the frame of another hit with the nearest column; ties go to the earliest."""
    apart = np.abs(np.rint(source.columns)[None, :] - np.rint(hit.columns)[:, None])
    return source.start + apart.argmin(axis=1)


@dataclass(frozen=True)
class PriorRow:
    """An interval of frames that received priors of one kind.

    Attributes
    ----------
    round : int
        The round, from 1.
    kind : str
        "archive", "pose", or a constraint.
    side : str
        "left" or "right" of a constraint, else empty.
    motion : str
        The name of the motion.
    hit : int
        The number of the hit in its round.
    start, stop : int
        The half-open range of frames.
    first_column, last_column : int
        The columns in the first and the last of these frames.
    cost : float
        The distance of the hit.
    weight : float
        The factor of the weights of the priors.
    kept : bool
        False for priors that the guard withdrew.
    reason : str
        The reason why they were withdrawn; empty if they were kept.
    """

    round: int
    kind: str
    side: str
    motion: str
    hit: int
    start: int
    stop: int
    first_column: int
    last_column: int
    cost: float
    weight: float
    kept: bool = True
    reason: str = ""


def prior_rows(
    allocation: Allocation,
    motions: Sequence[Motion],
    weights: Mapping[str, float],
    number: int,
    hit_numbers: Sequence[int],
) -> list[PriorRow]:
    """Return the assigned priors of a round as rows, hit by hit.

    Parameters
    ----------
    allocation : Allocation
        The hits of the frames.
    motions : sequence of Motion
        The motions of the archive.
    weights : mapping of str to float
        The factor of each kind that is used: "archive", "pose" and constraints.
    number : int
        The round, from 1.
    hit_numbers : sequence of int
        The number of each hit in its round.
    """
    rows = []
    for place, hit in enumerate(allocation.hits):
        motion, frames = motions[hit.motion], allocation.frames(place)
        columns, quality = allocation.columns[frames], float(allocation.qualities[place])
        regions: list[tuple[str, str, Bool]] = []
        if ARCHIVE in weights and motion.poses is not None:
            regions.append((ARCHIVE, "", np.ones(len(frames), np.bool_)))
        elif POSE in weights:
            regions.append((POSE, "", allocation.lenders[frames] >= 0))
        regions += [
            (mark.constraint, mark.side, (columns >= mark.start) & (columns < mark.stop))
            for mark in motion.marks
            if mark.constraint in weights
        ]
        for kind, side, marked in regions:
            own, at = frames[marked], columns[marked]
            weight = quality * weights[kind]
            for part in np.split(np.arange(len(own)), np.flatnonzero(np.diff(own) != 1) + 1):
                if len(part):
                    (first, last), (low, high) = own[part[[0, -1]]].tolist(), at[part[[0, -1]]].tolist()
                    rows.append(
                        PriorRow(
                            number, kind, side, motion.name, hit_numbers[place], first, last + 1, low, high, hit.cost,
                            weight,
                        )
                    )  # fmt: skip
    return rows
