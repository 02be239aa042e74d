"""Restore the content of damaged files: rows of frames, takes and labels, and small files with one flipped bit.

A row group is undamaged if the checksums of its pages match, and if writing its rows again gives the same bytes. The
second test covers the page headers, which have no checksum. Parts that were written by another version of the Parquet
library, or without page checksums, do not pass.
"""

from __future__ import annotations

import hashlib
import io
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from kinedex.ops.errors import StoreError
from kinedex.storage import duckdb_sql
from kinedex.storage.index.generations import FILE, current_generation, file_digest, read_generation
from kinedex.storage.snapshot.label_journal import Journal, journal_rows, read_journals
from kinedex.storage.snapshot.manifest import LabelPart, Manifest, Part, changed_content
from kinedex.storage.snapshot.manifest_files import read_version, versions
from kinedex.storage.snapshot.parts import frames_writer, read_errors, write_part
from kinedex.storage.snapshot.schemas import labels_schema, schema_problem, with_columns
from kinedex.storage.snapshot.snapshot import Snapshot

LARGEST = 24_000
"""The largest size in bytes of a file for `without_flip`; the time, some seconds, grows with the square of the size."""


def without_flip(content: bytes, sha256: str) -> bytes | None:
    """Return the content of a file before one of its bits was flipped; None if no single flip explains the damage.

    Parameters
    ----------
    content : bytes
        The damaged content, at most `LARGEST` bytes.
    sha256 : str
        The checksum of the original content, in hexadecimal.
    """
    if len(content) > LARGEST:
        return None
    wanted, view = bytes.fromhex(sha256), memoryview(content)
    before = hashlib.sha256()
    for place, byte in enumerate(content):
        for bit in range(8):
            attempt = before.copy()
            attempt.update(bytes([byte ^ 1 << bit]))
            attempt.update(view[place + 1 :])
            if attempt.digest() == wanted:
                return content[:place] + bytes([byte ^ 1 << bit]) + content[place + 1 :]
        before.update(view[place : place + 1])
    return None


def sound_takes(
    file: Path, schema: pa.Schema, take_ids: Collection[int], frames: Mapping[int, int]
) -> dict[int, pa.Table]:
    """Return those rows of a damaged part of frames that are proven to be undamaged, by take.

    Parameters
    ----------
    file : Path
        The part.
    schema : pyarrow.Schema
        The required schema.
    take_ids : collection of int
        The takes to look for.
    frames : mapping of int to int
        Id of a take → its number of frames.

    Returns
    -------
    dict of int to pyarrow.Table
        Id of a take → all of its rows, in order of take_id.
    """
    groups = []
    try:
        with pq.ParquetFile(file, page_checksum_verification=True) as part:
            if schema_problem(part.schema_arrow, schema) is not None:
                return {}
            for number in range(part.num_row_groups):
                group = _sound_group(file, part, number, schema)
                if group is not None:
                    groups.append(group)
    except (OSError, pa.ArrowException):
        return {}
    rows = pa.concat_tables([schema.empty_table(), *groups])
    found = {}
    for take in sorted(take_ids):
        own = rows.filter(pc.equal(rows.column("take_id"), take)).combine_chunks()
        if np.array_equal(own.column("frame").to_numpy(), np.arange(frames[take])):
            found[take] = own
    return found


def _sound_group(file: Path, part: pq.ParquetFile, number: int, schema: pa.Schema) -> pa.Table | None:
    """Return the rows of a row group; None unless they are undamaged."""
    try:
        rows = part.read_row_group(number).cast(schema)
    except (OSError, pa.ArrowException):
        return None
    sink = io.BytesIO()
    with frames_writer(sink, schema) as writer:
        writer.write_table(rows.combine_chunks(), row_group_size=max(1, rows.num_rows))
    again = sink.getvalue()
    start, stop = _extent(part.metadata, number)
    first, last = _extent(pq.read_metadata(io.BytesIO(again)), 0)
    with open(file, "rb") as content:
        content.seek(start)
        return rows if content.read(stop - start) == again[first:last] else None


def _extent(metadata: pq.FileMetaData, number: int) -> tuple[int, int]:
    """Return the bytes [start, stop) of a row group in its file."""
    group = metadata.row_group(number)
    columns = [group.column(column) for column in range(group.num_columns)]
    start = min(
        column.data_page_offset if column.dictionary_page_offset is None else column.dictionary_page_offset
        for column in columns
    )
    return start, start + sum(column.total_compressed_size for column in columns)


@dataclass(frozen=True)
class RestoredRows:
    """The rows of takes that were restored from damaged parts.

    Attributes
    ----------
    rows : pyarrow.Table
        The restored rows, in order of take_id.
    lost : tuple of int
        Ids of the takes that could not be restored.
    """

    rows: pa.Table
    lost: tuple[int, ...]


def restored_rows(store: Snapshot, bad: Iterable[Part]) -> RestoredRows:
    """Find the rows of the live takes of damaged takes parts.

    The rows are read from the index of the same takes if its checksum matches, and otherwise from the parts of older
    versions with the same takes.

    Parameters
    ----------
    store : Snapshot
        The store.
    bad : iterable of Part
        The damaged parts of takes.
    """
    missing = {take for part in bad for take in part.live}
    found = [store.manifest.takes_schema.empty_table()]
    for table in (*_of_index(store), *_of_older_versions(store)):
        rows = table.filter(pc.is_in(table.column("take_id"), pa.array(missing, pa.int64())))
        found.append(rows)
        missing -= set(rows.column("take_id").to_pylist())
        if not missing:
            break
    return RestoredRows(pa.concat_tables(found).sort_by("take_id").combine_chunks(), tuple(sorted(missing)))


