"""Write and map slice files; each holds the bit slices of one shard, is written once, and mapped by search processes.

All processes of a machine share the mapped pages. A mapped file stays readable after it has been removed (except on
Windows, which refuses to remove it).

The file is little-endian. Its header has 64 bytes: the eight characters of `MAGIC`, then as uint64 `LAYOUT` and the
numbers of features f, takes T and blocks B, then zeros. After it come take_ids, int64 (T,), ascending, and the arrays
of `ops.search.bit_slices.BitSlices` in the order of `_shapes`, each at the next multiple of 64 bytes.
"""

from __future__ import annotations

import mmap
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import xxhash

from kinedex.ops.errors import StoreError
from kinedex.ops.search.bit_slices import BitSlices, coarse_words
from kinedex.ops.words import I64
from kinedex.storage.index.generations import Generation, Shard, slices_name
from kinedex.storage.remedies import build_index
from kinedex.storage.snapshot.checked_files import CheckedFiles

MAGIC = b"KDXSLICE"

LAYOUT = 1
"""Version of the file's layout and arrays; a change requires a new `storage.index.generations.INDEX_VERSION`."""

_ALIGNED = 64
_HEAD = 64


@dataclass(frozen=True)
class ShardSlices:
    """The bit slices of a shard, as its file stores them.

    Attributes
    ----------
    take_ids : int64 array (T,)
        Id of each take, ascending.
    live : bool array (T,)
        True for live takes; the others have been dropped or replaced since the shard was made.
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
    xxh3 : str
        The file's XXH3.
    """
    counts = [LAYOUT, slices.features, len(slices), len(slices.left)]
    head = MAGIC + np.array(counts, "<u8").tobytes()
    digest = xxhash.xxh3_128()
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


def open_slices(files: CheckedFiles, generation: Path, record: Generation) -> tuple[ShardSlices, ...]:
    """Map the slices of all shards of a published generation, read-only, after a check of their checksums.

    Parameters
    ----------
    files : CheckedFiles
        The files of the store.
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
    return tuple(_open(files, generation / slices_name(shard.number), shard) for shard in record.shards)


def _open(files: CheckedFiles, file: Path, shard: Shard) -> ShardSlices:
    # search uses the file's numbers as indices; only the checksum keeps them in range
    if not files.is_sound(file, shard.slices_xxh3):
        raise StoreError(
            f"{file}: the index is damaged: its content does not fit its checksum", remedy=build_index(files.store)
        )
    with open(file, "rb") as content:
        pages = mmap.mmap(content.fileno(), 0, access=mmap.ACCESS_READ)
    _, features, takes, blocks = np.frombuffer(pages, "<u8", 4, len(MAGIC)).tolist()
    arrays: dict[str, npt.NDArray[Any]] = {}
    at = _HEAD
    for name, kind, count in _shapes(features, takes, blocks):
        arrays[name] = np.frombuffer(pages, kind, count, at)
        at += -(-arrays[name].nbytes // _ALIGNED) * _ALIGNED
    take_ids = arrays.pop("take_ids")
    return ShardSlices(take_ids, _live(take_ids, shard), BitSlices(features=features, **arrays))


def _live(take_ids: I64, shard: Shard) -> npt.NDArray[np.bool_]:
    """Return a mask of the takes that are still in a shard, from the id ranges of its parts."""
    ranges = sorted(pair for part in shard.parts for pair in part.takes)
    starts, stops = np.array(ranges, np.int64).reshape(-1, 2).T
    place = np.searchsorted(starts, take_ids, side="right") - 1
    live: npt.NDArray[np.bool_] = (place >= 0) & (take_ids < stops[place]) if len(ranges) else np.zeros(0, bool)
    return live


def _shapes(features: int, takes: int, blocks: int) -> Iterator[tuple[str, str, int]]:
    """Yield name, dtype and length of every array, in the order of the file."""
    yield "take_ids", "<i8", takes
    yield "frames", "<i8", takes
    yield "first", "<i8", takes + 1
    yield "left", "<i4", blocks
    yield "coarse", "<u8", (2 * features + 1) * coarse_words(blocks)
    yield "bits", "<u8", blocks * (features + 1)
