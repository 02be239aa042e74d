"""Change a store's takes: add, update and drop them, replace their parts, declare their columns."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from kinedex.ops.errors import StoreError
from kinedex.storage.remedies import repair
from kinedex.storage.snapshot.manifest import Part
from kinedex.storage.snapshot.parts import FramesWriter, part_file
from kinedex.storage.snapshot.schemas import TakeColumn, column_problem, conform, frames_schema, with_columns
from kinedex.storage.store.version_changes import VersionDraft


class TakeChanges(VersionDraft):
    """The methods of the draft of a version that change takes."""

    def assign_take_ids(self, names: Iterable[str]) -> dict[str, int]:
        """Return an id for each take name: existing takes keep theirs, new ones get the next ids in order of name."""
        asked = sorted(set(names))
        for name in asked:
            if name not in self._ids:
                self._ids[name] = self._next
                self._next += 1
        return {name: self._ids[name] for name in asked}

    def add_takes(self, takes: pa.Table, frames: pa.Table | Part | Sequence[Part]) -> None:
        """Add takes with their frames; a take whose id is already in the store is replaced.

        Parameters
        ----------
        takes : pyarrow.Table
            One row per take, with ids from `assign_take_ids`, and the columns of `takes_schema`, including declared
            ones (`declare_columns`). Declared columns, and those that may be null in any store, can be missing.
        frames : pyarrow.Table, Part or sequence of Part
            The frames of exactly these takes: parts that workers have written, or a table sorted by take_id and frame.

        Raises
        ------
        StoreError
            The frames do not belong to the takes, or an id was not assigned to its take's name.
        """
        takes = self._take_rows(takes)
        parts = self._frames_parts(takes, frames)
        self._check_takes(takes, parts)
        ids = [take for part in parts for take in part.take_ids]
        for part in parts:
            part_file(self.path, part.path)
        again = {part.path for part in parts}
        others = tuple(part for part in self._manifest.frames if part.path not in again)
        self._manifest = replace(self._manifest, frames=_without(others, ids, self._rows) + tuple(parts))
        self._facts.count("takes_replaced", len(self._live.intersection(ids)))
        self._facts.count("takes_added", len(set(ids) - self._live))
        self._live.update(ids)
        self._drop_take_rows(ids)
        for row, take in enumerate(takes.column("take_id").to_pylist()):
            self._takes[take] = takes.slice(row, 1)
        self._rows.update(zip(takes.column("take_id").to_pylist(), takes.column("frames").to_pylist(), strict=True))
        self._changes.append(["added", sorted(part.sha256 for part in parts)])

    def restate_takes(self, takes: pa.Table, *, described: bool = False) -> None:
        """Replace rows of takes without changing their frames; everything computed from the frames remains valid.

        Parameters
        ----------
        takes : pyarrow.Table
            The new rows, with columns as for `add_takes`.
        described : bool
            True if columns change that filters over takes can use, such as the class, so that stages may select other
            takes. By default only the source of a take (path and time) changes, on which no stage depends.

        Raises
        ------
        StoreError
            No live take has one of the ids.
        """
        takes = self._take_rows(takes)
        ids = takes.column("take_id").to_pylist()
        unknown = set(ids) - set(self._manifest.live_takes)
        if unknown:
            raise StoreError(f"{self.path}: no live take has the id {min(unknown)}")
        self._facts.count("takes_restated", len(ids))
        if described and ids:
            self._changes.append(["described", sorted(ids)])
        self._drop_take_rows(ids)
        self._takes.update({take: takes.slice(row, 1) for row, take in enumerate(ids)})

    def drop_takes(self, take_ids: Iterable[int]) -> None:
        """Remove takes; their rows remain in the parts until compaction, but readers do not see them after the commit.

        Parameters
        ----------
        take_ids : iterable of int
            The takes to remove.

        Raises
        ------
        StoreError
            No live take has one of the ids.
        """
        gone = set(take_ids)
        unknown = gone - set(self._manifest.live_takes)
        if unknown:
            raise StoreError(f"{self.path}: no live take has the id {min(unknown)}")
        if not gone:
            return
        self._manifest = replace(self._manifest, frames=_without(self._manifest.frames, gone, self._rows))
        self._drop_take_rows(gone)
        self._ids = {name: take for name, take in self._ids.items() if take not in gone}
        self._changes.append(["dropped", sorted(gone)])
        self._facts.count("takes_dropped", len(gone))
        self._live -= gone

    def swap_parts(self, kind: Literal["frames", "takes"], old: Sequence[Part], new: Sequence[Part]) -> None:
        """Replace parts by other parts that hold the same live takes.

        Parameters
        ----------
        kind : str
            "frames" or "takes".
        old : sequence of Part
            Parts of the last committed version.
        new : sequence of Part
            Parts that were written after that commit.

        Raises
        ------
        StoreError
            Takes were added or dropped since the last commit, or the new parts do not have exactly the live takes and
            rows of the old ones; nothing is changed.
        """
        if self._changes:
            raise StoreError(f"{self.path}: takes have changed since the last commit; commit them first")
        standing: tuple[Part, ...] = getattr(self._manifest, kind)
        gone = {part.path for part in old}
        held = sorted(take for part in new for take in part.take_ids)
        same_takes = held == sorted(take for part in old for take in part.live)
        same_rows = sum(part.rows for part in new) == sum(part.live_rows for part in old)
        if not same_takes or not same_rows or not gone <= {part.path for part in standing}:
            raise StoreError(
                f"{self.path}: the new {kind} parts do not have the rows of the old parts, which are kept",
                remedy=repair(self.path),
            )
        for part in new:
            part_file(self.path, part.path)
        others = tuple(part for part in standing if part.path not in gone)
        parts = others + tuple(new)
        self._facts.count("parts_compacted", len(old))
        self._manifest = (
            replace(self._manifest, frames=parts) if kind == "frames" else replace(self._manifest, takes=parts)
        )

    def declare_columns(self, columns: Mapping[str, TakeColumn]) -> None:
        """Declare additional columns of takes; they are null in existing rows.

        Parameters
        ----------
        columns : mapping of str to TakeColumn
            Name → declaration; existing declarations are kept.

        Raises
        ------
        StoreError
            A name or a type cannot be used, or the column is already declared differently.
        """
        declared = dict(self._manifest.columns)
        for name, column in columns.items():
            if (problem := column_problem(name, column, declared)) is not None:
                raise StoreError(f"{self.path}: takes cannot have a column '{name}': {problem}; give it another name")
            if name not in declared:
                declared[name] = column
                self._facts.name("columns", name)
        self._manifest = replace(self._manifest, columns=declared)

    def widen_columns(self, types: Mapping[str, str]) -> None:
        """Give declared columns wider types, and rewrite the rows of all takes with converted values.

        Parameters
        ----------
        types : mapping of str to str
            Name → type, one of `COLUMN_TYPES`, to which values of the declared type can be converted.

        Raises
        ------
        StoreError
            There are uncommitted changes of takes; commit them first.
        """
        wider = {name: kind for name, kind in types.items() if self._manifest.columns[name].type != kind}
        if not wider:
            return
        if self._takes or self._changes:
            raise StoreError(f"{self.path}: takes have changed since the last commit; commit them first")
        rows = self.store.take_rows
        columns = {
            name: replace(column, type=wider.get(name, column.type)) for name, column in self._manifest.columns.items()
        }
        self._manifest = replace(self._manifest, columns=columns)
        for name in wider:
            self._facts.name("columns", name)
        self.restate_takes(with_columns(_listed(rows, wider), self._manifest.takes_schema))

    def _take_rows(self, takes: pa.Table) -> pa.Table:
        """Return rows of takes with all columns; missing optional ones are null."""
        schema = self._manifest.takes_schema
        optional = {"known", *self._manifest.columns} - set(takes.column_names)
        for name in (name for name in schema.names if name in optional):
            takes = takes.append_column(name, pa.nulls(takes.num_rows, schema.field(name).type))
        return conform(takes, schema, "takes")

    def _drop_take_rows(self, take_ids: Iterable[int]) -> None:
        gone = set(take_ids)
        self._manifest = replace(self._manifest, takes=_without(self._manifest.takes, gone, dict.fromkeys(gone, 1)))
        self._takes = {take: row for take, row in self._takes.items() if take not in gone}

    def _frames_parts(self, takes: pa.Table, frames: pa.Table | Part | Sequence[Part]) -> list[Part]:
        if isinstance(frames, Part):
            return [frames]
        if not isinstance(frames, pa.Table):
            return list(frames)
        rows = conform(frames, frames_schema(self._manifest.feature_set, self._manifest.rate_hz), "frames")
        ids = rows.column("take_id").to_numpy()
        if np.any(np.diff(ids) < 0):
            raise StoreError("frames: the rows must be sorted by take_id and frame")
        with FramesWriter(self.path, self._manifest.feature_set, self._manifest.rate_hz) as writer:
            for take in sorted(takes.column("take_id").to_pylist()):
                start, stop = np.searchsorted(ids, take, "left"), np.searchsorted(ids, take, "right")
                table = rows.slice(start, stop - start)
                if not np.array_equal(table.column("frame").to_numpy(), np.arange(stop - start)):
                    raise StoreError(f"frames: take {take} must have the frames 0, 1, 2, … in order")
                writer.add_table(take, table)
            part = writer.close()
        if part.rows != rows.num_rows:
            raise StoreError("frames: there are frames of takes that are not in the table of takes")
        return [part]

    def _check_takes(self, takes: pa.Table, parts: Sequence[Part]) -> None:
        ids = takes.column("take_id").to_pylist()
        held = sorted(take for part in parts for take in part.take_ids)
        if sorted(ids) != held:
            raise StoreError(
                f"the frames parts hold the takes {held[:10]}…, the table of takes names {sorted(ids)[:10]}…; "
                "they must be the same, each once"
            )
        frames = pc.sum(takes.column("frames")).as_py() or 0
        rows = sum(part.rows for part in parts)
        if frames != rows:
            raise StoreError(f"the takes have {frames} frames together, their frames parts {rows} rows")
        for take, name in zip(ids, takes.column("name").to_pylist(), strict=True):
            if self._ids.get(name) != take:
                raise StoreError(
                    f"take '{name}' has the id {take}, but the store gives it {self._ids.get(name, 'none')}; "
                    "ids come from assign_take_ids"
                )


def _listed(rows: pa.Table, wider: Mapping[str, str]) -> pa.Table:
    """Return rows of takes; in columns that become columns of lists, wrap each text in a list."""
    for name in (name for name, kind in wider.items() if kind == "VARCHAR[]" and name in rows.column_names):
        lists = [None if text is None else [text] for text in rows.column(name).to_pylist()]
        rows = rows.set_column(rows.column_names.index(name), name, pa.array(lists, pa.list_(pa.string())))
    return rows


def _without(parts: Iterable[Part], take_ids: Iterable[int], rows: Mapping[int, int]) -> tuple[Part, ...]:
    """Return the parts with tombstones for the given takes, without parts in which no take is live.

    `rows` maps each of the takes to the number of its rows.
    """
    gone = set(take_ids)
    result = []
    for part in parts:
        found = gone.intersection(part.live)
        if not found:
            result.append(part)
            continue
        dropped = tuple(sorted({*part.dropped, *found}))
        part = replace(part, dropped=dropped, dropped_rows=part.dropped_rows + sum(rows[take] for take in found))
        if part.live:
            result.append(part)
    return tuple(result)