def with_rows(store: Snapshot, bad: list[Part], restored: RestoredRows) -> Manifest:
    """Write the restored rows as a new part, and return a manifest that names it without the lost takes.

    A single damaged part with all rows restored is written again under its name; then the manifest is unchanged.

    Parameters
    ----------
    store : Snapshot
        The store.
    bad : list of Part
        The damaged parts of takes.
    restored : RestoredRows
        The rows of their live takes.
    """
    manifest = store.manifest
    ids = restored.rows.column("take_id").to_pylist()
    new = [write_part(store.path, "takes", restored.rows, ids)] if ids else []
    if len(bad) == 1 and new and new[0].sha256 == bad[0].sha256:
        return manifest
    wrong = {part.path for part in bad}
    parts = (*(part for part in manifest.takes if part.path not in wrong), *new)
    manifest = replace(manifest, takes=parts)
    if not restored.lost:
        return manifest
    frames = tuple(_without(store, part, set(restored.lost)) for part in manifest.frames)
    content = changed_content(manifest.content, ["dropped", list(restored.lost)])
    return replace(manifest, frames=tuple(part for part in frames if part.live), content=content)


def _without(store: Snapshot, part: Part, lost: set[int]) -> Part:
    """Return a part of frames with the lost takes marked as dropped."""
    gone = lost.intersection(part.live)
    if not gone or gone == set(part.live):
        return replace(part, dropped=part.take_ids) if gone else part
    rows = 0
    with suppress(StoreError), read_errors(store.path / part.path):
        ids = pq.read_table(store.checked.part(part), columns=["take_id"]).column("take_id")
        rows = pc.sum(pc.is_in(ids, pa.array(gone, pa.int64()))).as_py()
    # the number of rows is unknown for a damaged part, whose other takes are read again anyway
    return replace(part, dropped=tuple(sorted({*part.dropped, *gone})), dropped_rows=part.dropped_rows + rows)


def _of_index(store: Snapshot) -> Iterator[pa.Table]:
    generation = current_generation(store.path, store.manifest)
    record = read_generation(generation) if generation is not None else None
    if generation is None or record is None or file_digest(generation / FILE) != record.xxh3:
        return
    try:
        with duckdb_sql.connect() as connection:
            connection.execute(f"ATTACH {duckdb_sql.quote(str((generation / FILE).absolute()))} AS idx (READ_ONLY)")
            yield with_columns(duckdb_sql.rows(connection, "SELECT * FROM idx.takes"), store.manifest.takes_schema)
    except (duckdb_sql.Error, pa.ArrowException):
        return


def _of_older_versions(store: Snapshot) -> Iterator[pa.Table]:
    for version in reversed(versions(store.path)):
        try:
            older = read_version(store.path, version)
            if older.content == store.manifest.content and older.takes != store.manifest.takes:
                yield with_columns(Snapshot(store.path, older).take_rows, store.manifest.takes_schema)
        except StoreError:
            continue


@dataclass(frozen=True)
class RestoredLabels:
    """A manifest without damaged parts of labels, and the numbers of restored and lost rows.

    Attributes
    ----------
    manifest : Manifest
        The version to publish, or the current one if the damaged part itself was restored.
    restored : int
        Number of rows found in undamaged parts of older versions.
    lost : int
        Number of rows of the damaged parts minus `restored`; rows that are only in the journal count as lost.
    journals : tuple of Journal
        The journal files whose undamaged rows are in the version.
    """

    manifest: Manifest
    restored: int
    lost: int
    journals: tuple[Journal, ...]


def restored_labels(store: Snapshot, bad: list[LabelPart]) -> RestoredLabels:
    """Write a new part with the rows of damaged parts that older versions or the journal still have.

    Parameters
    ----------
    store : Snapshot
        The store.
    bad : list of LabelPart
        The damaged parts of labels.
    """
    sound = [part for part in store.manifest.labels if part not in bad]
    known = _ids(store, sound)
    found: list[pa.Table] = []
    for version in reversed(versions(store.path)):
        try:
            parts = read_version(store.path, version).labels
        except StoreError:
            continue
        for part in parts:
            rows = _rows(store, part) if part not in bad else None
            if rows is not None:
                new = rows.filter(pc.invert(pc.is_in(rows.column("id"), pa.array(known, pa.string()))))
                known |= set(new.column("id").to_pylist())
                found.append(new)
    journals = tuple(read_journals(store.path))
    restored = sum(rows.num_rows for rows in found)
    rows = pa.concat_tables([labels_schema().empty_table(), *found, journal_rows(journals, known)]).sort_by("created")
    wanted = sum(part.rows for part in bad)
    labels = tuple(sound)
    if rows.num_rows:
        made = write_part(store.path, "labels", rows.replace_schema_metadata(labels_schema().metadata))
        labels += (LabelPart(made.path, made.rows, made.bytes, made.sha256, made.xxh3),)
    return RestoredLabels(replace(store.manifest, labels=labels), restored, wanted - restored, journals)


def _ids(store: Snapshot, parts: list[LabelPart]) -> set[str]:
    return {one for part in parts if (rows := _rows(store, part)) is not None for one in rows.column("id").to_pylist()}


def _rows(store: Snapshot, part: LabelPart) -> pa.Table | None:
    """Return the rows of a part of labels; None if it is damaged."""
    try:
        return Snapshot(store.path, replace(store.manifest, labels=(part,)), store.checked).labels(history=True)
    except StoreError:
        return None
