"""Read the frames of labels and of classes of takes from a store, and explain intervals by them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from kinedex.ops.errors import KinedexError, ParameterError, did_you_mean
from kinedex.ops.numeric.explanation import Explanation, explain
from kinedex.ops.numeric.label_windows import Window, described, known_part
from kinedex.pipelines.templates.examples import CLIPS, LABELS, ChosenExamples, ExampleParameters, examples_of
from kinedex.pipelines.templates.stored_templates import clip_range
from kinedex.storage.snapshot.frames import read_intervals
from kinedex.storage.snapshot.parts import joint_positions

if TYPE_CHECKING:
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


def explain_interval(
    store: Store, take: str, start: str | int | None, stop: str | int | None, label: str | None = None
) -> Explanation:
    """Explain by quantities how far an interval of a take is of a class.

    Examples are the labels of people and the takes with a class. Those of the same take do not teach, unless a class
    has no others.

    Parameters
    ----------
    store : Store
        The store.
    take : str
        The name of the take.
    start, stop : int or str, optional
        The interval, as for `clip_range`; by default the whole take.
    label : str, optional
        The class; by default the most probable one.

    Raises
    ------
    KinedexError
        There is no such take or class, the interval is not within the take, its body cannot be described, or fewer than
        two classes have examples that can.
    """
    first, last = clip_range(store, take, start, stop)
    take_id = store.take_id(take)
    labels = [one for one in taught_labels(store).examples if one.positive]
    elsewhere = {one.label for one in labels if one.take_id != take_id}
    labels = [one for one in labels if one.take_id != take_id or one.label not in elsewhere]
    names = {one.label for one in labels}
    if label is not None and label not in names:
        raise KinedexError(
            f"{store.path}: no take or label teaches the class '{label}'{did_you_mean(label, names)}; "
            f"`kinedex labels list {store.path}` shows the labels"
        )
    every = [(take_id, first, last), *((one.take_id, one.start, one.stop) for one in labels)]
    found: dict[int, np.ndarray] = {}
    joints = store.feature_set.joints
    for number, window in windows_of(store, every, every):
        try:
            found[number] = described(known_part(window), joints, store.rate_hz)
        except ParameterError as fault:
            if not number:
                raise KinedexError(f"{take}, frames {first} to {last}, cannot be explained: {fault}") from None
    known = [number for number in range(1, len(every)) if number in found]
    taught = [labels[number - 1].label for number in known]
    missing = "" if label is None or label in taught else f" of the class '{label}'"
    if missing or len(set(taught)) < 2:
        raise KinedexError(
            f"{store.path}: an explanation needs examples{missing or ' of two classes'} whose joints are all known; "
            "`kinedex labels add` labels an interval, and `patterns` of ingest give takes a class"
        )
    return explain(found[0], np.stack([found[number] for number in known]), taught, joints, label)


def reasons_table(found: Explanation) -> pa.Table:
    """Return the reasons of an explanation as a table, those that say most first."""
    rows = [{"speaks": "for" if one.share > 0 else "against", **one._asdict()} for one in found.reasons]
    return pa.Table.from_pylist(rows, schema=REASONS_SCHEMA)
