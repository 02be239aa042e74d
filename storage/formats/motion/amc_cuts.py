"""Cuts of AMC files: an interval of their frames with their own numbers, and their ASF skeleton beside it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.amc import AmcFile
from kinedex.storage.formats.motion.asf import read_asf
from kinedex.storage.formats.motion.channel_cuts import Stamp, check_interval, check_source, stamp_of, write_bytes
from kinedex.storage.formats.motion.reader import source_bytes
from kinedex.storage.formats.motion.source_cut import SourceCut
from kinedex.storage.formats.motion.text_blocks import before_last_frame
from kinedex.storage.formats.motion.text_rows import TextRows

_NUMBER = re.compile(rb"([ \t]*)[0-9]+")


def write_amc_cut(paths: Sequence[Path], cut: SourceCut) -> None:
    """Write an interval of an AMC file as an AMC file, and its ASF file beside it.

    Header, keywords and all numbers are the text of the source; frames are numbered from 1.

    Parameters
    ----------
    paths : sequence of Path
        The AMC file to write, and the ASF file.
    cut : SourceCut
        The interval.

    Raises
    ------
    SourceError
        A source is damaged, was changed, or has no such frames.
    KinedexError
        A file cannot be written.
    """
    check_source(cut)
    if cut.skeleton is None:
        raise SourceError(cut.source, "an AMC file is cut with its ASF skeleton; none is given")
    source = _opened(cut.source, stamp_of(cut.source), cut.skeleton, stamp_of(cut.skeleton))
    check_interval(cut, len(source.rows))
    frames = source.rows.read(cut.start, cut.stop)
    write_bytes(paths[0], [source.rows.head, *(numbered(frame, i) for i, frame in enumerate(frames, 1))])
    write_bytes(paths[1], [source.skeleton_text])


class AmcSource:
    """An AMC file that is cut, with its skeleton, and the places of its frames."""

    def __init__(self, path: Path, skeleton: Path) -> None:
        self.skeleton = read_asf(skeleton)
        self.skeleton_text = source_bytes(skeleton)
        self.file = AmcFile(path, self.skeleton)
        self.rows = TextRows(path, self.file.start, True, before_last_frame)


@lru_cache(maxsize=4)  # The clips of a take are cut one after the other.
def _opened(path: Path, _stamp: Stamp, skeleton: Path, _skeleton_stamp: Stamp) -> AmcSource:
    return AmcSource(path, skeleton)


def numbered(frame: bytes, number: int) -> bytes:
    """Return the text of a frame with another number."""
    found = _NUMBER.match(frame)
    assert found is not None  # a frame begins with its number
    return found[1] + b"%d" % number + frame[found.end() :]
