"""Read a snapshot: one version of a store, with its tables and words, from the parts that its manifest names."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from kinedex.catalog.features import FeatureSet
from kinedex.catalog.sql.columns import ORIGIN
from kinedex.ops.arrays import F32
from kinedex.ops.errors import ParameterError, StoreError, did_you_mean
from kinedex.ops.words import ALL_KNOWN, TakeWords
from kinedex.storage.snapshot.checked_files import CheckedFiles
from kinedex.storage.snapshot.frames import read_frames, read_intervals, read_takes, read_words
from kinedex.storage.snapshot.manifest import Manifest, ResultPart
from kinedex.storage.snapshot.parts import joint_positions, read_errors
from kinedex.storage.snapshot.schemas import labels_schema, result_schema, sorted_by, with_columns
from kinedex.storage.snapshot.stored_labels import current_labels
from kinedex.storage.snapshot.visible_results import all_parts, origin_of, pipeline_of, shown_parts

_FEW_ROWS = 20_000
"""The largest number of rows of a part that one thread reads; for so few rows it is faster than several threads."""


class Snapshot:
    """One version of a store, read-only, with its manifest and parts but without index and SQL.

    Parameters
    ----------
    path : Path
        The store's directory.
    manifest : Manifest
        The version to read.
    checked : CheckedFiles, optional
        The files that have been checked already; by default each file is checked before it is first read.
    """

    def __init__(self, path: Path, manifest: Manifest, checked: CheckedFiles | None = None) -> None:
        self.path = path
        self.manifest = manifest
        self.checked = checked or CheckedFiles(path)

    @property
    def feature_set(self) -> FeatureSet:
        """The feature set of the store's words, as recorded in the store."""
        return self.manifest.feature_set

    @property
    def rate_hz(self) -> float:
        """Analysis frames per second."""
        return self.manifest.rate_hz

    @cached_property
    def take_rows(self) -> pa.Table:
        """The rows of all live takes, sorted by name."""
        return self._read_takes(self.manifest.takes_schema)

    def take_columns(self, *names: str) -> pa.Table:
        """Return some columns of `take_rows`, without reading the others."""
        if "take_rows" in vars(self):
            return self.take_rows.select(names)
        whole = self.manifest.takes_schema
        needed = dict.fromkeys(("take_id", "name", *names))
        schema = pa.schema([whole.field(name) for name in needed], whole.metadata)
        return self._read_takes(schema, schema.names).select(names)

    def _read_takes(self, schema: pa.Schema, names: Sequence[str] | None = None) -> pa.Table:
        """Return the rows of all live takes, sorted by name, with the given columns of a schema or all of them."""
        tables = []
        for part in self.manifest.takes:
            table = _read_part(self.checked.part(part), schema, names)
            if part.dropped:
                dropped = set(part.dropped)
                keep = [take not in dropped for take in table.column("take_id").to_pylist()]
                table = table.filter(pa.array(keep, pa.bool_()))
            tables.append(table)
        return sorted_by(pa.concat_tables([schema.empty_table(), *tables]), "name").combine_chunks()

    @cached_property
    def take_ids(self) -> dict[str, int]:
        """A dict from take name to id, sorted by name."""
        return self._pairs("name", "take_id")

    @cached_property
    def take_names(self) -> dict[int, str]:
        """A dict from take id to name, sorted by name."""
        return self._pairs("take_id", "name")

    @cached_property
    def take_frames(self) -> dict[int, int]:
        """A dict from take id to number of frames."""
        return self._pairs("take_id", "frames")

    @property
    def checksums(self) -> dict[str, str]:
        """A dict from take name to the checksum of the source file."""
        return self._pairs("name", "checksum")

    @cached_property
    def known(self) -> dict[int, int]:
        """A dict from take id to mask of known features (with the bits of a word), for takes that lack joints."""
        masks: dict[int, int] = {}
        for part in self.manifest.takes:
            rows = _known_rows(self.checked.part(part))
            masks.update((take_id, mask) for take_id, mask in rows if take_id not in part.dropped)
        return masks

    def _pairs(self, key: str, value: str) -> dict[Any, Any]:
        columns = (self._keys.column(name).to_pylist() for name in (key, value))
        return dict(zip(*columns, strict=True))

    @cached_property
    def _keys(self) -> pa.Table:
        """The columns that nearly every method needs."""
        return self.take_columns("take_id", "name", "frames", "checksum")

    def take_id(self, name: str) -> int:
        """Return the id of a take by its name.

        Raises
        ------
        StoreError
            No take has this name; the message suggests the nearest one.
        """
        if name not in self.take_ids:
            raise StoreError(f"{self.path}: no take is named '{name}'{did_you_mean(name, self.take_ids)}")
        return self.take_ids[name]

    def words(self, take_ids: Sequence[int] | None = None) -> TakeWords:
        """Return the words of takes, in order of take_id, each take once.

        All words are in one numpy array; `TakeWords.take` returns the words of one take without a copy.

        Parameters
        ----------
        take_ids : sequence of int, optional
            The takes to read; all takes by default.

        Raises
        ------
        StoreError
            No live take has one of the ids.
        """
        return self.with_known(read_words(self.checked, self.manifest, take_ids))

    def with_known(self, words: TakeWords) -> TakeWords:
        """Return words with the masks of known features, if any take has unknown ones."""
        if not self.known:
            return words
        masks = np.array([self.known.get(take, ALL_KNOWN) for take in words.take_ids.tolist()], np.uint64)
        return words if (masks == ALL_KNOWN).all() else replace(words, known=masks)

    def frames(
        self, take: str, start: int = 0, stop: int | None = None, columns: Sequence[str] | None = None
    ) -> pa.Table:
        """Return the frames [start, stop) of a take, one row per analysis frame.

        Every column is one chunk, so that `frames("a").column("rwrist").chunk(0).field("y").to_numpy()` makes no copy.

        Parameters
        ----------
        take : str
            The take's name.
        start : int, optional
            First frame.
        stop : int, optional
            Frame after the last; the take's end by default.
        columns : sequence of str, optional
            The columns to read beside take_id, such as names of joints; all by default.

        Raises
        ------
        StoreError
            No take has this name.
        ParameterError
            The range is not inside the take.
        """
        take_id = self.take_id(take)
        count = self.take_frames[take_id]
        end = count if stop is None else stop
        if not 0 <= start <= end <= count:
            raise ParameterError("frame range", f"within [0, {count}), the frames of {take}", (start, end))
        return read_frames(self.checked, self.manifest, take_id, start, end, columns)

    def frames_of(self, takes: Iterable[str], columns: Sequence[str] | None = None) -> Iterator[tuple[str, pa.Table]]:
        """Yield names and frames of many takes, in their order in the store.

        Parameters
        ----------
        takes : iterable of str
            Names of takes.
        columns : sequence of str, optional
            The columns to read beside take_id, such as names of joints; all by default.

        Raises
        ------
        StoreError
            No take has one of the names.
        """
        names = {self.take_id(take): take for take in takes}
        for take_id, table in read_takes(self.checked, self.manifest, names, columns):
            yield names[take_id], table

    def positions(self, intervals: Sequence[tuple[int, int, int]]) -> list[F32]:
        """Return the joint positions of parts of takes, in the order of the parts.

        Parameters
        ----------
        intervals : sequence of (int, int, int)
            Ids of live takes with ranges of frames [start, stop), none of them empty.

        Returns
        -------
        list of float32 arrays (L, J, 3)
            Metres, Y up, in the order of the feature set's joints; NaN where a joint is not known.
        """
        if not intervals:
            return []
        joints = self.feature_set.joints
        found = dict(read_intervals(self.checked, self.manifest, intervals, joints))
        rows = [found[place] for place in range(len(intervals))]
        together = np.ascontiguousarray(joint_positions(pa.concat_tables(rows), joints).transpose(2, 0, 1))
        return np.split(together, np.cumsum([one.num_rows for one in rows])[:-1])

    def labels(self, *, history: bool = False) -> pa.Table:
        """Return the labels of the store, in the order in which they were added.

        Parameters
        ----------
        history : bool, optional
            Also return rows that were replaced or withdrawn by later rows, and the rows that withdraw others.
        """
        schema = labels_schema()
        tables = [_read_part(self.checked.part(part), schema) for part in self.manifest.labels]
        rows = pa.concat_tables([schema.empty_table(), *tables])
        return rows if history else current_labels(rows)

    def result(
        self, kind: str, run: str | None = None, pipeline: str | None = None, stage: str | None = None
    ) -> pa.Table:
        """Return the rows of one kind of result as stored in its parts; an empty table if there are none.

        Without `run`, `pipeline` and `stage`, the rows are those of the view with this name.

        Parameters
        ----------
        kind : str
            One of `storage.snapshot.schemas.RESULT_KINDS`.
        run : str, optional
            Only the rows of this run of a stage.
        pipeline : str, optional
            Only the rows that stages of this pipeline wrote.
        stage : str, optional
            Only the rows of this stage, "<pipeline>/<stage>".
        """
        schema = result_schema(kind)
        every = shown_parts if run is pipeline is stage is None else all_parts
        tables = [
            _read_part(self.checked.part(part), schema)
            for part in every(self.manifest, kind)
            if (run is None or part.run == run)
            and (pipeline is None or pipeline_of(part.stage) == pipeline)
            and (stage is None or part.stage == stage)
        ]
        return pa.concat_tables(tables) if tables else schema.empty_table()

    def result_view(self, kind: str, pipeline: str | None = None, *, every: bool = False) -> pa.Table:
        """Return the rows of one kind of result with the columns of its view, including those of the origin.

        Parameters
        ----------
        kind : str
            One of `storage.snapshot.schemas.RESULT_KINDS`.
        pipeline : str, optional
            The pipeline whose rows are returned; by default the rows that the view shows.
        every : bool, optional
            Return the rows of all pipelines.
        """
        schema = result_schema(kind)
        parts = all_parts(self.manifest, kind) if every or pipeline is not None else shown_parts(self.manifest, kind)
        tables = [_with_origin(schema.empty_table(), dict.fromkeys(ORIGIN))]
        for part in parts:
            if pipeline is None or pipeline_of(part.stage) == pipeline:
                rows = _read_part(self.checked.part(part), schema)
                tables.append(_with_origin(rows, origin_of(self.manifest, kind, part)))
        return pa.concat_tables(tables)

    def stage_parts(self, kind: str, stage: str) -> list[ResultPart]:
        """Return the parts of a kind of results that a stage, "<pipeline>/<stage>", has written."""
        return [part for part in self.manifest.results.get(kind, ()) if part.stage == stage]

    def rows_of(self, kind: str, stage: str, column: str, values: Iterable[int | str]) -> pa.Table:
        """Return the rows that a stage wrote for some takes or recordings; one piece at a time is read.

        Parameters
        ----------
        kind : str
            One of `storage.snapshot.schemas.RESULT_KINDS`.
        stage : str
            The stage, "<pipeline>/<stage>".
        column : str
            The column that names the take or the recording of a row.
        values : iterable of int or str
            The takes or recordings whose rows are returned.
        """
        import pyarrow.compute as pc  # here, because most commands filter no rows

        schema = result_schema(kind)
        wanted = pa.array(list(values), schema.field(column).type)
        pieces = self.result_pieces(kind, self.stage_parts(kind, stage))
        own = (rows.filter(pc.is_in(rows.column(column), wanted)) for rows in pieces)
        return pa.concat_tables([schema.empty_table(), *own])

    def result_pieces(
        self, kind: str, parts: Iterable[ResultPart], columns: Sequence[str] | None = None
    ) -> Iterator[pa.Table]:
        """Yield the rows of parts of one kind of result by row groups, with the given columns or all."""
        whole = result_schema(kind)
        schema = whole if columns is None else pa.schema([whole.field(name) for name in columns], whole.metadata)
        for part in parts:
            file = self.checked.part(part)
            with read_errors(file), pq.ParquetFile(file) as opened:
                for group in range(opened.num_row_groups):
                    yield with_columns(opened.read_row_group(group, columns=columns), schema)


