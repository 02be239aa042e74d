"""Change a store's results and labels: the rows that stages compute, and those that people add."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import cast

import pyarrow as pa
import pyarrow.compute as pc

from kinedex.ops.errors import ParameterError, StoreError
from kinedex.storage.durable_files import write_errors
from kinedex.storage.snapshot.checked_files import CheckedFiles
from kinedex.storage.snapshot.label_journal import Journal, append_rows, empty, journal_rows, read_journals
from kinedex.storage.snapshot.manifest import LabelPart, ResultPart
from kinedex.storage.snapshot.manifest_files import read_newest, require_current_format
from kinedex.storage.snapshot.parts import write_part, write_pieces
from kinedex.storage.snapshot.schemas import conform, labels_schema, result_schema
from kinedex.storage.snapshot.snapshot import Snapshot
from kinedex.storage.snapshot.stored_labels import new_labels
from kinedex.storage.store.store import all_labels
from kinedex.storage.store.version_changes import VersionDraft


class ResultChanges(VersionDraft):
    """The methods of the draft of a version that change results and labels."""

    def put_results(
        self,
        kind: str,
        tables: pa.Table | Iterable[pa.Table | ResultPart],
        *,
        stage: str,
        run: str,
    ) -> None:
        """Set a stage's results of one kind, replacing its earlier ones.

        Parameters
        ----------
        kind : str
            One of `RESULT_KINDS`.
        tables : pyarrow.Table or iterable of pyarrow.Table or ResultPart
            Columns of `result_schema(kind)`; `run` may be missing. Without rows, the earlier results are only removed.
            Several tables, for example from a generator, are written one by one, so that they need not fit into memory.
            An earlier part of the stage among the tables is kept unchanged, at this position
            (`storage.store.reused_results`); such parts must be in their stored order.
        stage : str
            The stage, "<pipeline>/<stage>".
        run : str
            Id of the pipeline run.

        Raises
        ------
        StoreError
            A table has other columns, a part does not belong to the stage, or the disk is full; nothing is changed.
        """
        result_schema(kind)
        before = self._manifest.results.get(kind, ())
        own = {part.path for part in before if part.stage == stage}
        given = [tables] if isinstance(tables, pa.Table) else tables
        ahead: dict[str, list[ResultPart]] = {}
        written: list[ResultPart] = []
        for stays, some in groupby(given, lambda one: isinstance(one, ResultPart)):
            if not stays:
                written += self._written(kind, some, stage, run)
                continue
            for part in cast("Iterator[ResultPart]", some):
                if part.path not in own:
                    raise StoreError(f"{self.path}: {part.path} is no part of the results {kind} of {stage}")
                ahead[part.path], written = written, []
        kept: tuple[ResultPart, ...] = ()
        for part in before:
            if part.stage != stage or part.path in ahead:
                kept += (*ahead.get(part.path, ()), part)
        kept += tuple(written)
        self._manifest = replace(self._manifest, results={**self._manifest.results, kind: kept})
        if kept != before:
            self._facts.name("results", kind)

    def _written(self, kind: str, tables: Iterable[pa.Table], stage: str, run: str) -> list[ResultPart]:
        """Write tables as parts of results, and return the records of the parts."""
        parts = write_pieces(self.path, f"results/{kind}", (_result_rows(kind, table, run) for table in tables))
        width = len(result_schema(kind).names)
        return [
            ResultPart(part.path, part.rows, part.bytes, part.sha256, stage, run, part.xxh3, width) for part in parts
        ]

    def put_labels(self, labels: pa.Table) -> pa.Table:
        """Add labels, which are kept forever; a row may replace an earlier one.

        Parameters
        ----------
        labels : pyarrow.Table
            Columns of `labels_schema`; missing values are completed (`storage.snapshot.stored_labels.new_labels`).
            A row whose id is already in the store is skipped, so that adding rows twice is harmless.

        Returns
        -------
        pyarrow.Table
            The new rows, with their ids.

        Raises
        ------
        ParameterError
            A value is not allowed; nothing is changed.
        """
        self._add_journal()
        store = Snapshot(self.path, self._manifest, self._checked)
        known = store.labels(history=True)
        new = new_labels(labels, known, store.checksums)
        self._add_labels(known, new)
        return new

    def _add_journal(self) -> list[Journal]:
        """Add the rows of the journal of labels to the next version, and return the journal files that it includes.

        Rows that are already in the store are skipped. If labels cannot be read, the journal is left unchanged, so that
        commits of other changes do not fail; `repair` fixes the labels.
        """
        try:
            journals = read_journals(self.path)
            if any(one.rows for one in journals):
                known = Snapshot(self.path, self._manifest, self._checked).labels(history=True)
                self._add_labels(known, journal_rows(journals, known.column("id").to_pylist()))
        except StoreError:
            return []
        return journals

    def _add_labels(self, known: pa.Table, new: pa.Table) -> None:
        """Write new rows of labels as a part, together with the rows of small earlier parts."""
        if not new.num_rows:
            return
        stay = list(self._manifest.labels)
        count = new.num_rows
        # each part is at least twice the size of the next, so that there are few parts and a row is rarely rewritten
        while stay and stay[-1].rows < 2 * count:
            count += stay.pop().rows
        merged = pa.concat_tables([known.slice(sum(part.rows for part in stay)), new])
        part = write_part(self.path, "labels", merged.replace_schema_metadata(labels_schema().metadata))
        written = LabelPart(part.path, part.rows, part.bytes, part.sha256, part.xxh3)
        self._manifest = replace(self._manifest, labels=(*stay, written))
        self._facts.count("labels", new.num_rows)

    def _empty(self, journals: Sequence[Journal]) -> None:
        """Empty the journal files whose rows are in the newest version."""
        for one in journals:
            if one.damaged:
                continue  # `repair` must save its content first
            with write_errors(one.path):
                empty(one)


def _result_rows(kind: str, table: pa.Table, run: str) -> pa.Table:
    schema = result_schema(kind)
    if not table.num_columns:
        return schema.empty_table()
    if "run" not in table.column_names:
        table = table.append_column("run", pa.repeat(pa.scalar(run), table.num_rows))
    rows = conform(table, schema, f"results of kind {kind}")
    if rows.num_rows and pc.any(pc.not_equal(rows.column("run"), run)).as_py():
        raise ParameterError("run", f"{run} in every row of {kind}", pc.unique(rows.column("run")).to_pylist())
    return rows


def record_labels(path: str | Path, labels: pa.Table) -> pa.Table:
    """Add labels to a store's journal without the writer's lock; they are on disk when the function returns.

    Readers see the labels at once, and the next commit of a writer publishes them.

    Parameters
    ----------
    path : str or Path
        The store's directory.
    labels : pyarrow.Table
        Columns of `labels_schema`; missing values are completed (`storage.snapshot.stored_labels.new_labels`). A row
        whose id is already in the store is skipped.

    Returns
    -------
    pyarrow.Table
        The new rows, with their ids.

    Raises
    ------
    ParameterError
        A value is not allowed; nothing is stored.
    StoreError
        There is no store, it has an older format, its labels are damaged, or the disk cannot be written.
    """
    root = Path(path)
    newest = read_newest(root)
    require_current_format(root, newest)
    checked = CheckedFiles(root)
    known = all_labels(root, newest, checked)
    new = new_labels(labels, known, Snapshot(root, newest, checked).checksums)
    append_rows(root, new)
    return new
