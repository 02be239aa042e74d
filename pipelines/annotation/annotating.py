"""Annotating takes in batches: curves, preselection by keyframes, labels; and the tables of results."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt
import polars as pl
import pyarrow as pa

from catalog.classes import Classes
from catalog.features import FeatureSet
from catalog.queries import KeyframeQuery
from ops.distances.annotation import Matches, Segment, annotate
from ops.distances.costs import encode
from ops.distances.decoding import Decoding, confidences, explain, lay_columns
from ops.distances.dtw import distance_curves
from ops.distances.leastcosts import least_costs
from ops.distances.pruning import Coarse, coarse_bounds
from ops.distances.within import minima_within, ranges_around, united
from ops.errors import KinedexError, did_you_mean
from ops.templates.templates import QuantisedTemplate, Template, quantise
from ops.words import TakeWords
from pipelines.executors import Executor
from pipelines.searching.search import preselect, preselect_stored
from pipelines.searching.windows import template_window
from pipelines.templates.learning import SubclassTemplate, run_of
from pipelines.wording import few
from storage.schemas import result_schema
from storage.store import Store, open_store

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]

BATCH_FRAMES = 50_000
"""Analysis frames (28 minutes) whose curves are held at once, 400 kB a subclass."""

NARROW = 4
"""Bounds look for where a template may fit, unless its ranges are no more than one frame in so many."""

VAGUE = 1.0
"""Fixed entries a column, on average, below which a template hardly tells motions apart: one feature of forty. (At
δ = 0.05 the templates of HDM05's clip classes have 16 to 36.)"""


@dataclass(frozen=True)
class Row:
    """What labels all frames of a take together: see `ops.distances.decoding.explain`.

    templates: S templates as learned. usual: float64 (K, f), the usual postures.
    """

    templates: tuple[Template, ...]
    usual: F64
    decoding: Decoding


@dataclass(frozen=True)
class Annotator:
    """All that is needed to annotate words.

    classes: names of the P classes. subclasses: names of the S templates; class_index: int64 (S,), their classes.
    queries: for each template the keyframe queries that preselect frames for it, none for all frames.
    remarks: templates that say too little, in words.
    row: what labels all frames of a take together; None: each frame gets the label of the nearest template (thesis).
    taus: float64 (P,), thresholds of the classes; None: `tau` is that of all.
    min_frames: shorter segments are left out.
    """

    feature_set: FeatureSet
    classes: tuple[str, ...]
    subclasses: tuple[str, ...]
    class_index: I64
    templates: tuple[QuantisedTemplate, ...]
    queries: tuple[tuple[KeyframeQuery, ...], ...]
    tau: float
    remarks: tuple[str, ...] = ()
    row: Row | None = None
    taus: F64 | None = None
    min_frames: int = 0

    @property
    def thresholds(self) -> F64:
        """The threshold of each class, float64 (P,)."""
        return np.full(len(self.classes), self.tau) if self.taus is None else self.taus

    @cached_property
    def reach(self) -> tuple[tuple[tuple[int, int], ...], ...]:
        """How far each template reaches out of the hits of each of its queries, to the left and to the right.

        The hits of a query with alternatives get the widest of their margins, since any of them may have found a hit.
        """
        found = []
        for template, queries in zip(self.templates, self.queries, strict=True):
            columns = template.values(len(self.feature_set.features)) if queries else np.empty((0, 0))
            own = []
            for query in queries:
                windows = [template_window(chain, columns, self.feature_set) for chain in query.chains]
                own.append((max(one.left for one in windows), max(one.right for one in windows)))
            found.append(tuple(own))
        return tuple(found)

    @property
    def method(self) -> str:
        """How annotations of this annotator are found, for the results."""
        how = "templates" if self.row is None else "templates in a row"
        return f"{how} within keyframe hits" if any(self.queries) else how


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


def make_annotator(
    feature_set: FeatureSet,
    templates: Sequence[SubclassTemplate],
    classes: Classes,
    delta: float,
    tau: float,
    queries: Sequence[KeyframeQuery] = (),
    usual: F64 | None = None,
) -> Annotator:
    """Quantise templates and sort them and the queries into classes.

    Parameters
    ----------
    templates: those of subclasses without a class are left out, and those of wildcards alone: they would fit anything
        at no cost. Those with fewer than `VAGUE` fixed entries a column stay, with a remark.
    queries: a query whose target is a subclass preselects for it, one whose target is a class for those of its
        subclasses that have no query of their own; other queries are left out (see `targets_unknown`).
    usual: float64 (K, f), the usual postures (`ops.distances.background.background`): all frames of a take are labelled
        together, by the explanation of the greatest value. None: frame by frame, as in the thesis.

    Raises
    ------
    KinedexError: no template belongs to any class, or all of them are wildcards alone.
    """
    of_subclass = classes.of_subclass()
    known = [one for one in templates if one.subclass in of_subclass]
    if not known:
        names = few([one.subclass for one in templates])
        raise KinedexError(f"none of the classes {', '.join(classes.names)} has a template; there are: {names}")
    quantised = {one.subclass: quantise(one.learned.template, delta) for one in known}
    used = [one for one in known if quantised[one.subclass].fixed > 0]
    if not used:
        raise KinedexError(
            f"at delta = {delta:g} every template is wildcards alone and would fit anything: in no column is a feature "
            "within delta of 0 or 1; raise `delta`, or learn from clips that have more in common"
        )
    by_target: dict[str, list[KeyframeQuery]] = {}
    for query in queries:
        by_target.setdefault(query.target, []).append(query)
    return Annotator(
        feature_set,
        classes.names,
        tuple(one.subclass for one in used),
        np.array([classes.names.index(of_subclass[one.subclass]) for one in used], np.int64),
        tuple(quantised[one.subclass] for one in used),
        tuple(tuple(by_target.get(one.subclass) or by_target.get(of_subclass[one.subclass]) or ()) for one in used),
        tau,
        _remarks({one.subclass: quantised[one.subclass].fixed for one in known}),
        None if usual is None else Row(tuple(one.learned.template for one in used), usual, Decoding()),
    )


def _remarks(fixed: Mapping[str, float]) -> tuple[str, ...]:
    """What to say of templates by their fixed entries a column."""
    empty = [subclass for subclass, entries in fixed.items() if not entries]
    vague = [f"{subclass} ({entries:.2g})" for subclass, entries in fixed.items() if 0 < entries < VAGUE]
    remarks = []
    if empty:
        remarks.append(f"templates of wildcards alone, which would fit anything, left out: {few(empty)}")
    if vague:
        remarks.append(
            f"templates with less than {VAGUE:g} fixed entry a column on average, which fit almost anything: "
            + few(vague)
        )
    return tuple(remarks)


def targets_unknown(queries: Sequence[KeyframeQuery], classes: Classes) -> list[str]:
    """The queries' targets that are neither a class nor a subclass.

    Raises
    ------
    KinedexError: all of them; the message names the nearest label.
    """
    unknown = sorted({query.target for query in queries if classes.class_of(query.target) is None})
    if queries and all(query.target in unknown for query in queries):
        labels = {*classes.names, *classes.of_subclass()}
        raise KinedexError(
            f"no keyframe query is for a class of this archive; the first is for '{queries[0].target}'"
            f"{did_you_mean(queries[0].target, labels)}"
        )
    return unknown


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


def takes_table(
    takes: pl.DataFrame, run: str, searched: Mapping[int, float], prints: Mapping[int, str] | None = None
) -> pa.Table:
    """Lay the takes that are annotated out as results of the kind `annotated_takes`.

    Parameters
    ----------
    searched: take_id → the share of its frames that a template was matched in, on average. prints: take_id →
        fingerprint, by which a later run knows that nothing has changed.
    """
    ids = takes.sort("name")["take_id"].to_list()
    columns = takes.sort("name").select(
        pl.lit(run).alias("run"),
        "take_id",
        pl.col("name").alias("take"),
        "frames",
        pl.Series("searched", [searched[take_id] for take_id in ids], pl.Float64),
        pl.Series("fingerprint", [(prints or {}).get(take_id) for take_id in ids], pl.String),
    )
    return columns.to_arrow().cast(result_schema("annotated_takes"))


def annotated_takes(store: Store, stage: str) -> pl.DataFrame:
    """The takes that a stage has annotated, found something in or not: their rows of takes, sorted by name.

    Parameters
    ----------
    stage: "<pipeline>/<stage>".

    Raises
    ------
    KinedexError: the stage has not run, or takes that it annotated have been replaced or dropped since.
    """
    table = pl.from_arrow(store.result("annotated_takes", run=run_of(store, stage)))
    assert isinstance(table, pl.DataFrame)
    seen = table.select("take_id", pl.col("take").alias("name"), "frames")
    takes = store.takes().join(seen, on=seen.columns, how="semi", maintain_order="left")
    gone = sorted(set(seen["name"]) - set(takes["name"]))
    if gone or not seen.height:
        what = f"takes that have been replaced or dropped since: {few(gone)}" if gone else "none of the store's takes"
        raise KinedexError(f"stage {stage} annotated {what}; run it again: `--force {stage.split('/', 1)[-1]}`")
    return takes


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
    for start, stop in pairwise(words.offsets.tolist()):
        own, within = words.words[start:stop], None
        if any(annotator.queries):
            clipped = [np.clip(one - start, 0, stop - start) for one in ranges]
            within = [one[one[:, 0] < one[:, 1]] for one in clipped]
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
    every = {query.name: query for queries in annotator.queries for query in queries}
    wanted = list(every.values())
    if store is None:
        hits = preselect(words, annotator.feature_set, wanted)
    else:
        hits = preselect_stored(store, words, wanted)
    ranges = []
    for queries, reach in zip(annotator.queries, annotator.reach, strict=True):
        if not queries:
            ranges.append(whole)
            continue
        several = [
            ranges_around(found.starts, found.stops, found.offsets, words.offsets, left, right)
            for found, (left, right) in zip((hits[query.name] for query in queries), reach, strict=True)
        ]
        ranges.append(several[0] if len(several) == 1 else united(several, words.offsets))
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


def _frames_within(ranges: I64, offsets: I64) -> I64:
    """How many frames of each take lie in ascending ranges that are apart, int64 (takes,)."""
    before = np.concatenate(([0], np.cumsum(ranges[:, 1] - ranges[:, 0])))
    place = np.searchsorted(ranges[:, 0], offsets, side="right")
    ends = np.concatenate(([0], ranges[:, 1]))
    covered: I64 = before[place] - np.maximum(ends[place] - offsets, 0)
    return np.diff(covered)


def annotations_table(
    found: Iterable[TakeAnnotation], annotator: Annotator, names: dict[int, str], rate_hz: float, run: str
) -> pa.Table:
    """Lay segments out as results of the kind `annotations`, by take name and start."""
    rows = [
        {
            "run": run,
            "take_id": one.take_id,
            "take": names[one.take_id],
            "class": annotator.classes[segment.class_index],
            "subclass": annotator.subclasses[segment.subclass],
            "start": segment.start,
            "stop": segment.stop,
            "start_seconds": segment.start / rate_hz,
            "stop_seconds": segment.stop / rate_hz,
            "cost": None if np.isnan(segment.cost) else segment.cost,
            "confidence": segment.confidence,
            "method": annotator.method,
        }
        for one in sorted(found, key=lambda one: names[one.take_id])
        for segment in one.segments
    ]
    return pa.Table.from_pylist(rows, schema=result_schema("annotations"))


def curves_table(found: Iterable[TakeAnnotation], annotator: Annotator, names: dict[int, str], run: str) -> pa.Table:
    """Lay distance curves out as results of the kind `distance_curves`, one row per take and subclass."""
    schema = result_schema("distance_curves")
    tables = []
    for one in sorted(found, key=lambda one: names[one.take_id]):
        if one.curves is None:
            continue
        count, length = one.curves.shape
        offsets = pa.array(np.arange(count + 1, dtype=np.int32) * length, pa.int32())
        columns = {
            "run": pa.repeat(run, count),
            "take_id": pa.repeat(one.take_id, count),
            "take": pa.repeat(names[one.take_id], count),
            "class": pa.array([annotator.classes[index] for index in annotator.class_index], pa.string()),
            "subclass": pa.array(annotator.subclasses, pa.string()),
            "costs": pa.ListArray.from_arrays(offsets, pa.array(one.curves.ravel(), pa.float32())),
            "preselected": one.preselected,
        }
        tables.append(pa.table(columns, schema=schema))
    return pa.concat_tables([schema.empty_table(), *tables])
