"""Annotating takes in batches: curves, preselection by keyframes, labels."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt
import polars as pl

from kinedex.ops.annotation.decoding import confidences, explain, lay_columns
from kinedex.ops.annotation.segment_costs import least_costs
from kinedex.ops.annotation.segments import Matches, Segment, annotate
from kinedex.ops.distances.costs import encode
from kinedex.ops.distances.dtw import distance_curves
from kinedex.ops.distances.pruning import Coarse, coarse_bounds
from kinedex.ops.distances.range_minima import minima_within
from kinedex.ops.words import TakeWords
from kinedex.pipelines.annotation.annotators import Annotator, Row
from kinedex.pipelines.engine.executors import Executor
from kinedex.pipelines.search.preselection import preselect, preselect_stored, ranges_around
from kinedex.storage.store.store import Store, open_store

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]

BATCH_FRAMES = 50_000
"""Analysis frames (28 minutes) whose curves are held at once, 400 kB a subclass."""

NARROW = 4
"""Bounds look for where a template may fit, unless its ranges are no more than one frame in so many."""


@dataclass(frozen=True)
class TakeAnnotation:
    """What was found in one take. curves: float32 (S, L), or None where they are not kept; preselected: float64 (S,),
    the share of the take's frames that each template was matched in."""

    take_id: int
    segments: tuple[Segment, ...]
    preselected: F64
    curves: F32 | None


@dataclass(frozen=True)
class Batch:
    """Takes that one worker annotates."""

    store: Path
    annotator: Annotator
    take_ids: tuple[int, ...]
    keep_curves: bool


def annotate_takes(
    store: Path, annotator: Annotator, takes: pl.DataFrame, executor: Executor, keep_curves: bool
) -> Iterator[list[TakeAnnotation]]:
    """Annotate takes batch by batch; each batch in order of take_id."""
    annotator.reach  # noqa: B018 - found once, and goes with the annotator to the workers
    batches = [
        Batch(store, annotator, take_ids, keep_curves)
        for take_ids in split_takes(takes["take_id"].to_list(), takes["frames"].to_list())
    ]
    yield from executor.map(annotate_batch, batches)


def split_takes(take_ids: Iterable[int], frames: Iterable[int]) -> list[tuple[int, ...]]:
    """Divide takes into batches of about `BATCH_FRAMES`, a longer take on its own."""
    batches: list[list[int]] = []
    room = 0
    for take_id, length in sorted(zip(take_ids, frames, strict=True)):
        if not batches or length > room:
            batches.append([])
            room = BATCH_FRAMES
        batches[-1].append(take_id)
        room -= length
    return [tuple(batch) for batch in batches]


def annotate_batch(batch: Batch) -> list[TakeAnnotation]:
    """Read the words of a batch and annotate them (runs in a worker)."""
    store = open_store(batch.store)
    return annotate_words(batch.annotator, store.words(batch.take_ids), batch.keep_curves, store)


def annotate_words(
    annotator: Annotator, words: TakeWords, keep_curves: bool = False, store: Store | None = None
) -> list[TakeAnnotation]:
    """Annotate takes, all templates against all words at once; keyframes are looked for in the index of the store that
    the takes are from, where it has one."""
    ranges = ranges_of(annotator, words, store)
    # minima below τ are found without the curves, and so are rows; they are only drawn
    curves = _curves(annotator, words, ranges) if keep_curves else None
    if annotator.row is not None:
        segments = _explained_takes(annotator, annotator.row, words, ranges)
    else:
        matches = _matches(annotator, words, ranges)
        segments = annotate(matches, annotator.class_index, words.offsets, annotator.thresholds)
    kept = np.array([_frames_within(one, words.offsets) for one in ranges], np.float64)
    found = []
    for index, take_id in enumerate(words.take_ids.tolist()):
        piece = slice(int(words.offsets[index]), int(words.offsets[index + 1]))
        found.append(
            TakeAnnotation(
                take_id,
                tuple(one for one in segments[index] if one.stop - one.start >= annotator.min_frames),
                kept[:, index] / max(piece.stop - piece.start, 1),
                None if curves is None else curves[:, piece].astype(np.float32),
            )
        )
    return found


