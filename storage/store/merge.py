"""Merge two stores: add the takes and labels of one to the other, with new ids."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from kinedex.ops.errors import StoreError
from kinedex.storage.snapshot.manifest import Manifest, Part
from kinedex.storage.snapshot.parts import FramesWriter, read_errors
from kinedex.storage.snapshot.schemas import column_problem, with_columns
from kinedex.storage.store.store import Store
from kinedex.storage.store.writer import StoreWriter

_NAMED = 5


@dataclass(frozen=True)
class MergeResult:
    """Counts of what a merge has added from the other store.

    Attributes
    ----------
    takes : int
        Number of takes.
    frames : int
        Number of their frames.
    labels : int
        Number of rows of labels, including replaced ones.
    kept_mappings : tuple of str
        Names of skeleton mappings that differ between the stores; those of the first store are kept.
    """

    takes: int
    frames: int
    labels: int
    kept_mappings: tuple[str, ...]


def merge_store(
    writer: StoreWriter, other: Store, prefix: str = "", progress: Callable[[int], None] = lambda takes: None
) -> MergeResult:
    """Add the takes and labels of another store, and commit them as one version.

    Frames are copied unchanged, with new ids of takes, and no motion file is read. Results are not copied. If the
    process is killed before the commit, the store is unchanged, and the next writer removes the copied files.

    Parameters
    ----------
    writer : StoreWriter
        The writer of the store to which the takes are added.
    other : Store
        The store whose takes are added, which is not changed.
    prefix : str, optional
        Prefix for the names of the other store's takes.
    progress : callable, optional
        Called after each copied part of frames, with its number of takes.

    Raises
    ------
    StoreError
        Both stores are the same; feature sets, rates or declared columns differ; takes have equal names; or a part of
        the other store is damaged. Nothing is changed.
    """
    _require_fitting(writer, other)
    renamed = {name: f"{prefix}{name}" for name in other.take_ids}
    _require_new_names(writer.store, renamed, other)
    # assign ids in the order of the other store's ids, by which its parts are sorted
    by_id = sorted(other.take_ids.items(), key=lambda pair: pair[1])
    ids = {take: writer.assign_take_ids([renamed[name]])[renamed[name]] for name, take in by_id}
    parts = []
    for part in other.manifest.frames:
        parts.append(_copied(writer, other, part, ids))
        progress(len(part.live))
    rows = other.take_rows
    names = pa.array([renamed[name] for name in rows.column("name").to_pylist()], pa.string())
    numbers = pa.array([ids[take] for take in rows.column("take_id").to_pylist()], pa.int64())
    for column, values in (("name", names), ("take_id", numbers)):
        rows = rows.set_column(rows.schema.get_field_index(column), column, values)
    writer.declare_columns(other.manifest.columns)
    if parts:
        writer.add_takes(rows, parts)
    labels = other.labels(history=True)
    names = pa.array([f"{prefix}{name}" for name in labels.column("take").to_pylist()], pa.string())
    labels = labels.set_column(labels.schema.get_field_index("take"), "take", names)
    put = int(writer.put_labels(labels.replace_schema_metadata(None)).num_rows)
    kept = _put_sources(writer, other.manifest)
    writer.commit()
    return MergeResult(len(ids), sum(other.take_frames.values()), put, kept)


def _require_fitting(writer: StoreWriter, other: Store) -> None:
    """Raise a StoreError if both stores are the same, or their words or columns are not compatible."""
    mine, theirs = writer.manifest, other.manifest
    if writer.path.resolve() == other.path.resolve():
        raise StoreError(f"{other.path} is the store itself; name another one")
    if mine.feature_set.digest != theirs.feature_set.digest:
        raise StoreError(
            f"{other.path} has the feature set {theirs.feature_set.name} version {theirs.feature_set.version}, "
            f"{writer.path} has {mine.feature_set.name} version {mine.feature_set.version}; one store "
            "holds words of one feature set: ingest the files of one of them with the features of the other"
        )
    if mine.rate_hz != theirs.rate_hz:
        raise StoreError(
            f"{other.path} holds frames at {theirs.rate_hz:g} Hz, {writer.path} at {mine.rate_hz:g} Hz; ingest the "
            "files of one of them at the rate of the other"
        )
    for name, column in theirs.columns.items():
        if (problem := column_problem(name, column, mine.columns)) is not None:
            raise StoreError(
                f"{other.path}: its takes have a column '{name}' that {writer.path} cannot have: {problem}; ingest "
                "its files again with another name of that column"
            )


def _require_new_names(store: Store, renamed: Mapping[str, str], other: Store) -> None:
    both = sorted(name for name in renamed.values() if name in store.take_ids)
    if both:
        shown = ", ".join(f"'{name}'" for name in both[:_NAMED])
        more = f" and {len(both) - _NAMED:,} more" if len(both) > _NAMED else ""
        raise StoreError(
            f"both stores have {'a take' if len(both) == 1 else f'{len(both):,} takes'} named {shown}{more}; "
            f"--prefix TEXT- puts a text before the names of the takes of {other.path}"
        )


def _copied(writer: StoreWriter, other: Store, part: Part, ids: Mapping[int, int]) -> Part:
    """Copy the live rows of a part of frames with their new ids."""
    file = other.checked.part(part)
    manifest = writer.manifest
    live = np.array(part.live, np.int64)
    new = np.array([ids[take] for take in part.live], np.int64)

    def pieces() -> Iterator[pa.Table]:
        with read_errors(file), pq.ParquetFile(file) as opened:
            for group in range(opened.num_row_groups):
                rows = with_columns(opened.read_row_group(group), frames.schema)
                takes = rows.column("take_id").to_numpy()
                place = np.minimum(np.searchsorted(live, takes), len(live) - 1)
                keep = live[place] == takes
                taken = pa.array(new[place[keep]], pa.int64())
                rows = rows if keep.all() else rows.filter(pa.array(keep))
                yield rows.set_column(0, frames.schema.field(0), taken)

    with FramesWriter(writer.path, manifest.feature_set, manifest.rate_hz) as frames:
        frames.add_pieces(new.tolist(), pieces())
        return frames.close()


def _put_sources(writer: StoreWriter, theirs: Manifest) -> tuple[str, ...]:
    """Add source settings and mappings that the store lacks; return the names of mappings that differ."""
    mine = writer.manifest
    for root, source in theirs.sources.items():
        if root not in mine.sources:
            writer.record_source(root, source.stage, source.settings)
    for name, text in theirs.mappings.items():
        if name not in mine.mappings:
            writer.put_mapping(name, text)
    for root, paths in theirs.removed_files.items():
        writer.remove_files(root, paths)
    return tuple(sorted(name for name, text in theirs.mappings.items() if mine.mappings.get(name, text) != text))
