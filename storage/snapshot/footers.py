"""Read the footers of frames parts once: they show which row groups can contain a take, or some frames of it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow.parquet as pq

I64 = npt.NDArray[np.int64]

FOOTERS = 64
"""The number of footers that are cached; that of a full part takes some 200 KB and a millisecond to read."""

_MOST = np.iinfo(np.int64).max
_ANY = (np.iinfo(np.int64).min, _MOST)


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
        The lowest and the highest number of a frame in each.
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
        first, last = np.where(alone, self.frames[found].T, [[0], [_MOST]])
        # in a group of several takes, the range of frames may be another take's; neighbouring groups of this take alone
        # bound it
        first[1:] = np.where(alone[1:] | ~alone[:-1], first[1:], last[:-1] + 1)
        last[:-1] = np.where(alone[:-1] | ~alone[1:], last[:-1], first[1:] - 1)
        chosen: list[int] = found[(first < stop) & (last >= start)].tolist()
        return chosen


def footer_of(file: Path) -> Footer:
    """Return the footer of a frames part whose checksum has been checked.

    A part is named after its content, and never rewritten, so that a cached footer is valid as long as the file exists.
    """
    status = file.stat()
    return _read(str(file), status.st_ino, status.st_size, status.st_mtime_ns)


@lru_cache(FOOTERS)
def _read(file: str, _inode: int, _bytes: int, _mtime_ns: int) -> Footer:
    with pq.ParquetFile(file) as opened:
        metadata, names = opened.metadata, opened.schema_arrow
    takes, frames = (_bounds(metadata, names.get_field_index(name)) for name in ("take_id", "frame"))
    return Footer(metadata, takes, frames)


def _bounds(metadata: pq.FileMetaData, column: int) -> I64:
    """Return the smallest and the largest value of a column in each row group; the full integer range if unknown."""
    statistics = [metadata.row_group(group).column(column).statistics for group in range(metadata.num_row_groups)]
    known = [(one.min, one.max) if one is not None and one.has_min_max else _ANY for one in statistics]
    return np.array(known, np.int64).reshape(-1, 2)
