"""Test learned keyframe queries on takes with known segments: count the segments hit, frames kept, and labels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kinedex.catalog.classes import load_classes
from kinedex.ops.arrays import I64
from kinedex.ops.evaluation.metrics import Counts, compare
from kinedex.ops.keyframes.margins import hit_ranges
from kinedex.ops.words import TakeWords
from kinedex.pipelines.annotation.annotators import make_annotator
from kinedex.pipelines.annotation.batches import annotate_words
from kinedex.pipelines.engine.executors import Executor
from kinedex.pipelines.keyframes.query_learning import Outcome, keyframe_queries
from kinedex.pipelines.templates.template_learning import TrainingClips, learn_templates
from kinedex.storage.store.store import Store

CLIPS_A_TAKE = 9
DELTA, TAU = 0.05, 0.13
"""The parameters of the annotation; those of the thesis."""


@dataclass(frozen=True)
class Searched:
    """Takes to search: their words, and the segments (class, start, stop) of each take."""

    words: TakeWords
    segments: tuple[tuple[tuple[str, int, int], ...], ...]


@dataclass(frozen=True)
class Measured:
    """The results of one class's queries.

    Attributes
    ----------
    hit : int64 array (n, 2)
        For each of n segments 1 or 0, for a hit that touches it or none, and 1.
    kept : int64 array (T, 2)
        The frames kept and all frames of each take.
    covered : float
        The mean fraction of a segment that is kept.
    own : float
        The class's share of the frames.
    """

    label: str
    hit: I64
    kept: I64
    covered: float
    own: float

    @property
    def hit_share(self) -> float:
        """Return the fraction of the segments that are hit."""
        return float(self.hit[:, 0].mean())

    @property
    def kept_share(self) -> float:
        """Return the fraction of the frames that are kept."""
        return float(self.kept[:, 0].sum() / self.kept[:, 1].sum())


def joined(clips: Sequence[TrainingClips], seed: int) -> Searched:
    """Join clips in random order to takes of `CLIPS_A_TAKE` clips."""
    every = [(one.subclass, words) for one in clips for words in one.words]
    order = np.random.default_rng(seed).permutation(len(every)).tolist()
    pieces, segments = [], []
    for begin in range(0, len(order), CLIPS_A_TAKE):
        at, words, labels = 0, [], []
        for index in order[begin : begin + CLIPS_A_TAKE]:
            label, part = every[index]
            labels.append((label, at, at + len(part)))
            words.append(part)
            at += len(part)
        pieces.append(np.concatenate(words))
        segments.append(tuple(labels))
    offsets = np.concatenate([[0], np.cumsum([len(piece) for piece in pieces])]).astype(np.int64)
    return Searched(TakeWords(np.arange(len(pieces)), offsets, np.concatenate(pieces)), tuple(segments))


def with_ground_truth(store: Store) -> Searched | None:
    """Return the takes of the store that have manual labels, as an evaluation has stored them."""
    rows = store.result("ground_truth").to_pylist()
    ids = sorted({row["take_id"] for row in rows})
    if not ids:
        return None
    segments = [
        tuple((row["class"], row["start"], row["stop"]) for row in rows if row["take_id"] == take_id) for take_id in ids
    ]
    return Searched(store.words(ids), tuple(segments))


def measured(outcome: Outcome, searched: Searched, features: int) -> Measured | None:
    """Search one class's queries, and compare with the segments of the class; return None if it has none."""
    words = searched.words
    hits = np.zeros(len(words.words), bool)
    kept = np.zeros_like(hits)
    for chosen in outcome.chosen:
        takes, ranges = hit_ranges(words, chosen.query, features)
        for take, (start, stop) in zip(takes.tolist(), ranges.tolist(), strict=True):
            first, end = int(words.offsets[take]), int(words.offsets[take + 1])
            hits[first + start : first + stop] = True
            kept[max(first, first + start - chosen.left) : min(end, first + stop + chosen.right)] = True
    own = [
        slice(int(words.offsets[take]) + start, int(words.offsets[take]) + stop)
        for take, segments in enumerate(searched.segments)
        for label, start, stop in segments
        if label == outcome.subclass
    ]
    if not own:
        return None
    frames = np.diff(words.offsets)
    return Measured(
        outcome.subclass,
        np.array([[hits[piece].any(), 1] for piece in own], np.int64),
        np.stack([np.add.reduceat(kept.astype(np.int64), words.offsets[:-1]), frames], axis=1),
        float(np.mean([kept[piece].mean() for piece in own])),
        sum(piece.stop - piece.start for piece in own) / int(frames.sum()),
    )


def annotated(
    store: Store, clips: Sequence[TrainingClips], outcomes: Sequence[Outcome], searched: Searched, executor: Executor
) -> dict[str, Counts]:
    """Label the takes by the thesis's method within the frames that the queries keep, or in all frames without queries.

    Returns
    -------
    dict
        Class → the counts that compare its labels with the segments.
    """
    templates = [one for part in learn_templates(clips, ["soft"], _features(store), executor) for one in part]
    classes = load_classes("own", [one.subclass for one in clips])
    queries = [query for outcome in outcomes for query in keyframe_queries(outcome, store.feature_set)]
    annotator = make_annotator(store.feature_set, templates, classes, DELTA, TAU, queries)
    found = dict.fromkeys(annotator.classes, Counts())
    for take, segments in zip(annotate_words(annotator, searched.words), searched.segments, strict=True):
        for index, name in enumerate(annotator.classes):
            automatic = [(one.start, one.stop) for one in take.segments if one.class_index == index]
            manual = [(start, stop) for label, start, stop in segments if label == name]
            found[name] += compare(automatic, manual)
    return found


def _features(store: Store) -> int:
    return len(store.feature_set.features)
