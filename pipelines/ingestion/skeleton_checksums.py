"""Compute checksums of skeleton files, on which takes depend, without reading unchanged files again."""

from __future__ import annotations

import pyarrow as pa

from kinedex.storage.formats.motion.sources import SourceFile, checksum
from kinedex.storage.snapshot.schemas import result_schema

_SCHEMA = result_schema("skeleton_files").remove(0)  # `run` is written by the store


class SkeletonSums:
    """The checksums of skeleton files; those of an earlier run are reused if path, size and modification time match."""

    def __init__(self, known: pa.Table) -> None:
        """Start with the checksums of earlier runs, given as rows of `skeleton_files`."""
        self._known: dict[tuple[object, ...], str] = {
            tuple(row[name] for name in _SCHEMA.names[:-1]): row["checksum"] for row in known.to_pylist()
        }
        self._found: dict[tuple[object, ...], str] = {}

    def of(self, skeleton: SourceFile) -> str:
        """Return the checksum of a skeleton file.

        Raises
        ------
        SourceError
        The file cannot be read.
        """
        state = (skeleton.root, skeleton.path, skeleton.size, skeleton.mtime_ns)
        if state not in self._found:
            self._found[state] = self._known.get(state) or checksum(skeleton.absolute)
        return self._found[state]

    def table(self) -> pa.Table:
        """Return the checksums for the next run as rows of `skeleton_files`, including those of other sources."""
        here = {root for root, *_ in self._found}
        others = {state: content for state, content in self._known.items() if state[0] not in here}
        rows = [(*state, content) for state, content in (others | self._found).items()]
        return pa.Table.from_pylist([dict(zip(_SCHEMA.names, row, strict=True)) for row in rows], schema=_SCHEMA)
