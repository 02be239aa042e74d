"""Read the rows of results with a given value in a column, from only those row groups that contain the value."""

from __future__ import annotations

from collections.abc import Collection, Hashable

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from kinedex.storage.snapshot.manifest import ResultPart
from kinedex.storage.snapshot.parts import read_errors
from kinedex.storage.snapshot.schemas import result_schema, with_columns
from kinedex.storage.snapshot.snapshot import Snapshot


class RowGroups:
    """The rows of one kind of results of a stage, which can be read by the value of a column.

    Parameters
    ----------
    store : Snapshot
        The store.
    kind : str
        The kind of results.
    stage : str
        The stage that made them, "<pipeline>/<stage>".
    column : str
        The column, such as take_id or recording.
    """

    def __init__(self, store: Snapshot, kind: str, stage: str, column: str) -> None:
        self._store, self._kind, self._column = store, kind, column
        self._parts = store.stage_parts(kind, stage)
        self._places: dict[Hashable, list[tuple[int, int]]] = {}
        self._last: tuple[tuple[int, int], pa.Table] | None = None
        self._known_ranges: dict[tuple[int, str], list[tuple[str | None, str | None]]] = {}
        for number, part in enumerate(self._parts):
            file = store.checked.part(part)
            with read_errors(file), pq.ParquetFile(file) as opened:
                for group in range(opened.num_row_groups):
                    for value in pc.unique(opened.read_row_group(group, columns=[column]).column(column)).to_pylist():
                        self._places.setdefault(value, []).append((number, group))

    @property
    def values(self) -> list[Hashable]:
        """The distinct values of the column, in their order in the store."""
        return list(self._places)

    def __contains__(self, value: Hashable) -> bool:
        return value in self._places

    @property
    def parts(self) -> list[tuple[ResultPart, list[Hashable]]]:
        """The parts in the order of the store, each with the values that it contains in the column."""
        found: list[tuple[ResultPart, list[Hashable]]] = [(part, []) for part in self._parts]
        for value, places in self._places.items():
            for number in dict.fromkeys(number for number, _ in places):
                found[number][1].append(value)
        return found

    def rows(self, value: Hashable, column: str = "", among: Collection[str] = ()) -> pa.Table:
        """Return the rows with a given value in the column, in their order; an empty table if there are none.

        Parameters
        ----------
        value : hashable
            The value.
        column : str, optional
            A second column, of text; only rows with one of `among` in it are returned.
        among : collection of str, optional
            The values of the second column to look for.
        """
        schema = result_schema(self._kind)
        found = [schema.empty_table()]
        for place in self._places.get(value, ()):
            if column and not self._may_hold(place, column, among):
                continue
            group = self._group(place, schema)
            mask = pc.equal(group.column(self._column), pa.scalar(value, schema.field(self._column).type))
            if column:
                mask = pc.and_(mask, pc.is_in(group.column(column), pa.array(sorted(among), pa.string())))
            found.append(group if pc.all(mask).as_py() else group.filter(mask))
        return pa.concat_tables(found)

    def _may_hold(self, place: tuple[int, int], column: str, among: Collection[str]) -> bool:
        """Return whether a row group may contain one of the given values, judged by its smallest and largest value."""
        low, high = self._ranges(place[0], column)[place[1]]
        return low is None or high is None or any(low <= value <= high for value in among)

    def _ranges(self, part: int, column: str) -> list[tuple[str | None, str | None]]:
        """Return the smallest and the largest value of a column in each row group of a part; None if unknown."""
        if (part, column) not in self._known_ranges:
            file = self._store.checked.part(self._parts[part])
            with read_errors(file), pq.ParquetFile(file) as opened:
                metadata = opened.metadata
                place = [metadata.schema.column(k).path for k in range(metadata.num_columns)].index(column)
                statistics = [
                    metadata.row_group(group).column(place).statistics for group in range(metadata.num_row_groups)
                ]
            self._known_ranges[part, column] = [
                (one.min, one.max) if one is not None and one.has_min_max else (None, None) for one in statistics
            ]
        return self._known_ranges[part, column]

    def _group(self, place: tuple[int, int], schema: pa.Schema) -> pa.Table:
        """Return a row group; the last one is cached, because successive reads are often from the same row group."""
        if self._last is None or self._last[0] != place:
            file = self._store.checked.part(self._parts[place[0]])
            with read_errors(file), pq.ParquetFile(file) as opened:
                self._last = (place, with_columns(opened.read_row_group(place[1]), schema))
        return self._last[1]
