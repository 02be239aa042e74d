"""Restore labels of damaged parts from older versions that have their rows in other parts."""

from __future__ import annotations

from dataclasses import dataclass, replace

import pyarrow as pa
import pyarrow.compute as pc

from kinedex.ops.errors import StoreError
from kinedex.storage.snapshot.label_journal import Journal, journal_rows, read_journals
from kinedex.storage.snapshot.manifest import Manifest
from kinedex.storage.snapshot.manifest_files import read_version, versions
from kinedex.storage.snapshot.part_records import LabelPart
from kinedex.storage.snapshot.parts import write_part
from kinedex.storage.snapshot.schemas import labels_schema
from kinedex.storage.snapshot.snapshot import Snapshot


@dataclass(frozen=True)
class RestoredLabels:
    """A manifest without damaged parts of labels, and what was restored.

    Attributes
    ----------
    manifest : Manifest
        The version to publish, or the current one if the damaged part itself was restored.
    restored : int
        Number of rows found in undamaged parts of older versions.
    lost : int
        Number of rows found in no undamaged part.
    journals : tuple of Journal
        The journal files whose undamaged rows are in the version.
    """

    manifest: Manifest
    restored: int
    lost: int
    journals: tuple[Journal, ...]


def restored_labels(store: Snapshot, bad: list[LabelPart]) -> RestoredLabels:
    """Collect the rows of damaged parts from undamaged parts of older versions and the journal, as a new part.

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
