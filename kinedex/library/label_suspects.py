"""Rank the labels of a store by how much better another label would fit, see `kinedex.ops.numeric.label_suspects`."""

from __future__ import annotations

from collections import Counter
from typing import Any, NamedTuple

import pyarrow as pa

from kinedex.ops.numeric.label_suspects import Judgement, Place, context_of, judge_labels
from kinedex.ops.wording import counted
from kinedex.pipelines.templates.examples import Example
from kinedex.reports.class_explanations import taught_labels, windows_of
from kinedex.storage.store.store import Store

SUSPECTS_SCHEMA = pa.schema(
    [
        ("take", pa.string()),
        ("take_id", pa.int64()),
        ("class", pa.string()),
        ("start", pa.int32()),
        ("stop", pa.int32()),
        ("suspicion", pa.float64()),
        ("probability", pa.float64()),
        ("kind", pa.string()),
        ("proposal", pa.string()),
        ("new_class", pa.string()),
        ("new_start", pa.int32()),
        ("new_stop", pa.int32()),
        ("rate_factor", pa.float64()),
        ("source", pa.string()),
        ("id", pa.string()),
    ]
)
"""The columns of suspects: a label, why it is suspect, what fits better, and where it comes from."""


class Suspects(NamedTuple):
    """The labels of a store that another label would fit better.

    Attributes
    ----------
    rows : pyarrow.Table
        A row for each, with the columns of `SUSPECTS_SCHEMA`, the most suspect first.
    judged : int
        The number of labels that were judged.
    remarks : tuple of str
        Remarks on labels that cannot be judged.
    """

    rows: pa.Table
    judged: int
    remarks: tuple[str, ...]


def label_suspects(store: Store) -> Suspects:
    """Return the labels of a store that another label would fit better.

    The labels are those of people, and the classes of takes as their paths or tables give them.

    Parameters
    ----------
    store : Store
        The store that holds takes and labels.
    """
    chosen = taught_labels(store)
    labels = [one for one in chosen.examples if one.positive]
    places = [(one.take_id, one.start, one.stop) for one in labels]
    around = [(one.take_id, *context_of(one.start, one.stop, one.frames)) for one in labels]
    judgements = judge_labels(
        [Place(one.take_id, one.label) for one in labels],
        lambda: windows_of(store, places, around),
        store.feature_set.joints,
        store.rate_hz,
    )
    ids = {(row["take"], row["class"], row["start"], row["stop"]): row["id"] for row in store.labels().to_pylist()}
    rows = [_row(*pair, ids) for pair in zip(labels, judgements, strict=True) if pair[1].kind]
    rows.sort(key=lambda row: (-row["suspicion"], row["take"], row["start"], row["class"]))
    reasons = Counter(one.reason for one in judgements if one.reason)
    remarks = [f"{counted(count, 'label')} not judged: {reason}" for reason, count in reasons.most_common()]
    table = pa.Table.from_pylist(rows, schema=SUSPECTS_SCHEMA)
    return Suspects(table, len(labels) - reasons.total(), (*chosen.remarks, *remarks))


def _row(label: Example, found: Judgement, ids: dict[tuple[str, str, int, int], str]) -> dict[str, Any]:
    """Return the row of a label with what fits better."""
    edges = None
    if found.interval is not None:
        before = context_of(label.start, label.stop, label.frames)[0]
        edges = (found.interval[0] + before, found.interval[1] + before)
    return {
        "take": label.take,
        "take_id": label.take_id,
        "class": label.label,
        "start": label.start,
        "stop": label.stop,
        "suspicion": round(found.suspicion, 2),
        "probability": round(found.probability, 4),
        "kind": found.kind,
        "proposal": _proposal(label.label, found, edges),
        "new_class": found.label or None,
        "new_start": edges and edges[0],
        "new_stop": edges and edges[1],
        "rate_factor": found.rate_factor,
        "source": label.source,
        "id": ids.get((label.take, label.label, label.start, label.stop)),
    }


def _proposal(label: str, found: Judgement, edges: tuple[int, int] | None) -> str:
    """Return in words what fits better than a label."""
    if edges is not None:
        return f"frames {edges[0]} to {edges[1]}"
    if found.rate_factor is not None:
        return f"frames at {found.rate_factor:g} times the rate"
    return found.label or f"{label} of the other side"
