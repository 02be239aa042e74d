"""The writer of a store: one at a time, it collects changes and publishes them as one new version."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Literal

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from kinedex.catalog.features import FeatureSet
from kinedex.ops.errors import ParameterError, StoreError, did_you_mean
from kinedex.storage.disk import write_errors
from kinedex.storage.lock import NO_WAIT, Lock, Wait
from kinedex.storage.provenance import kinedex_version, running_command
from kinedex.storage.remedies import repair
from kinedex.storage.snapshot.checked_files import CheckedFiles
from kinedex.storage.snapshot.label_journal import Journal, empty, journal_rows, read_journals
from kinedex.storage.snapshot.labels import new_labels
from kinedex.storage.snapshot.manifest import (
    LabelPart,
    Manifest,
    Part,
    PipelineRecord,
    ResultPart,
    Source,
    StageRecord,
    changed_content,
    now,
    publish,
    read_newest,
    require_current_format,
    versions,
)
from kinedex.storage.snapshot.parts import FramesWriter, part_file, write_part, write_pieces
from kinedex.storage.snapshot.schemas import (
    FORMAT_VERSION,
    TakeColumn,
    column_problem,
    conform,
    frames_schema,
    labels_schema,
    result_schema,
    with_columns,
)
from kinedex.storage.snapshot.shown_results import current_pipeline, pipelines_by_use
from kinedex.storage.snapshot.snapshot import Snapshot
from kinedex.storage.store.store import Store
from kinedex.storage.store.version_changes import Facts
from kinedex.storage.store.write_access import (
    DATABASE,
    FOLDERS,
    last_opened,
    refuse_foreign,
    refuse_other_words,
    remove_leftovers,
)


class StoreWriter:
    """The one writer of a store, from `open` to `close` (or the end of its `with` block).

    Readers see no change before `commit`; changes that are not committed at the end are dropped. Other processes may
    write parts (`storage.snapshot.parts.FramesWriter`) while this writer is open, but not before: opening it removes
    the leftovers of killed runs, and a part that no manifest names counts as one.
    """

    def __init__(self, path: Path, manifest: Manifest, lock: Lock) -> None:
        self.path = path
        self._committed = manifest
        self._opened = manifest.version
        self._manifest = manifest
        self._lock = lock
        self._takes: dict[int, pa.Table] = {}
        self._changes: list[Any] = []
        self._facts = Facts()
        self._checked = CheckedFiles(path)
        takes = Snapshot(path, manifest, self._checked)
        self._ids = dict(takes.take_ids)
        self._rows = dict(takes.take_frames)
        self._live = set(self._rows)
        self._next = manifest.next_take_id

    @classmethod
    def open(
        cls, path: str | Path, feature_set: FeatureSet, rate_hz: float = 30.0, wait: Wait = NO_WAIT
    ) -> StoreWriter:
        """Lock a store for writing; make an empty one if there is none.

        Parameters
        ----------
        path : str or Path
            The store's directory.
        feature_set : FeatureSet
            The feature set of its words, which must be that of an existing store.
        rate_hz : float, optional
            Analysis frames per second, which must be those of an existing store.
        wait : Wait, optional
            The time to wait for another writer to finish.

        Raises
        ------
        StoreError
            Another writer holds the lock (the message names its process and host); the directory holds other things;
            the store has an older format (`kinedex upgrade`), or another feature set or rate.
        """
        root = Path(path)
        refuse_foreign(root)
        with write_errors(root):
            root.mkdir(parents=True, exist_ok=True)
        since = last_opened(root / "lock")
        lock = Lock(root / "lock", "this one", wait)
        try:
            manifest = read_newest(root) if versions(root) else None
            if manifest is not None:
                require_current_format(root, manifest)
            with write_errors(root):
                for folder in FOLDERS:
                    (root / folder).mkdir(exist_ok=True)
            if manifest is None:
                publish(root, _first_version(feature_set, rate_hz))
                manifest = read_newest(root)
            refuse_other_words(root, manifest, feature_set, rate_hz)
            remove_leftovers(root, manifest, since)
            return cls(root, manifest, lock)
        except BaseException:
            lock.release()
            raise

    @property
    def manifest(self) -> Manifest:
        """The version that was committed last."""
        return self._committed

    @property
    def takes_schema(self) -> pa.Schema:
        """The columns of takes, with those that were declared since the last commit."""
        return self._manifest.takes_schema

    @property
    def columns(self) -> Mapping[str, TakeColumn]:
        """The declared columns of takes, with those that were declared since the last commit."""
        return self._manifest.columns

    @property
    def store(self) -> Store:
        """The store as it was committed last."""
        return Store(self.path, self._committed, checked=self._checked)

    def assign_take_ids(self, names: Iterable[str]) -> dict[str, int]:
        """Give each take name its id: takes of the store keep theirs, new ones get the next ids in order of name."""
        asked = sorted(set(names))
        for name in asked:
            if name not in self._ids:
                self._ids[name] = self._next
                self._next += 1
        return {name: self._ids[name] for name in asked}

    def add_takes(self, takes: pa.Table, frames: pa.Table | Part | Sequence[Part]) -> None:
        """Add takes with their frames; a take whose id is in the store already is replaced.

        Parameters
        ----------
        takes : pyarrow.Table
            One row per take, ids from `assign_take_ids`: the columns of `takes_schema` and declared ones
            (`declare_columns`); of the latter, and of those that may be null in any store, some may be missing.
        frames : pyarrow.Table, Part or sequence of Part
            The frames of exactly these takes: parts that workers have written, or a table sorted by take_id and frame.

        Raises
        ------
        StoreError
            The frames are not those of the takes, or an id was not assigned to its take's name.
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
        """Replace rows of takes whose frames stay; everything that was made of the frames remains valid.

        Parameters
        ----------
        takes : pyarrow.Table
            The new rows, with columns as for `add_takes`.
        described : bool
            True where columns change that filters select takes by, such as the class, so that stages may read others.
            By default they record where a take has come from (place and time), on which no stage depends.

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
        """Remove takes; their rows stay in the parts until compaction, but no reader sees them after the commit.

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
        """Replace parts by others that hold the same live takes in another layout.

        Parameters
        ----------
        kind : str
            "frames" or "takes".
        old : sequence of Part
            Parts of the version that was committed last.
        new : sequence of Part
            Parts that were written since.

        Raises
        ------
        StoreError
            Takes were added or dropped since the last commit, or the new parts do not hold exactly the live takes and
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
                f"{self.path}: the new {kind} parts do not hold what the old ones do, so those stay",
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

    def put_results(
        self,
        kind: str,
        tables: pa.Table | Iterable[pa.Table],
        *,
        stage: str,
        run: str,
        keep: Iterable[ResultPart] = (),
    ) -> None:
        """Set the results of one kind that a stage has, in place of its earlier ones.

        Parameters
        ----------
        kind : str
            One of `RESULT_KINDS`.
        tables : pyarrow.Table or iterable of pyarrow.Table
            Columns of `result_schema(kind)`; `run` may be missing. Without rows, the earlier results are only removed.
            Several tables, such as a generator makes, are written one by one as they come, so that they need not fit
            into memory.
        stage : str
            The stage, "<pipeline>/<stage>".
        run : str
            Id of the pipeline run.
        keep : iterable of ResultPart, optional
            Parts of the stage's earlier results that stay, files and rows as they are (`storage.store.reused_results`).

        Raises
        ------
        StoreError
            A table does not fit, a part to keep is missing, or the disk is full; nothing is changed.
        """
        result_schema(kind)
        stay = {part.path for part in keep}
        before = self._manifest.results.get(kind, ())
        if stay - {part.path for part in before if part.stage == stage}:
            raise StoreError(f"{self.path}: {min(stay)} is no part of the results {kind} of {stage}")
        given = [tables] if isinstance(tables, pa.Table) else tables
        parts = write_pieces(self.path, f"results/{kind}", (_result_rows(kind, table, run) for table in given))
        kept = tuple(part for part in before if part.stage != stage or part.path in stay)
        width = len(result_schema(kind).names)
        kept += tuple(
            ResultPart(part.path, part.rows, part.bytes, part.sha256, stage, run, part.xxh3, width) for part in parts
        )
        self._manifest = replace(self._manifest, results={**self._manifest.results, kind: kept})
        if kept != before:
            self._facts.name("results", kind)

    def put_labels(self, labels: pa.Table) -> pa.Table:
        """Add labels; they stay for good, and a row takes the place of the one that it replaces.

        Parameters
        ----------
        labels : pyarrow.Table
            Columns of `labels_schema`; those that are missing are completed (`storage.snapshot.labels.new_labels`).
            A row whose id the store has is skipped, so that the same rows can be put twice.

        Returns
        -------
        pyarrow.Table
            The new rows, with their ids.

        Raises
        ------
        ParameterError
            A value is out of its domain; nothing is changed.
        """
        self._take_over()
        store = Snapshot(self.path, self._manifest, self._checked)
        known = store.labels(history=True)
        new = new_labels(labels, known, store.checksums)
        self._add_labels(known, new)
        return new

    def _take_over(self) -> list[Journal]:
        """Add the rows of the journal of labels to the next version, and return the files that it then holds.

        Rows that the store has already are skipped. Where labels cannot be read, the journal stays as it is: a commit
        of other work does not fail for that, and `repair` mends it.
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
        """Write new rows of labels as a part, together with small parts of known rows."""
        if not new.num_rows:
            return
        stay = list(self._manifest.labels)
        count = new.num_rows
        # parts double in size from the last to the first, so that there are few, and a row is seldom written again
        while stay and stay[-1].rows < 2 * count:
            count += stay.pop().rows
        merged = pa.concat_tables([known.slice(sum(part.rows for part in stay)), new])
        part = write_part(self.path, "labels", merged.replace_schema_metadata(labels_schema().metadata))
        written = LabelPart(part.path, part.rows, part.bytes, part.sha256, part.xxh3)
        self._manifest = replace(self._manifest, labels=(*stay, written))
        self._facts.count("labels", new.num_rows)

    def declare_columns(self, columns: Mapping[str, TakeColumn]) -> None:
        """Declare columns of takes beside those of every store; rows that are there already have null in them.

        Parameters
        ----------
        columns : mapping of str to TakeColumn
            Name → declaration; one that stands already is left as it is.

        Raises
        ------
        StoreError
            A name or type cannot be used, or the column is declared otherwise.
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
        """Give declared columns wider types; the rows of all takes are written again with their values converted.

        Parameters
        ----------
        types : mapping of str to str
            Name → type, one of `COLUMN_TYPES`, to which values of the declared type can be converted.

        Raises
        ------
        StoreError
            Takes were changed since the last commit; commit them first.
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

    def record_source(self, root: str, stage: str, settings: Mapping[str, Any]) -> None:
        """Record the settings with which a source folder is ingested, in place of its earlier ones.

        Parameters
        ----------
        root : str
            The folder, absolute.
        stage : str
            The stage, "<pipeline>/<stage>".
        settings : mapping of str to object
            The parameters of the stage, as JSON values.
        """
        standing = self._manifest.sources.get(root)
        if standing is None or (standing.stage, standing.settings) != (stage, settings):
            source = Source(stage, dict(settings), now())
            self._manifest = replace(self._manifest, sources={**self._manifest.sources, root: source})

    def remove_files(self, root: str, paths: Iterable[str]) -> None:
        """Record files of a source folder whose takes were removed, so that an ingest passes them over."""
        standing = self._manifest.removed_files
        merged = tuple(sorted({*standing.get(root, ()), *paths}))
        if merged:
            self._manifest = replace(self._manifest, removed_files={**standing, root: merged})

    def readmit_files(self, files: Iterable[tuple[str, str]]) -> None:
        """Remove files, given by source folder and path, from the record of those that an ingest passes over."""
        gone = set(files)
        left = {
            root: tuple(path for path in paths if (root, path) not in gone)
            for root, paths in self._manifest.removed_files.items()
        }
        self._manifest = replace(self._manifest, removed_files={root: paths for root, paths in left.items() if paths})

    def put_mapping(self, name: str, text: str | None) -> None:
        """Keep a skeleton mapping or a vocabulary under a name, in place of an earlier one; None removes it."""
        others = {other: kept for other, kept in self._manifest.mappings.items() if other != name}
        mappings = others if text is None else {**others, name: text}
        if mappings != self._manifest.mappings:
            self._manifest = replace(self._manifest, mappings=mappings)
            self._facts.name("mappings", name)

    def record_pipeline(self, name: str, record: PipelineRecord) -> None:
        """Record what a pipeline was run with, in place of its earlier record."""
        self._manifest = replace(self._manifest, pipelines={**self._manifest.pipelines, name: record})

    def record_run(self, pipeline: str) -> None:
        """Record that a pipeline that makes results was run to its end: it is the current one unless one was chosen."""
        recent = tuple(dict.fromkeys((pipeline, *self._manifest.recent_pipelines)))
        self._record_current(replace(self._manifest, recent_pipelines=recent))

    def choose_pipeline(self, name: str | None) -> None:
        """Make a pipeline with results the current one; None makes it the one that is run last, now and later.

        Raises
        ------
        StoreError
            The store has no results of a pipeline of this name.
        """
        known = pipelines_by_use(self._manifest)
        if name is not None and name not in known:
            have = f"it has results of {', '.join(known)}" if known else "it has no results of pipelines"
            raise StoreError(f"{self.path}: no pipeline '{name}'; {have}{did_you_mean(name, known)}")
        self._record_current(replace(self._manifest, chosen_pipeline=name or ""))

    def _record_current(self, manifest: Manifest) -> None:
        before, after = current_pipeline(self._manifest), current_pipeline(manifest)
        if after is not None and after != before:
            self._facts.name("current_pipeline", after)
        self._manifest = manifest

    def forget_stage(self, stage: str) -> None:
        """Remove a stage's record, so that it does not count as done while it runs again."""
        left = {name: record for name, record in self._manifest.stages.items() if name != stage}
        if len(left) < len(self._manifest.stages):
            self._facts.name("stages_begun", stage)
        self._manifest = replace(self._manifest, stages=left)

    def record_stage(self, record: StageRecord) -> None:
        """Record that a stage is done, in place of its earlier record."""
        self._manifest = replace(self._manifest, stages={**self._manifest.stages, record.stage: record})
        self._facts.name("stages_done", record.stage)

    def commit(self) -> Manifest:
        """Publish all changes since the last commit as one new version; without changes, none is made.

        The rows of the journal of labels are published, too.

        Returns
        -------
        Manifest
            The newest version.

        Raises
        ------
        StoreError
            The next version exists already, so that another writer has evaded the lock; nothing is published.
        """
        journals = self._take_over()
        pending = self._manifest
        if self._takes:
            # a column may have been declared after a row was added
            schema = pending.takes_schema
            ordered = (self._takes[take] for take in sorted(self._takes))
            rows = pa.concat_tables(row if row.schema == schema else with_columns(row, schema) for row in ordered)
            part = write_part(self.path, "takes", rows, sorted(self._takes))
            others = tuple(other for other in pending.takes if other.path != part.path)
            pending = replace(pending, takes=(*others, part))
            if self._changes:
                self._changes.append(["rows", part.sha256])
        facts, self._facts = self._facts, Facts()
        if pending == self._committed:
            self._changes = []
            self._empty(journals)
            return self._committed
        if self._changes:
            pending = replace(pending, content=changed_content(pending.content, self._changes))
        version = self._committed.version + 1
        pending = replace(
            pending,
            version=version,
            created=now(),
            next_take_id=self._next,
            kinedex=kinedex_version(),
            command=running_command(),
            changes=facts.encoded,
        )
        publish(self.path, pending)
        self._committed = self._manifest = pending
        self._takes = {}
        self._changes = []
        self._empty(journals)
        return pending

    def _empty(self, journals: Sequence[Journal]) -> None:
        """Empty the files of the journal whose rows the newest version has."""
        for one in journals:
            if one.damaged:
                continue  # `repair` keeps its content first
            with write_errors(one.path):
                empty(one)

    def close(self) -> None:
        """Release the lock; changes that were not committed are dropped.

        After a commit, the database file for other clients is written anew where there is one.
        """
        try:
            if self._committed.version != self._opened and (self.path / DATABASE).is_file():
                from kinedex.storage.store.database_file import refresh_database

                refresh_database(self.path)
        finally:
            self._lock.release()

    def __enter__(self) -> StoreWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _take_rows(self, takes: pa.Table) -> pa.Table:
        """Return rows of takes with all columns; those that may be missing are null."""
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


def _first_version(feature_set: FeatureSet, rate_hz: float) -> Manifest:
    """Return the version of a store without takes."""
    return Manifest(
        FORMAT_VERSION,
        1,
        now(),
        feature_set,
        float(rate_hz),
        1,
        kinedex=kinedex_version(),
        command=running_command(),
    )


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


def _listed(rows: pa.Table, wider: Mapping[str, str]) -> pa.Table:
    """Return rows of takes with lists of one text where a column of texts becomes one of lists."""
    for name in (name for name, kind in wider.items() if kind == "VARCHAR[]" and name in rows.column_names):
        lists = [None if text is None else [text] for text in rows.column(name).to_pylist()]
        rows = rows.set_column(rows.column_names.index(name), name, pa.array(lists, pa.list_(pa.string())))
    return rows


def _without(parts: Iterable[Part], take_ids: Iterable[int], rows: Mapping[int, int]) -> tuple[Part, ...]:
    """Return the parts with more tombstones, except for parts without any live take.

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
