"""Reading of frames parts: the words of many takes at once, and the rows of one take."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from kinedex.ops.errors import StoreError
from kinedex.ops.words import NO_WORD, TakeWords
from kinedex.storage.snapshot.checked_files import CheckedFiles
from kinedex.storage.snapshot.manifest import Manifest
from kinedex.storage.snapshot.part_records import Part
from kinedex.storage.snapshot.parts import read_errors

I64 = npt.NDArray[np.int64]


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
        raise StoreError(f"{files.store}: no live take has the id {shown}; `Store.takes()` lists those that are")
    asked = np.array(wanted, np.int64)
    read = [_part_words(files, part, here) for part in manifest.frames if (here := _here(part, asked)) is not None]
    ids = np.concatenate([np.empty(0, np.int64), *(takes for takes, _, _ in read)])
    lengths = np.concatenate([np.empty(0, np.int64), *(counts for _, counts, _ in read)])
    # a copy even of a single part: what Arrow holds cannot be written to, and kernels would be compiled for it anew
    words = np.concatenate([np.empty(0, np.uint64), *(found for *_, found in read)])
    offsets = np.concatenate([[0], np.cumsum(lengths)])
    if np.any(np.diff(ids) < 0):
        # the takes of several parts interleave
        order = np.argsort(ids)
        ids, lengths, starts = ids[order], lengths[order], offsets[:-1][order]
        offsets = np.concatenate([[0], np.cumsum(lengths)])
        words = words[np.arange(len(words)) + np.repeat(starts - offsets[:-1], lengths)]
    return TakeWords(ids, offsets, words)


def _here(part: Part, asked: I64) -> I64 | None:
    """Return the wanted takes that are live in a part; None if there are none."""
    live = np.array(part.live, np.int64)
    places = np.searchsorted(asked, live)
    live, places = live[places < len(asked)], places[places < len(asked)]
    here = live[asked[places] == live]
    return here if len(here) else None


def _part_words(files: CheckedFiles, part: Part, takes: I64) -> tuple[I64, I64, npt.NDArray[np.uint64]]:
    """Return the wanted takes of one part, their lengths, and their words; no copy of a whole part."""
    table = _read(files, part, ["take_id", "word"], int(takes[0]), int(takes[-1]))
    ids = table.column("take_id").to_numpy()
    words = words_of(table)
    starts = np.searchsorted(ids, takes, side="left")
    lengths = np.searchsorted(ids, takes, side="right") - starts
    if int(lengths.sum()) != len(words):
        words = words[np.arange(lengths.sum()) + np.repeat(starts - (np.cumsum(lengths) - lengths), lengths)]
    return takes, lengths, words


def words_of(frames: pa.Table) -> npt.NDArray[np.uint64]:
    """Return the words of rows of a frames part, uint64; `NO_WORD` where a frame is invalid."""
    words: npt.NDArray[np.uint64] = frames.column("word").fill_null(NO_WORD.item()).to_numpy()
    return words


def read_frames(
    files: CheckedFiles, manifest: Manifest, take_id: int, start: int, stop: int, columns: Sequence[str] | None = None
) -> pa.Table:
    """Read the rows of frames [start, stop) of one live take: take_id and the columns that are asked for, or all."""
    part = next(part for part in manifest.frames if take_id in part.live)
    table = _read(files, part, None if columns is None else ["take_id", *columns], take_id, take_id)
    ids = table.column("take_id").to_numpy()
    first = int(np.searchsorted(ids, take_id, side="left"))
    return table.slice(first + start, stop - start).combine_chunks()


def read_takes(
    files: CheckedFiles, manifest: Manifest, take_ids: Iterable[int], columns: Sequence[str] | None = None
) -> Iterator[tuple[int, pa.Table]]:
    """Yield the rows of live takes with their ids, in the order of the parts; every row group is read once.

    The rows have take_id and the columns that are asked for, or all.
    """
    asked = set(take_ids)
    for part in manifest.frames:
        wanted = np.array(sorted(asked.intersection(part.live)), np.int64)
        if not len(wanted):
            continue
        path = files.part(part)
        with read_errors(path), pq.ParquetFile(path) as file:
            held: dict[int, list[pa.Table]] = {}
            for group in _groups(file, int(wanted[0]), int(wanted[-1])):
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


def _groups(file: pq.ParquetFile, lowest: int, highest: int) -> list[int]:
    """Return the row groups that can hold takes from lowest to highest."""
    column = file.schema_arrow.get_field_index("take_id")
    groups = []
    for group in range(file.num_row_groups):
        known = file.metadata.row_group(group).column(column).statistics
        if known is None or not known.has_min_max or (known.min <= highest and known.max >= lowest):
            groups.append(group)
    return groups


def _read(files: CheckedFiles, part: Part, columns: list[str] | None, lowest: int, highest: int) -> pa.Table:
    """Read the row groups that can hold takes from lowest to highest; the parts are sorted by take."""
    path = files.part(part)
    with read_errors(path), pq.ParquetFile(path) as file:
        return file.read_row_groups(_groups(file, lowest, highest), columns)
