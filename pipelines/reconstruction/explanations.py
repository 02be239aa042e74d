"""Read the hypotheses and candidates tried for reconstructed frames, for a command and a page that explain them."""

from __future__ import annotations

from collections.abc import Collection

import pyarrow as pa
import pyarrow.compute as pc

from kinedex.storage.snapshot.schemas import result_schema
from kinedex.storage.store.store import Store

EXPLAINED = (
    "take", "source_frame", "direction", "hypothesis", "candidate", "archive_take", "archive_frame", "ends", "ends_m",
    "distance_m", "lookup_cost", "trial_cost", "cost", "winner",
)  # fmt: skip
"""The columns of `depth_votes` that a command shows."""


def explained_votes(
    store: Store, stage: str, takes: Collection[str], interval: tuple[int, int] | None = None
) -> pa.Table:
    """Return the hypotheses and candidates that were tried in the frames of takes.

    Parameters
    ----------
    store : Store
        The store.
    stage : str
        The stage that has reconstructed the takes, "<pipeline>/<stage>".
    takes : collection of str
        The names of the takes.
    interval : tuple of (int, int), optional
        The first frame and the one after the last; by default all frames.

    Returns
    -------
    pyarrow.Table
        Rows of `depth_votes` with the columns `EXPLAINED`, by take and frame.
    """
    parts = [part for part in store.manifest.results.get("depth_votes", ()) if part.stage == stage]
    names = pa.array(sorted(takes), pa.string())
    pieces = [result_schema("depth_votes").empty_table()]
    for rows in store.result_pieces("depth_votes", parts):
        wanted = pc.is_in(rows.column("take"), names)
        if interval is not None:
            frame = rows.column("source_frame")
            wanted = pc.and_(wanted, pc.and_(pc.greater_equal(frame, interval[0]), pc.less(frame, interval[1])))
        pieces.append(rows.filter(wanted))
    found = pa.concat_tables(pieces).select(list(EXPLAINED))
    order = [("take", "ascending"), ("source_frame", "ascending"), ("direction", "descending"),
             ("hypothesis", "descending"), ("candidate", "ascending")]  # fmt: skip
    return found.take(pc.sort_indices(found, order))
