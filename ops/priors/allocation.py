"""This module assigns to each frame the hit that provides its priors, and the frame that provides a pose prior (6.4.1).

A hit is an interval of the take that matches the template of a motion. A pose prior of a frame is the pose of another
frame of the same take, which a better hit of the same motion contains.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from kinedex.ops.annotation.segments import local_minima
from kinedex.ops.arrays import F64, I64, U64, Bool
from kinedex.ops.distances.curve_path import curve_paths, essential_minima, least_curve
from kinedex.ops.distances.dtw import distance_curves
from kinedex.ops.errors import ParameterError
from kinedex.ops.priors.archive_poses import PriorMotion
from kinedex.ops.templates.templates import QuantisedTemplate

MIN_QUALITY = 0.1
"""The smallest quality of a hit; a hit's priors are weighted by its quality."""

POSE, ARCHIVE = "pose", "archive"
"""Kinds of priors other than the constraints of `ops.priors.constraints.CONSTRAINTS`."""


@dataclass(frozen=True, eq=False)
class MotionHit:
    """An essential minimum of distance curves, with its warping path.

    Attributes
    ----------
    motion : int
        The index of the motion whose template matches.
    start, stop : int
        The half-open range of frames of the path.
    cost : float
        The distance in its last frame.
    columns : float64 array (stop − start,)
        The column of the template in each frame.
    """

    motion: int
    start: int
    stop: int
    cost: float
    columns: F64


def find_hits(
    templates: Sequence[QuantisedTemplate], words: U64, threshold: float
) -> tuple[list[MotionHit], list[MotionHit]]:
    """Find the intervals of a take that resemble motions (thesis, Eq. 6.5 and 6.6, Section 6.4.1).

    Candidates are the local minima of a distance curve below the threshold, plateau frames included. They are reduced
    by `ops.distances.curve_path.essential_minima`.

    Parameters
    ----------
    templates : sequence of QuantisedTemplate
        The template of each motion.
    words : uint64 array (L,)
        The words of the take; `NO_WORD` where a frame is invalid.
    threshold : float
        τ > 0.

    Returns
    -------
    hits : list of MotionHit
        The essential minima of Δ^min, the cheapest first.
    alternatives : list of MotionHit
        The essential minima of single curves that are not hits, the cheapest first; these are other motions that may
        replace a hit in the same frames.

    Raises
    ------
    ParameterError
        If the threshold is not above 0.
    """
    if not threshold > 0:
        raise ParameterError("threshold", "above 0", threshold)
    curves = distance_curves(list(templates), words)
    own = [
        _candidates(template, words, motion, curve, local_minima(curve, threshold))
        for motion, (template, curve) in enumerate(zip(templates, curves, strict=True))
    ]
    least = least_curve(curves)
    ends = local_minima(least.costs, threshold)
    positions = {(hit.motion, hit.stop - 1): hit for hits in own for hit in hits}
    best = _essential([positions[int(least.curves[end]), end] for end in ends.tolist()])
    chosen = {id(hit) for hit in best}
    others = [hit for hits in own for hit in _essential(hits) if id(hit) not in chosen]
    return best, sorted(others, key=lambda hit: (hit.cost, hit.stop, hit.motion))


def _candidates(template: QuantisedTemplate, words: U64, motion: int, curve: F64, ends: I64) -> list[MotionHit]:
    """Return the minima of one curve with their paths."""
    return [
        MotionHit(motion, path.start, end + 1, float(curve[end]), path.columns)
        for end, path in zip(ends.tolist(), curve_paths(template, words, ends), strict=True)
    ]


def _essential(hits: Sequence[MotionHit]) -> list[MotionHit]:
    """Return the hits that have no cheaper hit close by, the cheapest first."""
    starts, ends = (np.array(column, np.int64) for column in ([h.start for h in hits], [h.stop - 1 for h in hits]))
    return [hits[place] for place in essential_minima(starts, ends, np.array([hit.cost for hit in hits])).tolist()]


def at_rate(hits: Sequence[MotionHit], words_rate_hz: float, rate_hz: float, frames: int) -> list[MotionHit]:
    """Convert hits from frames of words to frames of a recording with another rate; columns are interpolated.

    Parameters
    ----------
    hits : sequence of MotionHit
        Hits in frames of the words.
    words_rate_hz, rate_hz : float
        Frames per second of the words and of the recording; frame 0 of both is the same moment.
    frames : int
        The number of frames of the recording.

    Returns
    -------
    list of MotionHit
        The same hits in the same order; a hit covers the recorded frames from its first to its last frame.
    """
    step = words_rate_hz / rate_hz
    found = []
    for hit in hits:
        first = int(np.ceil(round(hit.start / step, 9)))
        last = min(int(np.floor(round((hit.stop - 1) / step, 9))), frames - 1)
        if last < first:  # a recording slower than its words may have no frame within a short hit
            first = last = min(first, frames - 1)
        columns = np.interp(np.arange(first, last + 1) * step, np.arange(hit.start, hit.stop), hit.columns)
        found.append(MotionHit(hit.motion, first, last + 1, hit.cost, columns))
    return found


def cut_to(hits: Sequence[MotionHit], frames: I64, least: float) -> list[MotionHit]:
    """Return the parts of hits that lie in the given frames.

    Parameters
    ----------
    hits : sequence of MotionHit
        Hits.
    frames : int64 array (F,)
        Ascending frames.
    least : float
        The smallest number of frames of a part.

    Returns
    -------
    list of MotionHit
        The parts in order of the hits, each with the columns of its frames.
    """
    runs = np.split(frames, np.flatnonzero(np.diff(frames) != 1) + 1) if len(frames) else []
    found = []
    for hit in hits:
        for run in runs:
            start, stop = max(hit.start, int(run[0])), min(hit.stop, int(run[-1]) + 1)
            if stop - start >= max(least, 1):
                found.append(
                    replace(hit, start=start, stop=stop, columns=hit.columns[start - hit.start :][: stop - start])
                )
    return found


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
        The frame whose pose is a prior of each frame, −1 for none.
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
        The threshold τ; the quality of a hit is max(`MIN_QUALITY`, 1 − cost / τ).

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
    qualities = np.maximum(MIN_QUALITY, 1.0 - costs / threshold)
    lenders = np.full(frames, -1, np.int64)
    for place, hit in enumerate(hits):
        source = _source(hits, place)
        if source >= 0:
            own = owners[hit.start : hit.stop] == place
            lenders[hit.start : hit.stop][own] = _lenders(hit, hits[source])[own]
    return Allocation(tuple(hits), owners, columns, qualities, lenders)


def _source(hits: Sequence[MotionHit], place: int) -> int:
    """Return the index of the cheapest hit of the same motion that is cheaper than a hit and does not overlap it.

    Return −1 if there is none.
    """
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
        The round of stabilisation, from 1.
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
        The factor by which the weights of the priors are multiplied.
    kept : bool
        False for priors that were withdrawn because they contradict the observations.
    reason : str
        The reason why the priors were withdrawn; empty if they were kept.
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
    motions: Sequence[PriorMotion],
    weights: Mapping[str, float],
    number: int,
    hit_numbers: Sequence[int],
) -> list[PriorRow]:
    """Return the assigned priors of a round as rows, hit by hit.

    Parameters
    ----------
    allocation : Allocation
        The hits of the frames.
    motions : sequence of PriorMotion
        The motions of the archive.
    weights : mapping of str to float
        The factor of each kind of priors that is used: "archive", "pose" and constraints.
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
