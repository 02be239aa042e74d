"""Build the rows of `source_files`: every file of a source, and what became of it."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator

import pyarrow as pa

from kinedex.storage.formats.motion.sources import UNREAD, Scan
from kinedex.storage.snapshot.schemas import result_schema

Outcome = tuple[str, str, int, str | None]
"""Path of a file, what became of it, its number of takes, and the reason where there is one."""


def file_table(found: Scan, motions: Iterable[Outcome], root: str) -> pa.Table:
    """Return a row for every file of a source, sorted by path.

    Parameters
    ----------
    found : Scan
        The files.
    motions : iterable of Outcome
        The outcomes of motion files.
    root : str
        The source root.
    """
    schema = result_schema("source_files").remove(0)  # `run` is written by the store
    rows = [
        {
            "source_root": root,
            "source": path,
            "ending": os.path.splitext(path)[1].lower(),
            "outcome": outcome,
            "takes": takes,
            "reason": reason,
        }
        for path, outcome, takes, reason in (*motions, *_others(found))
    ]
    return pa.Table.from_pylist(sorted(rows, key=lambda row: str(row["source"])), schema=schema)


def _others(found: Scan) -> Iterator[Outcome]:
    """Yield the outcomes of all files that are not read as motion."""
    for refused in found.refused:
        yield refused.path, "refused", 0, str(refused.fault)
    for skeleton in found.skeletons:
        yield skeleton.path, "skeleton", 0, None
    for unread in found.unread:
        yield unread.path, "not read", 0, UNREAD[f".{unread.format}"]
    for sidecar in found.sidecars:
        yield sidecar.path, "metadata", 0, None
    for other in found.passed_over:
        yield other.path, "passed over", 0, other.kind
