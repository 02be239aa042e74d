"""Reuse parts of results: find those that can be kept when a stage adds new results.

Results of takes, such as distance curves, grow with an archive. If a run reuses the results of an earlier one for most
takes, the new version of the store names the old parts again. Only parts with takes that are removed or recomputed are
rewritten, and small parts when there are many (by the tiers of `storage.store.compaction`). A part is full at
`storage.snapshot.parts.FULL_BYTES`, so that a change of one take rewrites little.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import pyarrow.compute as pc
import pyarrow.parquet as pq

from kinedex.ops.errors import StoreError
from kinedex.storage.snapshot.part_records import ResultPart
from kinedex.storage.snapshot.parts import FULL_BYTES, read_errors
from kinedex.storage.snapshot.snapshot import Snapshot
from kinedex.storage.store.compaction import worthwhile


@dataclass(frozen=True)
class ReusedParts:
    """The parts of a stage's results with rows that are still valid.

    Attributes
    ----------
    stay : tuple of ResultPart
        Parts that `StoreWriter.put_results` should keep.
    again : tuple of ResultPart
        Parts whose valid rows must be written again with the new ones.
    """

    stay: tuple[ResultPart, ...]
    again: tuple[ResultPart, ...]


def reused_parts(
    store: Snapshot, kind: str, stage: str, take_ids: Collection[int | str], column: str = "take_id"
) -> ReusedParts:
    """Divide the parts of a stage's results into those to keep and those with rows to write again.

    Parameters
    ----------
    store : Snapshot
        The store that has the results.
    kind : str
        A kind of results with the column.
    stage : str
        The stage, "<pipeline>/<stage>".
    take_ids : collection of int or str
        The takes (or other values of the column) whose rows are still valid.
    column : str, optional
        The column that names the take of a row.

    Raises
    ------
    StoreError
        A part is missing or cannot be read.
    """
    wanted = set(take_ids)
    held = {
        part: values_in(store, part, column)
        for part in (store.manifest.results.get(kind, ()) if wanted else ())
        if part.stage == stage
    }
    whole = [part for part, values in held.items() if values <= wanted]
    rewritten = {part for part, values in held.items() if not values <= wanted and values & wanted}
    rewritten |= {part for group in worthwhile(whole, FULL_BYTES) for part in group}
    while True:  # rows of a take in several parts keep their order only if all of the parts are rewritten
        moved = set().union(*(held[part] & wanted for part in rewritten))
        more = {part for part in whole if part not in rewritten and held[part] & moved}
        if not more:
            break
        rewritten |= more
    return ReusedParts(
        tuple(part for part in whole if part not in rewritten), tuple(part for part in held if part in rewritten)
    )


def stored_fingerprints(store: Snapshot, kind: str, stage: str, column: str = "take_id") -> dict[int | str, str]:
    """Return a dict from take or recording to fingerprint in a stage's results; empty if these cannot be read.

    Parameters
    ----------
    store : Snapshot
        The store that has the results.
    kind : str
        A kind of results with the column and `fingerprint`.
    stage : str
        The stage, "<pipeline>/<stage>".
    column : str, optional
        The column that names the take or the recording of a row.
    """
    found: dict[int | str, str] = {}
    columns = [column, "fingerprint"]
    try:
        for rows in store.result_pieces(
            kind, [part for part in store.manifest.results.get(kind, ()) if part.stage == stage], columns
        ):
            pairs = rows.group_by(columns).aggregate([])
            names, prints = (pairs.column(name).to_pylist() for name in columns)
            found |= {name: one for name, one in zip(names, prints, strict=True) if one is not None}
    except StoreError:
        return {}  # repair removes them, and the stage recomputes all of them
    return found


def values_in(store: Snapshot, part: ResultPart, column: str) -> set[int | str]:
    """Return the values of a column in a part of results."""
    file = store.checked.part(part)
    with read_errors(file):
        found = pq.read_table(file, columns=[column]).column(column)
    return set(pc.unique(found).to_pylist())
