"""Reading frames parts: the words of many takes at once, and the rows of one take."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from ops.errors import StoreError
from ops.words import NO_WORD, TakeWords
from storage.manifest import Manifest, Part
from storage.parts import part_file

I64 = npt.NDArray[np.int64]


def read_words(store: Path, manifest: Manifest, take_ids: Sequence[int] | None) -> TakeWords:
    """Read the words of the takes asked for (all live ones for None), in order of take_id.

    Only the columns take_id and word of the parts and row groups that hold these takes are read.
    """
    wanted = sorted({int(take) for take in (manifest.live_takes if take_ids is None else take_ids)})
    homes = {take: part for part in manifest.frames for take in part.live}
    unknown = [take for take in wanted if take not in homes]
    if unknown:
        shown = ", ".join(map(str, unknown[:5]))
        raise StoreError(f"{store}: no live take has the id {shown}; `Store.takes()` lists those that are")
    places = {take: place for place, take in enumerate(wanted)}
    found: list[npt.NDArray[np.uint64]] = [np.empty(0, np.uint64)] * len(wanted)
    for part in manifest.frames:
        here = [take for take in part.live if take in places]
        for take, words in _part_words(store, part, here) if here else ():
            found[places[take]] = words
    offsets = np.zeros(len(wanted) + 1, np.int64)
    np.cumsum([len(words) for words in found], out=offsets[1:])
    words = np.concatenate(found) if found else np.empty(0, np.uint64)
    return TakeWords(np.array(wanted, np.int64), offsets, words)


def _part_words(store: Path, part: Part, takes: list[int]) -> Iterator[tuple[int, npt.NDArray[np.uint64]]]:
    table = _read(store, part, ["take_id", "word"], min(takes), max(takes))
    ids = table.column("take_id").to_numpy()
    words = words_of(table)
    asked = np.array(takes, np.int64)
    starts = np.searchsorted(ids, asked, side="left")
    stops = np.searchsorted(ids, asked, side="right")
    for take, start, stop in zip(takes, starts, stops, strict=True):
        yield take, words[start:stop]


def words_of(frames: pa.Table) -> npt.NDArray[np.uint64]:
    """The words of rows of a frames part, uint64; `NO_WORD` where a frame is invalid."""
    words: npt.NDArray[np.uint64] = frames.column("word").fill_null(NO_WORD.item()).to_numpy()
    return words


def read_frames(store: Path, manifest: Manifest, take_id: int, start: int, stop: int) -> pa.Table:
    """Read the rows of frames [start, stop) of one live take, all columns."""
    part = next(part for part in manifest.frames if take_id in part.live)
    table = _read(store, part, None, take_id, take_id)
    ids = table.column("take_id").to_numpy()
    first = int(np.searchsorted(ids, take_id, side="left"))
    return table.slice(first + start, stop - start).combine_chunks()


def _read(store: Path, part: Part, columns: list[str] | None, lowest: int, highest: int) -> pa.Table:
    """Read the row groups that can hold takes from lowest to highest; the parts are sorted by take."""
    path = part_file(store, part.path)
    try:
        with pq.ParquetFile(path) as file:
            column = file.schema_arrow.get_field_index("take_id")
            groups = []
            for group in range(file.num_row_groups):
                known = file.metadata.row_group(group).column(column).statistics
                if known is None or not known.has_min_max or (known.min <= highest and known.max >= lowest):
                    groups.append(group)
            return file.read_row_groups(groups, columns)
    except (OSError, pa.ArrowException) as fault:
        reason = str(fault).splitlines()[0]
        raise StoreError(f"{path}: the part cannot be read: {reason}; see `kinedex verify`") from None
