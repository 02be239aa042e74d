"""Define and check cuts of intervals from motion files of any format, and read the rows of text files.

The numbers of a cut keep the text of the source, byte by byte, unless a change applies to them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.catalog.skeletons.mappings import Mappings
from kinedex.ops import textnumbers
from kinedex.ops.errors import KinedexError, ParameterError, SourceError
from kinedex.storage.durable_files import whole_file
from kinedex.storage.formats.motion.reader import FASTEST_HZ, SLOWEST_HZ
from kinedex.storage.formats.motion.sources import checksum
from kinedex.storage.formats.motion.text_blocks import blocks
from kinedex.storage.formats.motion.unpacked_files import unpacked
from kinedex.storage.formats.source_files import file_size, part_of


@dataclass(frozen=True)
class SourceCut:
    """An interval of a motion file in source frames, and the changes to apply to it.

    Attributes
    ----------
    source : Path
        The motion file.
    skeleton : Path or None
        The skeleton file of an AMC file; None for other formats.
    person : str or None
        The person in a file of several.
    start, stop : int
        The interval [start, stop) in frames of the source.
    source_rate_hz : float
        Frames per second of the source, as kinedex read it: the file's, or the user's.
    mirror : bool
        True to exchange left and right.
    rate_hz : float or None
        Frames per second of the cut; None for those of the source.
    in_place : bool
        True to put the root above the origin, facing +Z, in the first frame of `inner`.
    inner : tuple of int, optional
        The actual interval, in source frames, if the cut includes a margin around it.
    checksum : str, optional
        SHA-256 of the source when it was ingested; a source with another checksum is an error. None for no check.
    mappings : Mappings, optional
        The skeleton mappings that identify the source's left and right, for `mirror` and `in_place`; by default the
        shipped ones.
    """

    source: Path
    skeleton: Path | None
    person: str | None
    start: int
    stop: int
    source_rate_hz: float
    mirror: bool = False
    rate_hz: float | None = None
    in_place: bool = False
    inner: tuple[int, int] | None = None
    checksum: str | None = None
    mappings: Mappings | None = None

    @property
    def is_changed(self) -> bool:
        """True if numbers of the source change."""
        return self.mirror or self.in_place or self.rate_hz not in (None, self.source_rate_hz)


Stamp = tuple[int, int]
"""A file's size in bytes and the time of its last change in nanoseconds."""


def stamp_of(path: Path) -> Stamp:
    """Return size and time of a file; raise SourceError if it is missing.

    Raises
    ------
    SourceError
        The file cannot be read; the message names an export format that needs no source.
    """
    try:
        found = path.stat()
    except OSError as fault:
        raise SourceError(
            path,
            f"cannot be read: {fault.strerror}; a cut of the source's own channels needs it. Bring it back, or export "
            "the 24 joints, which the store itself holds",
        ) from fault
    return found.st_size, found.st_mtime_ns


def check_source(cut: SourceCut) -> None:
    """Check that the source is the file that was read into the store.

    Raises
    ------
    SourceError
        The source cannot be read, or has another content than `cut.checksum`.
    """
    if cut.checksum and cut.checksum != _checksum(cut.source, stamp_of(cut.source)):
        raise _changed(cut.source)


def _changed(path: Path) -> SourceError:
    return SourceError(
        path,
        "was changed since it was ingested, so that frames of the store are not its frames; ingest it again "
        "(kinedex ingest STORE SOURCE), or export the 24 joints, which the store itself holds",
    )


@contextmanager
def unpacked_cut(cut: SourceCut) -> Iterator[SourceCut]:
    """Yield a cut whose source and skeleton are ordinary files, for the `with` block.

    Raises
    ------
    SourceError
        They cannot be unpacked, or a packed source has another content than `cut.checksum`.
    """
    with unpacked(cut.source, cut.skeleton) as file:
        if not file.checksum:
            yield replace(cut, skeleton=file.skeleton)
        elif cut.checksum and cut.checksum != file.checksum:
            raise _changed(cut.source)
        else:
            yield replace(cut, source=file.path, skeleton=file.skeleton, checksum=None)


