"""Check intervals to be cut out of a motion file, and write the files of a cut, in any format.

The numbers of a cut keep the text of the source, byte by byte, unless a change applies to them.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path

from kinedex.ops.errors import KinedexError, ParameterError, SourceError
from kinedex.storage.disk import whole_file
from kinedex.storage.formats.motion.reader import FASTEST_HZ, SLOWEST_HZ
from kinedex.storage.formats.motion.source_cut import SourceCut
from kinedex.storage.formats.motion.sources import checksum

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
        raise SourceError(
            cut.source,
            "was changed since it was ingested, so that frames of the store are not its frames; ingest it again "
            "(kinedex ingest STORE SOURCE), or export the 24 joints, which the store itself holds",
        )


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
