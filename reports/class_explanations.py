"""Explain which class an interval of a take shows, by the labels of its store and `kinedex.ops.numeric.explanation`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from kinedex.ops.arrays import F64
from kinedex.ops.errors import KinedexError, ParameterError, did_you_mean
from kinedex.ops.numeric.explanation import Explanation, explain
from kinedex.ops.numeric.label_windows import Window, described, known_part
from kinedex.pipelines.templates.examples import CLIPS, LABELS, ChosenExamples, Example, ExampleParameters, examples_of
from kinedex.storage.snapshot.frames import read_intervals
from kinedex.storage.snapshot.parts import joint_positions

if TYPE_CHECKING:
    from kinedex.ops.intervals import TakeSegment
    from kinedex.reports.report_overview import Key
    from kinedex.storage.store.store import Store

Interval = tuple[int, int, int]
"""The id of a take, and frames [start, stop) of it."""

REASONS_SCHEMA = pa.schema(
    [
        ("speaks", pa.string()),
        ("text", pa.string()),
        ("quantity", pa.string()),
        ("unit", pa.string()),
        ("value", pa.float64()),
        ("low", pa.float64()),
        ("high", pa.float64()),
        ("other_low", pa.float64()),
        ("other_high", pa.float64()),
        ("below", pa.float64()),
        ("share", pa.float64()),
    ]
)
"""The columns of reasons: a text, a quantity, its value, and those of the examples of both classes."""


def taught_labels(store: Store) -> ChosenExamples:
    """Return the labels of people and the classes of takes as examples, also rejected ones."""
    params = ExampleParameters(where="class IS NOT NULL", labels_where="true", examples=[LABELS, CLIPS])
    return examples_of(store, params, required=False)


def windows_of(store: Store, labels: Sequence[Interval], around: Sequence[Interval]) -> Iterator[tuple[int, Window]]:
    """Yield the number and the frames of labels, in the order of the store's parts.

    Parameters
    ----------
    store : Store
        The store.
    labels, around : sequence of (int, int, int)
        The takes and the intervals of N labels, and the intervals around them that are read.
    """
    joints = store.feature_set.joints
    for number, table in read_intervals(store.checked, store.manifest, around, joints):
        positions = joint_positions(table, joints).transpose(2, 0, 1).astype(np.float64)
        (_, start, stop), (_, before, _) = labels[number], around[number]
        yield number, Window(positions, start - before, stop - before)


@dataclass(frozen=True)
class DescribedLabels:
    """The labels of a store that can be described.

    Attributes
    ----------
    labels : tuple of Example
        The labels of people, and the takes with a class.
    descriptors : float64 array (E, D)
        Their descriptors.
    without : frozenset of str
        The classes none of whose labels can be described.
    """

    labels: tuple[Example, ...]
    descriptors: F64
    without: frozenset[str]


def described_labels(store: Store) -> DescribedLabels:
    """Return the labels of people and the takes with a class of a store, with their descriptors."""
    labels = [one for one in taught_labels(store).examples if one.positive]
    intervals = [(one.take_id, one.start, one.stop) for one in labels]
    found = dict(_described(store, intervals))
    known = [number for number in range(len(labels)) if isinstance(found.get(number), np.ndarray)]
    described_ones = tuple(labels[number] for number in known)
    rows = np.array([found[number] for number in known], np.float64)
    without = {one.label for one in labels} - {one.label for one in described_ones}
    return DescribedLabels(described_ones, rows, frozenset(without))


def _described(store: Store, intervals: Sequence[Interval]) -> Iterator[tuple[int, F64 | ParameterError]]:
    """Yield the number of each interval, and its descriptor or why it has none."""
    for number, window in windows_of(store, intervals, intervals):
        try:
            yield number, described(known_part(window), store.feature_set.joints, store.rate_hz)
        except ParameterError as fault:
            yield number, fault


def explain_interval(
    store: Store, taught: DescribedLabels, take: str, interval: tuple[int, int], label: str | None = None
) -> Explanation:
    """Explain by quantities how far an interval of a take is of a class.

    Labels of the same take do not teach, unless a class has no others.

    Parameters
    ----------
    store : Store
        The store.
    taught : DescribedLabels
        The labels of the store.
    take : str
        The name of the take.
    interval : (int, int)
        Frames [start, stop) of the take, as `clip_range` returns them.
    label : str, optional
        The class; by default the most probable one.

    Raises
    ------
    KinedexError
        There is no such class, the body of the take cannot be described, or fewer than two classes have labels that
        can.
    """
    take_id = store.take_id(take)
    elsewhere = {one.label for one in taught.labels if one.take_id != take_id}
    places = [place for place, one in enumerate(taught.labels) if one.take_id != take_id or one.label not in elsewhere]
    names = [taught.labels[place].label for place in places]
    if label is not None and label not in {*names, *taught.without}:
        raise KinedexError(
            f"{store.path}: no take or label teaches the class '{label}'{did_you_mean(label, names)}; "
            f"`kinedex labels list {store.path}` shows the labels"
        )
    missing = "" if label is None or label in names else f" of the class '{label}'"
    if missing or len(set(names)) < 2:
        raise KinedexError(
            f"{store.path}: an explanation needs examples{missing or ' of two classes'} whose joints are all known; "
            "`kinedex labels add` labels an interval, and `patterns` of ingest give takes a class"
        )
    ((_, found),) = _described(store, [(take_id, *interval)])
    if isinstance(found, ParameterError):
        raise KinedexError(f"{take}, frames {interval[0]} to {interval[1]}, cannot be explained: {found}")
    return explain(found, taught.descriptors[places], names, store.feature_set.joints, label)


def reasons_table(found: Explanation) -> pa.Table:
    """Return the reasons of an explanation as a table, those that say most first."""
    rows = [{"speaks": "for" if one.share > 0 else "against", **one._asdict()} for one in found.reasons]
    return pa.Table.from_pylist(rows, schema=REASONS_SCHEMA)


def explanations_of(store: Store, segments: Sequence[TakeSegment]) -> dict[Key, Explanation]:
    """Explain the classes of segments; those that cannot be explained are missing.

    Parameters
    ----------
    store : Store
        The store with the takes of the segments.
    segments : sequence of TakeSegment
        The segments; subclasses are explained where they are known.
    """
    taught = described_labels(store)
    found = {}
    for one in segments:
        try:
            found[one.key] = explain_interval(store, taught, one.take, (one.start, one.stop), one.subclass or one.label)
        except KinedexError:  # the body, or the examples, lack joints; the page shows the segment all the same
            continue
    return found
