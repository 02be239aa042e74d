"""This module finds the example clip that is most similar to an interval, and the frames of the clip that match."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kinedex.ops.arrays import F64, I64, U64
from kinedex.ops.distances.dtw import distance_curves
from kinedex.ops.errors import ParameterError
from kinedex.ops.ranking.best_hits import rank
from kinedex.ops.templates.templates import QuantisedTemplate
from kinedex.ops.templates.warping import align
from kinedex.ops.words import NO_WORD, TakeWords

_WORST = 2.0  # above every possible distance
_TWICE, _MORE = 2.0, 0.1  # the limit of a repetition's cost: a factor of the best cost, and an additional constant


@dataclass(frozen=True)
class NearestClip:
    """The clip that is nearest to an interval, with the warping path.

    Parameters
    ----------
    clip : int
        The index of the clip.
    cost : float
        The smallest distance within the interval of the clip, taken as a template without wildcards; ∞ if the interval
        is shorter than half of every clip.
    frames : int64 array (L,)
        For each frame of the interval the frame of the clip on the warping path. If the clip matches several times in a
        row, its frames are repeated. Frames of the interval without a match get the first or last frame of the clip.
    """

    clip: int
    cost: float
    frames: I64


def nearest_clips(clips: Sequence[U64], intervals: Sequence[U64], features: int) -> list[NearestClip]:
    """Find the nearest clip of each interval by subsequence DTW (thesis, Eq. 5.1 to 5.3).

    Parameters
    ----------
    clips : sequence of uint64 arrays (K,)
        The words of each clip.
    intervals : sequence of uint64 arrays (L,)
        The words of each interval.
    features : int
        The number of features of a word.

    Returns
    -------
    list of NearestClip
        The nearest clip of each interval; of equally near clips the first.

    Raises
    ------
    ParameterError
        If there is no clip, or a clip or an interval is empty.
    """
    if not clips or any(not len(words) for words in (*clips, *intervals)):
        raise ParameterError("clips and intervals", "at least one clip, and none of them empty", len(clips))
    if not intervals:
        return []
    offsets = np.concatenate(([0], np.cumsum([len(words) for words in intervals]))).astype(np.int64)
    laid = TakeWords(np.arange(len(intervals), dtype=np.int64), offsets, np.concatenate(intervals))
    templates = [_as_template(words, features) for words in clips]
    ranges = np.stack([offsets[:-1], offsets[1:]], axis=1)
    curves = distance_curves(templates, laid.words, ranges)
    least = np.stack([curves[:, start:stop].min(axis=1) for start, stop in ranges.tolist()])
    found: list[NearestClip | None] = [None] * len(intervals)
    for clip in np.unique(least.argmin(axis=1)).tolist():
        own = [place for place in range(len(intervals)) if least[place].argmin() == clip]
        short = [place for place in own if not np.isfinite(least[place, clip])]
        for place in short:  # short intervals are warped as a whole, since no clip fits in half of its length
            costs = [align(word_differences(words, intervals[place], features), *_ones(words, intervals[place])).cost
                     for words in clips]  # fmt: skip
            best = int(np.argmin(costs))
            found[place] = NearestClip(best, np.inf, _frames(clips[best], intervals[place], [], features))
        matches = _matches(templates[clip], laid)
        for place in (place for place in own if place not in short):
            frames = _frames(clips[clip], intervals[place], matches.get(place, []), features)
            found[place] = NearestClip(clip, float(least[place, clip]), frames)
    return [one for one in found if one is not None]


def _as_template(words: U64, features: int) -> QuantisedTemplate:
    """Convert a clip to a template without wildcards; invalid frames match everything."""
    mask = np.where(words == NO_WORD, np.uint64(0), np.uint64((1 << features) - 1))
    return QuantisedTemplate(mask, words & mask)


def _matches(template: QuantisedTemplate, intervals: TakeWords) -> dict[int, list[tuple[int, int]]]:
    """Return the non-overlapping ranges of each interval that match a clip, in order."""
    hits = rank(template, intervals, _WORST)
    found: dict[int, list[tuple[int, int]]] = {}
    best: dict[int, float] = {}
    for place, start, stop, cost in zip(
        hits.takes.tolist(), hits.starts.tolist(), hits.stops.tolist(), hits.costs.tolist(), strict=True
    ):
        if cost > _TWICE * best.setdefault(place, cost) + _MORE:
            continue
        own = found.setdefault(place, [])
        if all(stop <= begin or end <= start for begin, end in own):
            own.append((start, stop))
    return {place: sorted(own) for place, own in found.items()}


def _frames(clip: U64, interval: U64, matches: Sequence[tuple[int, int]], features: int) -> I64:
    """Return the matching frame of the clip for each frame of the interval."""
    frames = np.full(len(interval), -1, np.int64)
    for start, stop in matches or [(0, len(interval))]:
        part = interval[start:stop]
        path = align(word_differences(clip, part, features), *_ones(clip, part)).path
        frames[start + path[:, 1]] = path[:, 0]
    last = np.maximum.accumulate(np.where(frames >= 0, np.arange(len(frames)), -1))
    held: I64 = np.where(last >= 0, frames[last], 0)
    return held


def word_differences(clip: U64, interval: U64, features: int) -> F64:
    """Return the fraction of differing features between all pairs of frames of two motions.

    Parameters
    ----------
    clip : uint64 array (K,)
        The words of the first motion.
    interval : uint64 array (L,)
        The words of the second motion.
    features : int
        The number of features of a word.

    Returns
    -------
    float64 array (K, L)
        Fractions from 0 to 1; 1 if a frame is invalid.
    """
    differing = np.bitwise_count((clip[:, None] ^ interval[None, :]) & np.uint64((1 << features) - 1)) / features
    invalid = (clip == NO_WORD)[:, None] | (interval == NO_WORD)[None, :]
    costs: F64 = np.where(invalid, 1.0, differing)
    return costs


def _ones(clip: U64, interval: U64) -> tuple[F64, F64]:
    return np.ones(len(clip)), np.ones(len(interval))
