"""Annotate takes in batches: preselect frames by keyframe queries, label them, and compute distance curves."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import Any

import numpy as np
import polars as pl

from kinedex.ops.annotation.confidence import Confidence
from kinedex.ops.annotation.evidence import evidence_of
from kinedex.ops.annotation.segments import Segment
from kinedex.ops.arrays import F32, F64, I64, Bool
from kinedex.ops.distances.dtw import distance_curves
from kinedex.ops.words import TakeWords
from kinedex.pipelines.annotation.annotators import Annotator
from kinedex.pipelines.annotation.methods import Takes, whole_takes
from kinedex.pipelines.annotation.single_examples import PromisingRanges, ranges_by_example, words_fingerprint
from kinedex.pipelines.engine.executors import Executor, batches_of
from kinedex.pipelines.keyframes.preselected_frames import preselect, preselect_stored, ranges_around
from kinedex.storage.store.store import Store

BATCH_FRAMES = 50_000
"""The approximate number of analysis frames of a batch (28 minutes), whose curves take 400 kB per subclass."""


@dataclass(frozen=True)
class TakeAnnotation:
    """The annotation of one take.

    Attributes
    ----------
    take_id : int
        The take.
    segments : tuple of Segment
        The segments of the take, in the order of their starts.
    preselected : float64 array (S,)
        The fraction of the take's frames in which each subclass, or its template, was looked for.
    curves : float32 array (S, L), optional
        The distance curves, if they are stored; ∞ for templates that are not applied to the take.
    applied : bool array (S,), optional
        False for templates that were not applied because the take lacks too many of their features; None if all were.
    confidences : tuple of float, optional
        The probability that each segment has the right label; None where the annotator has no confidence.
    promising : PromisingRanges, optional
        The frames that each example could label, if examples serve as templates and all features are known.
    """

    take_id: int
    segments: tuple[Segment, ...]
    preselected: F64
    curves: F32 | None
    applied: Bool | None = None
    confidences: tuple[float, ...] | None = None
    promising: PromisingRanges | None = None


@dataclass(frozen=True)
class Batch:
    """The task of one worker: takes to annotate, the annotator, and promising ranges that are known already."""

    store: Store
    annotator: Annotator
    take_ids: tuple[int, ...]
    store_curves: bool
    code: str = ""
    earlier: Mapping[int, PromisingRanges] = field(default_factory=dict)


def annotate_stored(
    store: Store,
    annotator: Annotator,
    takes: pl.DataFrame,
    executor: Executor,
    store_curves: bool,
    code: str = "",
    earlier: Mapping[int, PromisingRanges] | None = None,
) -> Iterator[list[TakeAnnotation]]:
    """Annotate takes of a store in batches.

    Parameters
    ----------
    store : Store
        The store; workers read the same version of it.
    annotator : Annotator
        The annotator.
    takes : polars.DataFrame
        Rows of takes: take_id and frames.
    executor : Executor
        The workers.
    store_curves : bool
        True to return distance curves as well.
    code : str, optional
        A hash of the code that annotates; if given, promising ranges of examples are returned for a later run.
    earlier : mapping of int to PromisingRanges, optional
        The promising ranges of an earlier run by take_id, used for takes whose words have not changed.

    Yields
    ------
    list of TakeAnnotation
        The takes of a batch, in the order of take_id.
    """
    known = earlier or {}
    annotator.margins  # noqa: B018 - cached before the annotator is sent to the workers
    batches = [
        Batch(store, annotator, take_ids, store_curves, code, {one: known[one] for one in take_ids if one in known})
        for take_ids in split_takes(takes["take_id"].to_list(), takes["frames"].to_list())
    ]
    yield from executor.map(annotate_batch, batches)


def split_takes(take_ids: Iterable[int], frames: Iterable[int]) -> list[tuple[int, ...]]:
    """Divide takes into batches of at most `BATCH_FRAMES` frames; a longer take is a batch of its own."""
    lengths = dict(sorted(zip(take_ids, frames, strict=True)))
    return batches_of(lengths, lengths.values(), BATCH_FRAMES)


def annotate_batch(batch: Batch) -> list[TakeAnnotation]:
    """Read the words of a batch and annotate them, in a worker."""
    words = batch.store.words(batch.take_ids)
    if not batch.code:
        return annotate_words(batch.annotator, words, batch.store_curves, batch.store)
    prints = {
        take: words_fingerprint(words.take(place), batch.code) for place, take in enumerate(words.take_ids.tolist())
    }
    earlier = {take: one for take, one in batch.earlier.items() if one.fingerprint == prints[take]}
    return [
        one
        if one.promising is None
        else replace(one, promising=replace(one.promising, fingerprint=prints[one.take_id]))
        for one in annotate_words(batch.annotator, words, batch.store_curves, batch.store, earlier)
    ]


def annotate_words(
    annotator: Annotator,
    words: TakeWords,
    store_curves: bool = False,
    store: Store | None = None,
    earlier: Mapping[int, PromisingRanges] | None = None,
    positions: Sequence[F64] | None = None,
) -> list[TakeAnnotation]:
    """Annotate takes, with all templates at once.

    Parameters
    ----------
    annotator : Annotator
        The annotator.
    words : TakeWords
        The words of the takes.
    store_curves : bool
        True to return distance curves as well; segments do not need them.
    store : Store, optional
        The store of the takes; its index, if it has one, is used for keyframe search.
    earlier : mapping of int to PromisingRanges, optional
        The promising ranges of examples that are known from an earlier run, by take_id.
    positions : sequence of float64 arrays (L, J, 3), optional
        The positions of each take, if the method needs them; by default they are read from the store.

    Returns
    -------
    list of TakeAnnotation
        One for each take, in their order. Takes that lack features are annotated with the features they have.
    """
    needs = annotator.method.needs
    store_curves = store_curves and needs.templates != "none"
    if needs.positions and positions is None and store is not None:
        positions = stored_positions(store, words.take_ids.tolist(), words.frames.tolist())
    given = positions if positions is not None and needs.positions else ()
    if words.known is None:
        alike = _annotate_alike(annotator, words, given, store_curves, store, earlier)
        return _with_confidences(annotator, words, alike)
    found: dict[int, TakeAnnotation] = {}
    for mask in words.masks:
        places, own = words.knowing(mask)
        whole = mask & annotator.feature_set.every_bit == annotator.feature_set.every_bit
        partial, chosen = (annotator, np.arange(len(annotator.subclasses))) if whole else annotator.restricted(mask)
        known = earlier if whole else None
        some = [given[place] for place in places.tolist()] if given else ()
        alike = _nothing(own)
        if partial is not None:
            alike = _annotate_alike(partial, own, some, store_curves, store, known)
        made = alike if whole else [_of_all_templates(one, annotator, chosen, store_curves) for one in alike]
        found.update(zip(places.tolist(), made, strict=True))
    return _with_confidences(annotator, words, [found[place] for place in range(len(words))])


def stored_positions(store: Store, take_ids: Sequence[int], frames: Sequence[int]) -> list[F64]:
    """Return the positions of takes of a store, float64 (L, J, 3) each; takes may occur more than once."""
    lengths = {take_id: length for take_id, length in zip(take_ids, frames, strict=True) if length}
    read = store.positions([(take_id, 0, length) for take_id, length in lengths.items()])
    found = {take_id: own.astype(np.float64) for take_id, own in zip(lengths, read, strict=True)}
    return [found.get(take_id, np.empty((0, len(store.feature_set.joints), 3))) for take_id in take_ids]


def _with_confidences(annotator: Annotator, words: TakeWords, found: list[TakeAnnotation]) -> list[TakeAnnotation]:
    """Return annotations with the confidence of each segment, if the annotator computes confidences."""
    if annotator.method.offers.probabilities:
        return [replace(one, confidences=tuple(segment.margin for segment in one.segments)) for one in found]
    if annotator.confidence is None:
        return found
    sure = iter(confidences_of(annotator, annotator.confidence, [one.segments for one in found], words.offsets))
    return [replace(one, confidences=tuple(islice(sure, len(one.segments)))) for one in found]


def confidences_of(
    annotator: Annotator, confidence: Confidence, segments: Sequence[Sequence[Segment]], offsets: I64
) -> list[float]:
    """Return the probability that each segment has the right label, take by take.

    Parameters
    ----------
    annotator : Annotator
        The annotator that found the segments.
    confidence : Confidence
        The confidence, calibrated for it.
    segments : sequence of sequence of Segment, length T
        The segments of each take, in the order of their starts.
    offsets : int64 array (T + 1,)
        The first frame of each take in the concatenated words, followed by their total length.
    """
    classes = np.array([one.class_index for own in segments for one in own], np.int64)
    evidence = evidence_of(confidence.prior.evidence, segments, offsets, *annotator.shapes)
    found: list[float] = confidence.of(evidence, classes).tolist()
    return found


def _nothing(words: TakeWords) -> list[TakeAnnotation]:
    """Return annotations without segments, for takes to which no template applies."""
    return [
        TakeAnnotation(take_id, (), np.empty(0), np.empty((0, frames), np.float32))
        for take_id, frames in zip(words.take_ids.tolist(), words.frames.tolist(), strict=True)
    ]


def _of_all_templates(one: TakeAnnotation, annotator: Annotator, chosen: I64, store_curves: bool) -> TakeAnnotation:
    """Return an annotation by a subset of templates in the arrays of all templates."""
    count = len(annotator.subclasses)
    preselected, applied = np.zeros(count), np.zeros(count, np.bool_)
    preselected[chosen], applied[chosen] = one.preselected, True
    curves = None
    if store_curves and one.curves is not None:
        curves = np.full((count, one.curves.shape[1]), np.inf, np.float32)
        curves[chosen] = one.curves
    segments = tuple(replace(segment, subclass=int(chosen[segment.subclass])) for segment in one.segments)
    return TakeAnnotation(one.take_id, segments, preselected, curves, applied)


def _annotate_alike(
    annotator: Annotator,
    words: TakeWords,
    positions: Sequence[F64],
    store_curves: bool,
    store: Store | None,
    earlier: Mapping[int, PromisingRanges] | None,
) -> list[TakeAnnotation]:
    """Annotate takes in which all features of the annotator are known."""
    ranges = matched_ranges(annotator, words, store)
    curves = _curves(annotator, words, ranges) if store_curves else None
    method: Any = annotator.method
    takes, promising = Takes(words, ranges, positions), None
    if method.offers.keeps_ranges:
        places = method.promising(words, [(earlier or {}).get(take) for take in words.take_ids.tolist()])
        takes = replace(takes, promising=places)
        promising = [ranges_by_example(method.keys, own) for own in places]
    segments = method.annotate(takes)
    matched = np.array([_frames_within(one, words.offsets) for one in ranges], np.float64)
    found = []
    for index, take_id in enumerate(words.take_ids.tolist()):
        piece = slice(int(words.offsets[index]), int(words.offsets[index + 1]))
        found.append(
            TakeAnnotation(
                take_id,
                tuple(one for one in segments[index] if one.stop - one.start >= annotator.min_frames),
                matched[:, index] / max(piece.stop - piece.start, 1),
                None if curves is None else curves[:, piece].astype(np.float32),
                promising=None if promising is None else promising[index],
            )
        )
    return found


def matched_ranges(annotator: Annotator, words: TakeWords, store: Store | None = None) -> list[I64]:
    """Return the frames in which each template is matched: whole takes, or hits of its queries with their margins.

    Parameters
    ----------
    annotator : Annotator
        The templates and their queries.
    words : TakeWords
        The words of the takes, concatenated.
    store : Store, optional
        The store of the takes, whose index is searched if it has one.

    Returns
    -------
    list of int64 arrays (R, 2), length S
        Ascending half-open ranges of the words.
    """
    whole = whole_takes(words)
    wanted = list(dict.fromkeys(query for queries in annotator.queries for query in queries))
    hits = preselect(words, annotator.feature_set, wanted) if store is None else preselect_stored(store, words, wanted)
    return [
        ranges_around([hits[query] for query in queries], margins, words.offsets) if queries else whole
        for queries, margins in zip(annotator.queries, annotator.margins, strict=True)
    ]


def _curves(annotator: Annotator, words: TakeWords, ranges: Sequence[I64]) -> F64:
    """Compute all distance curves, float64 (S, L), in one pass for the templates that are matched in all frames."""
    curves = np.empty((len(annotator.templates), len(words.words)))
    everywhere = [index for index, queries in enumerate(annotator.queries) if not queries]
    if everywhere:
        chosen = [annotator.templates[index] for index in everywhere]
        curves[everywhere] = distance_curves(chosen, words.words, ranges[everywhere[0]])
    for index, queries in enumerate(annotator.queries):
        if queries:
            curves[index] = distance_curves([annotator.templates[index]], words.words, ranges[index])[0]
    return curves


def _frames_within(ranges: I64, offsets: I64) -> I64:
    """Return the number of frames of each take that lie in ascending ranges, int64 (T,)."""
    before = np.concatenate(([0], np.cumsum(ranges[:, 1] - ranges[:, 0])))
    place = np.searchsorted(ranges[:, 0], offsets, side="right")
    ends = np.concatenate(([0], ranges[:, 1]))
    covered: I64 = before[place] - np.maximum(ends[place] - offsets, 0)
    return np.diff(covered)