def _with_origin(rows: pa.Table, origin: Mapping[str, str | None]) -> pa.Table:
    """Return rows of results with the columns of their origin, which replace stored columns of these names."""
    rows = rows.drop_columns([name for name in origin if name in rows.column_names])
    for name, value in origin.items():
        rows = rows.append_column(name, pa.repeat(pa.scalar(value, pa.string()), rows.num_rows))
    return rows.replace_schema_metadata(None)


def _read_part(file: Path, schema: pa.Schema, columns: Sequence[str] | None = None) -> pa.Table:
    """Read a part, or some of its columns; columns that an older kinedex did not write are null."""
    # not pq.read_table, which imports pyarrow.dataset: that takes longer than reading a small part
    with read_errors(file), pq.ParquetFile(file) as opened:
        rows = opened.read(columns, use_threads=opened.metadata.num_rows > _FEW_ROWS)
    return with_columns(rows, schema)


def _known_rows(file: Path) -> list[tuple[int, int]]:
    """Return the ids and masks of the takes of a part that lack joints; the rows are not read if no take lacks any."""
    with read_errors(file), pq.ParquetFile(file) as opened:
        place = opened.schema_arrow.get_field_index("known")
        groups = [opened.metadata.row_group(number) for number in range(opened.num_row_groups)] if place >= 0 else []
        nulls = [(group.column(place).statistics, group.num_rows) for group in groups]
        if all(found is not None and found.null_count == count for found, count in nulls):
            return []
        rows = opened.read(["take_id", "known"])
    known = rows.filter(rows.column("known").is_valid())
    return list(zip(known.column("take_id").to_pylist(), known.column("known").to_pylist(), strict=True))
