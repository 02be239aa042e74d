"""Store results of takes made from recordings; rows of other takes are kept."""

from __future__ import annotations

import shlex
from collections.abc import Collection, Iterable, Iterator
from itertools import chain

import pyarrow as pa
import pyarrow.compute as pc

from kinedex.ops.errors import KinedexError
from kinedex.storage.store.reused_results import reused_parts, values_in
from kinedex.storage.store.store import Store
from kinedex.storage.store.writer import StoreWriter


def put_beside(
    writer: StoreWriter,
    kind: str,
    tables: Iterable[pa.Table],
    *,
    stage: str,
    run: str,
    column: str,
    gone: Collection[int | str],
) -> None:
    """Store results of some takes or recordings, and keep those of the others that the stage has.

    Parameters
    ----------
    writer : StoreWriter
        The writer of the store.
    kind : str
        One of `RESULT_KINDS`.
    tables : iterable of pyarrow.Table
        The new rows.
    stage : str
        The stage, "<pipeline>/<stage>".
    run : str
        Id of the pipeline run.
    column : str
        The column that names the take or the recording of a row: take_id or recording.
    gone : collection
        The values in this column whose earlier rows are removed.
    """
    store = writer.store
    before = [part for part in store.manifest.results.get(kind, ()) if part.stage == stage]
    stay = set().union(*(values_in(store, part, column) for part in before)) - set(gone)
    reused = reused_parts(store, kind, stage, stay, column)

    def pieces() -> Iterator[pa.Table]:
        for rows in store.result_pieces(kind, reused.again):
            left = rows.filter(pc.is_in(rows.column(column), pa.array(sorted(stay), rows.schema.field(column).type)))
            place = left.schema.get_field_index("run")
            yield left.set_column(place, left.schema.field("run"), pa.repeat(pa.scalar(run), left.num_rows))
        yield from tables

    writer.put_results(kind, chain(reused.stay, pieces()), stage=stage, run=run)


def earlier_rows(store: Store, kind: str, stage: str) -> list[dict[str, object]]:
    """Return the rows of a small kind of results that a stage has; an empty list if they cannot be read."""
    parts = [part for part in store.manifest.results.get(kind, ()) if part.stage == stage]
    try:
        return [row for rows in store.result_pieces(kind, parts) for row in rows.to_pylist()]
    except KinedexError:
        return []  # repair removes unreadable rows, and the stage makes all of them again


MADE_KINDS = ("tracks", "reconstructions")
"""The kinds of results that have a row for each take made from a recording."""


def stages_of_takes(store: Store, take_ids: Collection[int]) -> set[str]:
    """Return the stages, as "<pipeline>/<stage>", that have made takes from recordings."""
    return {
        part.stage
        for kind in MADE_KINDS
        for part in store.manifest.results.get(kind, ())
        if any(row["take_id"] in take_ids for row in earlier_rows(store, kind, part.stage))
    }


def command_of_take(store: Store, take_id: int) -> str:
    """Return the command that makes a take again from its recording."""
    path = shlex.quote(str(store.path))
    for kind in MADE_KINDS:
        for rows in store.result_pieces(kind, store.manifest.results.get(kind, ())):
            for row in (row for row in rows.to_pylist() if row["take_id"] == take_id):
                if kind == "reconstructions":
                    return f"kinedex reconstruct {path} RECORDINGS"
                if row["track_of"] is not None:
                    return f"kinedex stabilise {path} {shlex.quote(row['track_of'])}"
    return f"kinedex track {path} RECORDINGS"


def are_takes_there(store: Store, kind: str, uses: str) -> bool:
    """Return whether all takes that stages of a kind have made are in the store, according to their results."""
    live = set(store.manifest.live_takes)
    records = store.manifest.stages
    stages = {
        part.stage
        for part in store.manifest.results.get(kind, ())
        if part.stage in records and records[part.stage].summary.get("uses") == uses
    }
    return all(row["take_id"] in live for stage in stages for row in earlier_rows(store, kind, stage))
