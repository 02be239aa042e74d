"""Restore rows of takes from damaged parts, from the index of the same takes or an older version of the store."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from kinedex.ops.errors import StoreError
from kinedex.storage import duck
from kinedex.storage.index.generations import FILE, current_generation, file_digest, read_generation
from kinedex.storage.snapshot.manifest import Manifest, changed_content
from kinedex.storage.snapshot.manifest_files import read_version, versions
from kinedex.storage.snapshot.part_records import Part
from kinedex.storage.snapshot.parts import read_errors, write_part
from kinedex.storage.snapshot.schemas import with_columns
from kinedex.storage.snapshot.snapshot import Snapshot


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

    They are read from the index of exactly these takes, whose checksum must match, then from the parts of older
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
    # unknown for a damaged part, whose other takes are read again anyway
    return replace(part, dropped=tuple(sorted({*part.dropped, *gone})), dropped_rows=part.dropped_rows + rows)


def _of_index(store: Snapshot) -> Iterator[pa.Table]:
    generation = current_generation(store.path, store.manifest)
    record = read_generation(generation) if generation is not None else None
    if generation is None or record is None or file_digest(generation / FILE) != record.xxh3:
        return
    try:
        with duck.connect() as connection:
            connection.execute(f"ATTACH {duck.quote(str((generation / FILE).absolute()))} AS idx (READ_ONLY)")
            yield with_columns(duck.rows(connection, "SELECT * FROM idx.takes"), store.manifest.takes_schema)
    except (duck.Error, pa.ArrowException):
        return


def _of_older_versions(store: Snapshot) -> Iterator[pa.Table]:
    for version in reversed(versions(store.path)):
        try:
            older = read_version(store.path, version)
            if older.content == store.manifest.content and older.takes != store.manifest.takes:
                yield with_columns(Snapshot(store.path, older).take_rows, store.manifest.takes_schema)
        except StoreError:
            continue
