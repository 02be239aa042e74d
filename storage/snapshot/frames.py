"""Read the Parquet parts with frames: the words of many takes at once, or the rows of takes and intervals."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from kinedex.ops.errors import StoreError
from kinedex.ops.words import NO_WORD, TakeWords
from kinedex.storage.snapshot.checked_files import CheckedFiles
from kinedex.storage.snapshot.manifest import Manifest, Part
from kinedex.storage.snapshot.parts import read_errors

I64 = npt.NDArray[np.int64]

FOOTERS = 64
"""The number of footers that are cached; that of a full part takes some 200 KB and a millisecond to read."""

_MAX_INT64 = np.iinfo(np.int64).max
_ANY = (np.iinfo(np.int64).min, _MAX_INT64)


@dataclass(frozen=True)
class Footer:
    """The footer of a frames part with R row groups.

    Attributes
    ----------
    metadata : pyarrow.parquet.FileMetaData
        Metadata with which Arrow reads the file without reading its footer again.
    takes : int64 array (R, 2)
        The lowest and the highest id of a take in each row group.
    frames : int64 array (R, 2)
        The lowest and the highest number of a frame in each row group.
    """

    metadata: pq.FileMetaData
    takes: I64
    frames: I64

    def groups_between(self, lowest: int, highest: int) -> list[int]:
        """Return the row groups that can contain takes with ids from lowest to highest."""
        found: list[int] = np.flatnonzero((self.takes[:, 0] <= highest) & (self.takes[:, 1] >= lowest)).tolist()
        return found

    def groups(self, take_id: int, start: int, stop: int) -> list[int]:
        """Return the row groups that can contain the frames [start, stop) of a take; none for an empty range."""
        if start >= stop:
            return []
        found = np.array(self.groups_between(take_id, take_id), np.int64)
        alone = (self.takes[found] == take_id).all(axis=1)
        first, last = np.where(alone, self.frames[found].T, [[0], [_MAX_INT64]])
        # the frame range of a row group with several takes may be that of another take; the neighbouring row groups
        # that have this take only give its bounds
        first[1:] = np.where(alone[1:] | ~alone[:-1], first[1:], last[:-1] + 1)
        last[:-1] = np.where(alone[:-1] | ~alone[1:], last[:-1], first[1:] - 1)
        chosen: list[int] = found[(first < stop) & (last >= start)].tolist()
        return chosen


def footer_of(file: Path) -> Footer:
    """Return the footer of a frames part whose checksum has been checked.

    A part is named after its content, and never rewritten, so that a cached footer is valid as long as the file exists.
    """
    status = file.stat()
    return _read_footer(str(file), status.st_ino, status.st_size, status.st_mtime_ns)


@lru_cache(FOOTERS)
def _read_footer(file: str, _inode: int, _bytes: int, _mtime_ns: int) -> Footer:
    with pq.ParquetFile(file) as opened:
        metadata, names = opened.metadata, opened.schema_arrow
    takes, frames = (_bounds(metadata, names.get_field_index(name)) for name in ("take_id", "frame"))
    return Footer(metadata, takes, frames)


def _bounds(metadata: pq.FileMetaData, column: int) -> I64:
    """Return the smallest and the largest value of a column in each row group; the full integer range if unknown."""
    statistics = [metadata.row_group(group).column(column).statistics for group in range(metadata.num_row_groups)]
    known = [(one.min, one.max) if one is not None and one.has_min_max else _ANY for one in statistics]
    return np.array(known, np.int64).reshape(-1, 2)


def read_words(files: CheckedFiles, manifest: Manifest, take_ids: Sequence[int] | None) -> TakeWords:
    """Read the words of takes in order of take_id.

    Only the columns take_id and word of the parts and row groups that hold these takes are read.

    Parameters
    ----------
    files : CheckedFiles
        The files of the store.
    manifest : Manifest
        The version to read.
    take_ids : sequence of int or None
        The takes to read; None for all live takes.

    Raises
    ------
    StoreError
        No live take has one of the ids, or a part cannot be read.
    """
    alive = manifest.live_takes
    wanted = alive if take_ids is None else sorted({int(take) for take in take_ids})
    if take_ids is not None and (unknown := sorted(set(wanted).difference(alive))):
        shown = ", ".join(map(str, unknown[:5]))
        raise StoreError(f"{files.store}: no live take has the id {shown}; `Store.takes()` lists the live takes")
    asked = np.array(wanted, np.int64)
    read = [_part_words(files, part, here) for part in manifest.frames if (here := _live_in(part, asked)) is not None]
    ids = np.concatenate([np.empty(0, np.int64), *(takes for takes, _, _ in read)])
    lengths = np.concatenate([np.empty(0, np.int64), *(counts for _, counts, _ in read)])
    # copy even a single part: Arrow's memory is read-only, and kernels would be compiled again for read-only arrays
    words = np.concatenate([np.empty(0, np.uint64), *(found for *_, found in read)])
    offsets = np.concatenate([[0], np.cumsum(lengths)])
    if np.any(np.diff(ids) < 0):
        # takes of several parts interleave
        order = np.argsort(ids)
        ids, lengths, starts = ids[order], lengths[order], offsets[:-1][order]
        offsets = np.concatenate([[0], np.cumsum(lengths)])
        words = words[np.arange(len(words)) + np.repeat(starts - offsets[:-1], lengths)]
    return TakeWords(ids, offsets, words)


def _live_in(part: Part, asked: I64) -> I64 | None:
    """Return the requested takes that are live in a part; None if there are none."""
    live = np.array(part.live, np.int64)
    places = np.searchsorted(asked, live)
    live, places = live[places < len(asked)], places[places < len(asked)]
    here = live[asked[places] == live]
    return here if len(here) else None


def _part_words(files: CheckedFiles, part: Part, takes: I64) -> tuple[I64, I64, npt.NDArray[np.uint64]]:
    """Return ids, numbers of frames, and words of the requested takes in one part; a whole part is not copied."""
    path = files.part(part)
    with read_errors(path):
        footer = footer_of(path)
        with pq.ParquetFile(path, metadata=footer.metadata) as file:
            groups = footer.groups_between(int(takes[0]), int(takes[-1]))  # parts are sorted by take
            table = file.read_row_groups(groups, ["take_id", "word"])
    ids = table.column("take_id").to_numpy()
    words = words_of(table)
    starts = np.searchsorted(ids, takes, side="left")
    lengths = np.searchsorted(ids, takes, side="right") - starts
    if int(lengths.sum()) != len(words):
        words = words[np.arange(lengths.sum()) + np.repeat(starts - (np.cumsum(lengths) - lengths), lengths)]
    return takes, lengths, words


def words_of(frames: pa.Table) -> npt.NDArray[np.uint64]:
    """Return the words of rows of a frames part, uint64; `NO_WORD` for invalid frames."""
    column = frames.column("word")
    if column.null_count:  # the module that fills nulls takes long to import
        column = column.fill_null(NO_WORD.item())
    words: npt.NDArray[np.uint64] = column.to_numpy()
    return words


def read_frames(
    files: CheckedFiles, manifest: Manifest, take_id: int, start: int, stop: int, columns: Sequence[str] | None = None
) -> pa.Table:
    """Read the rows of frames [start, stop) of one live take: take_id and the given columns, or all columns."""
    part = next(part for part in manifest.frames if take_id in part.live)
    path = files.part(part)
    with read_errors(path):
        footer = footer_of(path)
        with pq.ParquetFile(path, metadata=footer.metadata) as file:
            table = file.read_row_groups(footer.groups(take_id, start, stop), _placed(columns))
    first, last = _rows(table, take_id, start, stop)
    return _wanted(table.slice(first, last - first), columns).combine_chunks()


def read_intervals(
    files: CheckedFiles, manifest: Manifest, intervals: Sequence[tuple[int, int, int]], columns: Sequence[str]
) -> Iterator[tuple[int, pa.Table]]:
    """Yield the index and the rows of each of the given intervals; every row group is read once.

    Parameters
    ----------
    files : CheckedFiles
        The files of the store.
    manifest : Manifest
        The version to read.
    intervals : sequence of (int, int, int)
        Ids of live takes with ranges of frames [start, stop), none of them empty.
    columns : sequence of str
        The columns to read beside take_id.
    """
    order = sorted(range(len(intervals)), key=intervals.__getitem__)
    for part in manifest.frames:
        live = set(part.live)
        wanted = [place for place in order if intervals[place][0] in live]
        if not wanted:
            continue
        path = files.part(part)
        with read_errors(path):
            yield from ((place, _wanted(rows, columns)) for place, rows in _of_part(path, intervals, wanted, columns))


def _of_part(
    path: Path, intervals: Sequence[tuple[int, int, int]], wanted: Sequence[int], columns: Sequence[str]
) -> Iterator[tuple[int, pa.Table]]:
    """Yield the index and the rows of each interval whose take is in a part."""
    footer = footer_of(path)
    places_of: dict[int, list[int]] = {}
    for place in wanted:
        for group in footer.groups(*intervals[place]):
            places_of.setdefault(group, []).append(place)
    missing = {place: intervals[place][2] - intervals[place][1] for place in wanted}
    held: dict[int, list[pa.Table]] = {}
    with pq.ParquetFile(path, metadata=footer.metadata) as file:
        for group in sorted(places_of):
            table = file.read_row_group(group, _placed(columns))
            for place in places_of[group]:
                first, last = _rows(table, *intervals[place])
                if first < last:
                    held.setdefault(place, []).append(table.slice(first, last - first))
                    missing[place] -= last - first
                    if not missing[place]:
                        yield place, pa.concat_tables(held.pop(place))


def _placed(columns: Sequence[str] | None) -> list[str] | None:
    """Return the given columns and those that identify take and frame; None if all columns are requested."""
    return None if columns is None else list(dict.fromkeys(["take_id", "frame", *columns]))


def _wanted(table: pa.Table, columns: Sequence[str] | None) -> pa.Table:
    return table if columns is None or "frame" in columns else table.drop_columns("frame")


def _rows(table: pa.Table, take_id: int, start: int, stop: int) -> tuple[int, int]:
    """Return the range of rows of a table that contains the frames [start, stop) of a take."""
    ids = table.column("take_id").to_numpy()
    first, last = np.searchsorted(ids, take_id, "left"), np.searchsorted(ids, take_id, "right")
    frames = table.column("frame").slice(first, last - first).to_numpy()
    return int(first + np.searchsorted(frames, start)), int(first + np.searchsorted(frames, stop))


def read_takes(
    files: CheckedFiles, manifest: Manifest, take_ids: Iterable[int], columns: Sequence[str] | None = None
) -> Iterator[tuple[int, pa.Table]]:
    """Yield the id and the rows of each live take, in the order of the parts; every row group is read once.

    The rows have take_id and the given columns, or all columns.
    """
    asked = set(take_ids)
    for part in manifest.frames:
        wanted = np.array(sorted(asked.intersection(part.live)), np.int64)
        if not len(wanted):
            continue
        path = files.part(part)
        with read_errors(path):
            footer = footer_of(path)
            held: dict[int, list[pa.Table]] = {}
            with pq.ParquetFile(path, metadata=footer.metadata) as file:
                for group in footer.groups_between(int(wanted[0]), int(wanted[-1])):
                    table = file.read_row_group(group, None if columns is None else ["take_id", *columns])
                    ids = table.column("take_id").to_numpy()
                    for take_id in wanted[(wanted >= ids[0]) & (wanted <= ids[-1])].tolist():
                        first, last = np.searchsorted(ids, take_id, "left"), np.searchsorted(ids, take_id, "right")
                        if first < last:
                            held.setdefault(take_id, []).append(table.slice(first, last - first))
                    for take_id in [one for one in held if one < ids[-1]]:
                        yield take_id, pa.concat_tables(held.pop(take_id)).combine_chunks()
                for take_id, tables in held.items():
                    yield take_id, pa.concat_tables(tables).combine_chunks()