def _matches(annotator: Annotator, words: TakeWords, ranges: Sequence[I64]) -> Matches:
    """The minima of all templates below the thresholds of their classes.

    A neighbour at τ or above never keeps a frame from being a minimum below τ, so the minima are those of the curves.
    """
    taus = annotator.thresholds[annotator.class_index]
    coded = encode(words.words)
    wide = [s for s, own in enumerate(ranges) if NARROW * int((own[:, 1] - own[:, 0]).sum()) > len(words.words)]
    coarse: list[Coarse | None] = [None] * len(ranges)
    whole = np.stack([words.offsets[:-1], words.offsets[1:]], axis=1)
    for s, bound in zip(
        wide, coarse_bounds([annotator.templates[s] for s in wide], coded, taus[wide], whole), strict=True
    ):
        coarse[s] = bound
    return minima_within(annotator.templates, words.words, taus, ranges, coded, coarse)


def _explained_takes(annotator: Annotator, row: Row, words: TakeWords, ranges: Sequence[I64]) -> list[list[Segment]]:
    """The segments of the best explanation of each take; cost: the least distance within, NaN where no path ends
    there."""
    columns = lay_columns(row.templates, row.usual, row.decoding)
    takes, sure = [], []
    places = [_places_of_takes(one, words.offsets) for one in ranges] if any(annotator.queries) else None
    for take, (start, stop) in enumerate(pairwise(words.offsets.tolist())):
        own, within = words.words[start:stop], None
        if places is not None:
            pieces = zip(ranges, places, strict=True)
            within = [np.clip(one[slice(*place[take])] - start, 0, stop - start) for one, place in pieces]
        found = explain(row.templates, row.usual, own, row.decoding, within, columns)
        sure.append(confidences(found, row.templates, annotator.class_index, row.usual, own, row.decoding, columns))
        takes.append(found)
    every = [
        (one.template, one.start + first, one.stop + first)
        for found, first in zip(takes, words.offsets.tolist(), strict=False)
        for one in found
    ]
    chosen = np.array(every, np.int64).reshape(-1, 3)
    costs = least_costs(annotator.templates, words.words, ranges, *chosen.T)
    costs[np.isinf(costs)] = np.nan
    cost = iter(costs.tolist())
    return [
        [
            Segment(one.start, one.stop, int(annotator.class_index[one.template]), next(cost), one.template, confidence)
            for one, confidence in zip(found, own.tolist(), strict=True)
        ]
        for found, own in zip(takes, sure, strict=True)
    ]


def ranges_of(annotator: Annotator, words: TakeWords, store: Store | None = None) -> list[I64]:
    """The frames that each template is matched in, on the words laid end to end: whole takes, or the hits of its
    queries with their margins."""
    whole = np.stack([words.offsets[:-1], words.offsets[1:]], axis=1)
    wanted = list(dict.fromkeys(query for queries in annotator.queries for query in queries))
    if store is None:
        hits = preselect(words, annotator.feature_set, wanted)
    else:
        hits = preselect_stored(store, words, wanted)
    ranges = []
    for queries, reach in zip(annotator.queries, annotator.reach, strict=True):
        if not queries:
            ranges.append(whole)
            continue
        ranges.append(ranges_around([hits[query] for query in queries], reach, words.offsets))
    return ranges


def _curves(annotator: Annotator, words: TakeWords, ranges: Sequence[I64]) -> F64:
    """All curves; the templates that are matched everywhere in one pass."""
    curves = np.empty((len(annotator.templates), len(words.words)))
    everywhere = [index for index, queries in enumerate(annotator.queries) if not queries]
    if everywhere:
        chosen = [annotator.templates[index] for index in everywhere]
        curves[everywhere] = distance_curves(chosen, words.words, ranges[everywhere[0]])
    for index, queries in enumerate(annotator.queries):
        if queries:
            curves[index] = distance_curves([annotator.templates[index]], words.words, ranges[index])[0]
    return curves


def _places_of_takes(ranges: I64, offsets: I64) -> list[tuple[int, int]]:
    """Of ascending ranges that are apart, which [first, last) have frames of each take."""
    firsts = np.searchsorted(ranges[:, 1], offsets[:-1], side="right")
    lasts = np.searchsorted(ranges[:, 0], offsets[1:], side="left")
    return list(zip(firsts.tolist(), lasts.tolist(), strict=True))


def _frames_within(ranges: I64, offsets: I64) -> I64:
    """How many frames of each take lie in ascending ranges that are apart, int64 (takes,)."""
    before = np.concatenate(([0], np.cumsum(ranges[:, 1] - ranges[:, 0])))
    place = np.searchsorted(ranges[:, 0], offsets, side="right")
    ends = np.concatenate(([0], ranges[:, 1]))
    covered: I64 = before[place] - np.maximum(ends[place] - offsets, 0)
    return np.diff(covered)
