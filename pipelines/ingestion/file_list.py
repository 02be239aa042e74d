"""List all files of a source with their outcomes, as rows of `source_files`."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence

import pyarrow as pa

from kinedex.pipelines.ingestion.changes import Changes
from kinedex.pipelines.ingestion.failures import Failure
from kinedex.pipelines.ingestion.read_rounds import FilesRead
from kinedex.storage.formats.motion.sources import UNREAD, Scan
from kinedex.storage.snapshot.schemas import result_schema


def file_table(found: Scan, root: str, plan: Changes, done: FilesRead, failures: Sequence[Failure]) -> pa.Table:
    """Return a row for every file of a source.

    Parameters
    ----------
    found : Scan
        The files.
    root : str
        The source root.
    plan : Changes
        The changes of the source, with its unchanged files.
    done : FilesRead
        The files that were read.
    failures : sequence of Failure
        The files and persons that could not be read.
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
        for path, outcome, takes, reason in _outcomes(found, plan, done, failures)
    ]
    return pa.Table.from_pylist(sorted(rows, key=lambda row: str(row["source"])), schema=schema)


def _outcomes(
    found: Scan, plan: Changes, done: FilesRead, failures: Sequence[Failure]
) -> Iterator[tuple[str, str, int, str | None]]:
    """Yield path, outcome, number of takes and reason of every file."""
    reasons: dict[str, list[str]] = {}
    for one in failures:
        reasons.setdefault(one.source, []).append(one.message)
    for motion in found.motions:
        reason = "\n".join(reasons.get(motion.path, ())) or None
        if motion.path in done.takes:
            yield motion.path, "in", len(done.takes[motion.path]), reason
        elif (file := plan.unchanged.get(motion.path)) is not None:
            copy = f"has the content of {file.root}/{file.path}" if file.is_elsewhere(motion) else None
            yield motion.path, "in", len(file.rows), copy
        else:
            yield motion.path, "refused" if reason else "not read", 0, reason or "strict stopped before this file"
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
