"""Slice files: the bit slices of one shard each, written once and mapped by every process that searches.

All processes of a machine share the mapped pages, and only pages that are used are read. A mapped file stays readable
after it has been removed (Windows refuses to remove it).

The file is little-endian. Its head has 64 bytes: the eight letters of `MAGIC`, then as uint64 `LAYOUT` and the numbers
of features f, takes T and blocks B, then zeros. After it come take_ids, int64 (T,), ascending, and the arrays of
`ops.search.bit_slices.BitSlices` in the order of `_shapes`, each from the next multiple of 64 bytes on.
"""

from __future__ import annotations

import hashlib
import mmap
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from kinedex.ops.errors import StoreError
from kinedex.ops.search.bit_slices import BLOCK, BitSlices, coarse_words
from kinedex.ops.words import I64, MOST_FEATURES
from kinedex.storage.index.generations import BUILD, Generation, Shard, slices_name

MAGIC = b"KDXSLICE"

LAYOUT = 1
"""Version of the file's layout and arrays; a change of it needs a new `storage.index.generations.INDEX_VERSION`."""

_ALIGNED = 64
_HEAD = 64


@dataclass(frozen=True)
class ShardSlices:
    """The slices of a shard as its file holds them.

    Attributes
    ----------
    take_ids : int64 array (T,)
        Id of each take, ascending.
    live : bool array (T,)
        True for the takes that count; the others have been dropped or replaced since the shard was made.
    slices : BitSlices
        The slices of all takes.
    """

    take_ids: I64
    live: npt.NDArray[np.bool_]
    slices: BitSlices


def write_slices(file: Path, take_ids: I64, slices: BitSlices) -> tuple[int, str]:
    """Write the slices of a shard's takes and flush them to disk.

    Parameters
    ----------
    file : Path
        The file to make.
    take_ids : int64 array (T,)
        Ids of the takes, ascending.
    slices : BitSlices
        The slices of these takes.

    Returns
    -------
    size : int
        The file's size in bytes.
    sha256 : str
        The file's checksum.
    """
    counts = [LAYOUT, slices.features, len(slices), len(slices.left)]
    head = MAGIC + np.array(counts, "<u8").tobytes()
    digest = hashlib.sha256()
    with open(file, "xb") as target:

        def put(piece: bytes | memoryview) -> None:
            digest.update(piece)
            target.write(piece)

        put(head.ljust(_HEAD, b"\0"))
        arrays = {"take_ids": take_ids} | slices.arrays
        for name, kind, count in _shapes(*counts[1:]):
            array = np.ascontiguousarray(arrays[name], kind)
            assert array.shape == (count,)
            put(array.data.cast("B"))
            put(bytes(-array.nbytes % _ALIGNED))
        target.flush()
        os.fsync(target.fileno())
        return target.tell(), digest.hexdigest()


def open_slices(generation: Path, record: Generation) -> tuple[ShardSlices, ...]:
    """Map the slices of all shards of a published generation, read-only; no page of the slices themselves is read.

    Parameters
    ----------
    generation : Path
        Folder of the generation.
    record : Generation
        Its record.

    Raises
    ------
    FileNotFoundError
        The generation has been removed.
    StoreError
        A file is damaged.
    """
    return tuple(_open(generation / slices_name(shard.number), shard) for shard in record.shards)


def _open(file: Path, shard: Shard) -> ShardSlices:
    with open(file, "rb") as content:
        size = os.fstat(content.fileno()).st_size
        if size != shard.slices_bytes or size < _HEAD:
            raise _damaged(file, f"has {size} bytes, the index records {shard.slices_bytes}")
        pages = mmap.mmap(content.fileno(), 0, access=mmap.ACCESS_READ)
    if pages[: len(MAGIC)] != MAGIC:
        raise _damaged(file, "does not begin with the mark of bit slices")
    layout, features, takes, blocks = np.frombuffer(pages, "<u8", 4, len(MAGIC)).tolist()
    if layout != LAYOUT or not 1 <= features <= MOST_FEATURES or max(takes, blocks) > size:
        raise _damaged(file, f"has layout {layout} and {features} features")
    arrays: dict[str, npt.NDArray[Any]] = {}
    at = _HEAD
    for name, kind, count in _shapes(features, takes, blocks):
        if at + count * np.dtype(kind).itemsize > size:
            raise _damaged(file, "is too short for the counts in its head")
        arrays[name] = np.frombuffer(pages, kind, count, at)
        at += -(-arrays[name].nbytes // _ALIGNED) * _ALIGNED
    if at != size:
        raise _damaged(file, "is too long for the counts in its head")
    take_ids = arrays.pop("take_ids")
    # search uses these as indices; nothing else in a damaged file could lead it out of the file
    if not _fit(arrays["first"], arrays["frames"], arrays["left"]):
        raise _damaged(file, "holds takes that do not fit together")
    live = _live(take_ids, shard)
    if (take_ids[1:] <= take_ids[:-1]).any() or not np.array_equal(take_ids[live], _wanted(shard)):
        raise _damaged(file, "holds other takes than its shard")
    return ShardSlices(take_ids, live, BitSlices(features=features, **arrays))


def _fit(first: I64, frames: I64, left: npt.NDArray[np.int32]) -> bool:
    """Return whether the takes have the blocks that their lengths need, one after the other."""
    lengths = np.diff(first)
    return bool(
        first[0] == 0
        and first[-1] == len(left)
        and (frames >= 0).all()
        and (lengths == frames // BLOCK + 1).all()
        and (left == np.repeat(first[1:], lengths) - 1 - np.arange(len(left))).all()
    )


def _wanted(shard: Shard) -> I64:
    """Return the ids of the takes that a shard holds, ascending."""
    ranges = sorted(pair for part in shard.parts for pair in part.takes)
    return np.concatenate([np.empty(0, np.int64), *(np.arange(first, stop) for first, stop in ranges)])


def _live(take_ids: I64, shard: Shard) -> npt.NDArray[np.bool_]:
    """Return a mask of the takes that are still in a shard, by the ranges of ids of its parts."""
    ranges = sorted(pair for part in shard.parts for pair in part.takes)
    starts, stops = np.array(ranges, np.int64).reshape(-1, 2).T
    place = np.searchsorted(starts, take_ids, side="right") - 1
    live: npt.NDArray[np.bool_] = (place >= 0) & (take_ids < stops[place]) if len(ranges) else np.zeros(0, bool)
    return live


def _shapes(features: int, takes: int, blocks: int) -> Iterator[tuple[str, str, int]]:
    """Yield name, dtype and length of every array, in their order in the file."""
    yield "take_ids", "<i8", takes
    yield "frames", "<i8", takes
    yield "first", "<i8", takes + 1
    yield "left", "<i4", blocks
    yield "coarse", "<u8", (2 * features + 1) * coarse_words(blocks)
    yield "bits", "<u8", blocks * (features + 1)


def _damaged(file: Path, what: str) -> StoreError:
    return StoreError(f"{file}: the index is damaged: the file {what}; {BUILD}")