@lru_cache(maxsize=64)
def _checksum(path: Path, _stamp: Stamp) -> str:
    return checksum(path)


def check_interval(cut: SourceCut, frames: int) -> None:
    """Check that a cut lies within the frames of its source.

    Raises
    ------
    SourceError
        The cut is not within the file, so that store and file disagree.
    ParameterError
        The interval is empty, or `cut.inner` lies outside it.
    """
    if cut.rate_hz is not None and not SLOWEST_HZ <= cut.rate_hz <= FASTEST_HZ:
        raise ParameterError("rate_hz", f"from {SLOWEST_HZ:g} to {FASTEST_HZ:g}", cut.rate_hz)
    if not 0 <= cut.start < cut.stop:
        raise ParameterError("start and stop", "an interval of at least one frame", (cut.start, cut.stop))
    if cut.stop > frames:
        raise SourceError(
            cut.source,
            f"has {frames} frames, so that [{cut.start}, {cut.stop}) cannot be cut out of it; it was changed since it "
            "was ingested: ingest it again (kinedex ingest STORE SOURCE)",
        )
    if cut.inner is not None and not cut.start <= cut.inner[0] < cut.inner[1] <= cut.stop:
        raise ParameterError("inner", f"an interval within [{cut.start}, {cut.stop})", cut.inner)


def write_bytes(path: Path, pieces: Iterable[bytes]) -> None:
    """Write a file atomically.

    Raises
    ------
    KinedexError
        The file cannot be written.
    """
    try:
        with whole_file(path) as unfinished, unfinished.open("wb") as file:
            file.writelines(pieces)
    except OSError as fault:
        raise KinedexError(f"{path}: cannot be written: {fault.strerror}") from None


_LINE_END = re.compile(rb"\r\n?|\n")


class TextRows:
    """The frames of a motion file in text, each of one line or of several lines.

    Parameters
    ----------
    path : Path
        The file.
    start : int
        The byte after which the frames begin.
    numbered : bool
        True for frames that begin with a line for their number, as in AMC files; False for one row per line.
    cut : callable
        Returns the offset at which a block of the file can end, see `text_blocks.blocks`.

    Attributes
    ----------
    starts : int64 array (frames + 1,)
        The byte at which each frame begins; the last one is the end of the file.
    head : bytes
        The text before the first frame.
    newline : bytes
        The first line end in the file.
    """

    def __init__(self, path: Path, start: int, numbered: bool, cut: Callable[[bytearray, int], int]) -> None:
        self.path = path
        found: list[npt.NDArray[np.int64]] = []
        at, self.newline, self.head = 0, b"", b""
        for block in blocks(path, None, cut):
            begin = min(max(0, start - at), len(block.view))
            rows = textnumbers.row_starts(block.view, begin, numbered)
            if not any(map(len, found)):
                self.head += bytes(block.view[: rows[0]] if len(rows) else block.view)
            found.append(rows + at)
            first = None if self.newline else _LINE_END.search(block.view)
            self.newline = bytes(first[0]) if first is not None else self.newline
            at += len(block.view)
        self.newline = self.newline or b"\n"
        self.starts = np.concatenate([*found, [at]])

    def __len__(self) -> int:
        return len(self.starts) - 1

    def read(self, start: int, stop: int) -> list[bytes]:
        """Return the text of frames [start, stop) with line ends, blank lines and comments after each.

        Raises
        ------
        SourceError
            The file cannot be read, or has another size than before.
        """
        begin, end = int(self.starts[start]), int(self.starts[stop])
        data = part_of(self.path, end - begin, begin)
        if len(data) != end - begin or file_size(self.path) != self.starts[-1]:
            raise SourceError(self.path, "was changed while it was read; run again when it is whole")
        positions = self.starts[start : stop + 1] - begin
        frames = [data[a:b] for a, b in pairwise(positions)]
        if frames and not frames[-1].endswith((b"\n", b"\r")):
            frames[-1] += self.newline
        return frames
