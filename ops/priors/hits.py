"""This module finds hits of motion classes in a track, with the template column of each frame (thesis, 6.3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from kinedex.ops.annotation.segments import local_minima
from kinedex.ops.arrays import F64, I64
from kinedex.ops.distances.curve_path import curve_paths, essential_minima, least_curve
from kinedex.ops.distances.dtw import distance_curves
from kinedex.ops.errors import ParameterError
from kinedex.ops.templates.templates import QuantisedTemplate
from kinedex.ops.words import U64


@dataclass(frozen=True, eq=False)
class MotionHit:
    """An essential minimum of distance curves, with its warping path.

    Attributes
    ----------
    motion : int
        The index of the motion whose template fits.
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
        The essential minima of single curves that are not hits, the cheapest first: other motions for the same frames.

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
    places = {(hit.motion, hit.stop - 1): hit for hits in own for hit in hits}
    best = _essential([places[int(least.curves[end]), end] for end in ends.tolist()])
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
    """Return hits in frames of a recording whose words have another rate; columns are interpolated.

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
