"""Complete, check and filter labels: statements of people about takes, whose rows are added but never changed."""

from __future__ import annotations

import uuid
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

import pyarrow as pa

from kinedex.ops.errors import ParameterError
from kinedex.storage.formats.labels.file_labels import ERROR
from kinedex.storage.snapshot.schemas import LABEL_ORIGINS, LABEL_VERDICTS, labels_schema, with_columns


def current_labels(rows: pa.Table) -> pa.Table:
    """Return the current labels: rows that no other row replaces, without those that only withdraw another."""
    if not rows.num_rows:
        return rows
    import pyarrow.compute as pc  # imported here: it creates hundreds of functions that no other code needs

    replaced = pc.is_in(rows.column("id"), rows.column("replaces"))
    withdrawn = pc.equal(rows.column("verdict"), "withdrawn")
    return rows.filter(pc.invert(pc.or_(replaced, withdrawn)))


def is_of_limbs(row: Mapping[str, Any]) -> bool:
    """Return whether a label is about errors of limbs, not about a motion.

    The class of such a label is `error`. A negative label states that its limb is correct, or that all limbs are
    correct if it names no limb.
    """
    return row["class"] == ERROR and (row["limb"] is not None or row["verdict"] == "negative")


def new_labels(labels: pa.Table, known: pa.Table, checksums: dict[str, str]) -> pa.Table:
    """Complete and check labels, and return those that a store does not have yet.

    Parameters
    ----------
    labels : pyarrow.Table
        Columns of `labels_schema`; missing ones count as null. A null `id` becomes a new id, `created` the current
        time, `verdict` "positive", and `checksum` that of the take.
    known : pyarrow.Table
        All rows that the store has. A row with the id of one of them is skipped, so that adding rows twice is harmless.
    checksums : dict of str to str
        Name of a take → the checksum of its source file. Labels of takes that are not in the store are kept, too.

    Raises
    ------
    ParameterError
        A value is not allowed; the message names the row's take and class.
    """
    unknown = [name for name in labels.column_names if name not in labels_schema().names]
    if unknown:
        raise ParameterError("labels", f"a table with columns of {', '.join(labels_schema().names)}", unknown[0])
    ids = set(known.column("id").to_pylist())
    now = datetime.now(UTC)
    rows = []
    for row in with_columns(labels, labels_schema()).to_pylist():
        row["id"] = row["id"] or uuid.uuid4().hex
        if row["id"] in ids:
            continue
        ids.add(row["id"])
        row["created"] = row["created"] or now
        row["verdict"] = row["verdict"] or "positive"
        row["checksum"] = row["checksum"] or checksums.get(row["take"])
        rows.append(row)
    for row in rows:
        _check(row, ids)
    return pa.Table.from_pylist(rows, schema=labels_schema())


def _check(row: dict[str, Any], ids: set[str]) -> None:
    shown = f"of {row['take']}, {row['class']}"
    for name in ("take", "class", "start", "stop"):
        if row[name] is None:
            raise ParameterError(f"{name} of a label {shown}", "given", None)
    start, stop = row["start"], row["stop"]
    if not 0 <= start < stop:
        raise ParameterError(
            f"range of the label {shown}", "frames [start, stop) with 0 <= start < stop", (start, stop)
        )
    for name, values in (("verdict", LABEL_VERDICTS), ("origin", LABEL_ORIGINS)):
        if row[name] not in values:
            raise ParameterError(f"{name} of the label {shown}", f"one of {', '.join(values)}", row[name])
    if row["confidence"] is not None and not 0 <= row["confidence"] <= 1:
        raise ParameterError(f"confidence of the label {shown}", "a number from 0 to 1", row["confidence"])
    if row["replaces"] is not None and (row["replaces"] not in ids or row["replaces"] == row["id"]):
        raise ParameterError(f"replaces of the label {shown}", "the id of another label", row["replaces"])
    if row["verdict"] == "withdrawn" and row["replaces"] is None:
        raise ParameterError(f"replaces of the label {shown}", "the id of the label that it withdraws", None)
