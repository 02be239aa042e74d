"""Parse BVH files, a skeleton and its motion in one text, in the variants of many programs."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from decimal import Decimal
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.ops import textnumbers as t
from kinedex.ops.body import kinematics as k
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.bvh_hierarchy import (
    _NUMBER,
    LINE_END,
    BvhText,
    Hierarchy,
    read_hierarchy,
    shown,
)
from kinedex.storage.formats.motion.reader import FASTEST_HZ, SLOWEST_HZ
from kinedex.storage.formats.motion.text_blocks import (
    LONGEST,
    Block,
    RowFile,
    RowMemory,
    after_last_line,
    blocks,
    changed,
)
from kinedex.storage.formats.source_files import any_text

MILLISECONDS = 1000
"""The factor for frame times above one second, which are taken as milliseconds."""

_USUAL_HZ = (
    *(24.0, 25.0, 30.0, 48.0, 50.0, 60.0, 72.0, 75.0, 90.0, 100.0, 120.0, 125.0, 144.0, 150.0, 180.0, 200.0),
    *(240.0, 250.0, 256.0, 300.0, 360.0, 400.0, 480.0, 500.0, 600.0, 720.0, 960.0, 1000.0),
    *(24000 / 1001, 30000 / 1001, 60000 / 1001, 120000 / 1001),
)


@lru_cache(maxsize=64)  # The files of an archive share a few frame times.
def frame_rate(frame_time: str) -> float:
    """Return the frames per second of a frame time as it is written.

    Frame times are truncated or rounded to a few digits: 0.0083333 stands for 120 Hz and not for 120.0005. So the
    result is a usual rate whose frame time, truncated or rounded to as many digits (or to a 32-bit float), equals the
    given one and which is at most 2.5 % away; integer rates take precedence over those of television (29.97). Without
    such a rate it is 1 / frame time.

    Parameters
    ----------
    frame_time : str
        A positive decimal number of seconds, for instance "0.0333333" or "8.33e-03".
    """
    seconds = float(frame_time)
    exponent = Decimal(frame_time).as_tuple().exponent
    unit = 10.0 ** max(int(exponent), -30)
    best: tuple[bool, float, float] | None = None
    for rate in _USUAL_HZ:
        gap = 1.0 / rate - seconds
        slack = 1e-6 * seconds
        written = abs(gap) <= max(0.5 * unit, slack) or 0.0 <= gap < unit
        if written and abs(gap) <= 0.025 * seconds:
            rank = (rate != int(rate), abs(gap), rate)
            best = rank if best is None else min(best, rank)
    return best[2] if best else 1.0 / seconds


def frame_time(rate_hz: float) -> str:
    """Return a frame time that `frame_rate` converts back to the rate, with 8 decimals if they suffice."""
    short = f"{1.0 / rate_hz:.8f}"
    return short if frame_rate(short) == rate_hz else repr(1.0 / rate_hz)


_COUNT = re.compile(rb"Frames[^\S\r\n]*:?[^\S\r\n]*([^\r\n]*)", re.IGNORECASE)
_TIME = re.compile(rb"Frame[^\S\r\n]*Time[^\S\r\n]*:?[^\S\r\n]*([^\r\n]*)", re.IGNORECASE)


@dataclass(frozen=True)
class Bvh:
    """A BVH file as a chain of nodes and their channels, in the file's own unit of length.

    Attributes
    ----------
    path : str
        The file.
    nodes : tuple of Node
        Parents first; a root's parent is −1, and node 0 is the first root. Joints have their names, an End Site is
        `<joint>_end`, a further one of the same joint `<joint>_end2`.
    channels : float64 array (T, C)
        Rotations in radians, positions in the file's unit.
    rate_hz : float
        Frames per second, see `frame_rate`.
    warnings : tuple of str
        Warnings about the file.
    redundant : frozenset of int
        Indices of End Sites at the position of their joint.
    """

    path: str
    nodes: tuple[k.Node, ...]
    channels: npt.NDArray[np.float64]
    rate_hz: float
    warnings: tuple[str, ...] = ()
    redundant: frozenset[int] = frozenset()

    @property
    def indices(self) -> dict[str, int]:
        """A dict from node name to index, for all nodes that a skeleton mapping can use."""
        return _places(self.nodes, self.redundant)


def _places(nodes: tuple[k.Node, ...], redundant: frozenset[int]) -> dict[str, int]:
    return {node.name: i for i, node in enumerate(nodes) if i not in redundant}


@dataclass(frozen=True)
class Layout:
    """The text before the frames of a BVH file, with the byte ranges of its parts.

    Attributes
    ----------
    text : bytes
        From the beginning of the file to the end of the line of Frame Time, without the end of that line.
    frames, frame_time : tuple of (int, int)
        Start and stop of the number of frames, and of the frame time.
    joints : tuple of (int, int)
        Start and stop of every node, from its keyword to its closing brace, in the order of `BvhFile.nodes`.
    offsets : tuple of (int, int)
        Start and stop of the three numbers of every node's OFFSET.
    """

    text: bytes
    frames: tuple[int, int]
    frame_time: tuple[int, int]
    joints: tuple[tuple[int, int], ...]
    offsets: tuple[tuple[int, int], ...]


def parse_bvh(path: str | Path, data: bytes | None = None) -> Bvh:
    """Read a BVH file.

    A joint's rotation is the product of its rotation channels in the order in which they are listed, leftmost first.
    A position channel replaces the same axis of the joint's OFFSET, at the root and at any other joint:
    files with six channels at every joint repeat the OFFSET in them.

    Parameters
    ----------
    path : str or Path
        The file.
    data : bytes, optional
        The file's bytes, if they have been read already.

    Raises
    ------
    SourceError
        The file is damaged; the error names the line of the first fault. No frame of such a file is used.
    """
    file = BvhFile(path, data)
    return Bvh(str(path), file.nodes, file.channels(), file.rate_hz, tuple(file.warnings), file.redundant)


class BvhFile(RowFile):
    """A BVH file whose frames are parsed block by block.

    Parameters
    ----------
    path : str or Path
        The file.
    data : bytes, optional
        The file's bytes, if they have been read already.

    Attributes
    ----------
    nodes : tuple of Node
        The nodes; see `Bvh` for this and further attributes.
    frames : int
        The number of frames.
    offsets : float64 array (N, 3)
        The OFFSET of every node, also of nodes whose position channels replace it.
    layout : Layout
        The text before the frames.

    Raises
    ------
    SourceError
        The hierarchy or the header of the motion is damaged; the error names the line.
    """

    def __init__(self, path: str | Path, data: bytes | None = None) -> None:
        self.path = Path(path)
        self._data = data
        text, hierarchy, claimed = self._read_header()
        self._start, self._line = text.pos, text.line(text.pos)
        self.frames, ended = 0, False
        for block in self._blocks():
            self.size = block.start + len(block.view)
            self.frames += t.count_rows(block.view, 0 if block.start else self._start, numbered=False)
            ended = bytes(block.view[-1:]) in (b"\n", b"\r") or (ended and not block.view)
        if not self.frames:
            raise text.error(f"no frames: the file ends after its header, which states {claimed} frames", text.pos)
        if claimed != self.frames:
            cut = "" if ended or claimed < self.frames else "; its last line has no end"
            self.warnings.append(
                f"the header states {claimed} frames, the file holds {self.frames}, which are kept{cut}"
            )
        self.warnings += hierarchy.warnings
        self.layout = Layout(
            text.data[: text.pos], text.settings[-2], text.settings[-1], hierarchy.spans, hierarchy.numbers
        )
        self.nodes, self._scale = hierarchy.nodes, np.where(hierarchy.rotations, np.pi / 180.0, 1.0)
        self.position_channels = len(hierarchy.rotations) - int(np.count_nonzero(hierarchy.rotations))
        self.offsets, self.redundant = hierarchy.offsets, hierarchy.redundant

    @property
    def indices(self) -> dict[str, int]:
        """A dict from node name to index, for all nodes that a skeleton mapping can use."""
        return _places(self.nodes, self.redundant)

    @property
    def columns(self) -> int:
        """The number of channels."""
        return self._columns

    def _read_header(self) -> tuple[BvhText, Hierarchy, int]:
        """Parse hierarchy and header from the first block, or from a longer one if they do not end within it."""
        self._least = 0
        while True:
            block = next(self._blocks())
            text = BvhText(self.path, block.data)
            try:
                hierarchy = read_hierarchy(text)
                claimed, self.rate_hz, self.warnings = _motion_header(text)
            except SourceError:
                if block.last or len(block.data) > LONGEST:
                    raise
                self._least = 2 * len(block.data)
                continue
            self._data = block.data if block.last else None
            self._columns = len(hierarchy.rotations)
            if not self._columns:
                raise text.error("no joint of the hierarchy has CHANNELS, so nothing can move", hierarchy.spans[0][0])
            return text, hierarchy, claimed

    def _blocks(self) -> Iterator[Block]:
        return blocks(self.path, self._data, after_last_line, self._least)

    def frames_at(self, wanted: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
        """Return the channels (K, C) of some frames; the text of the others is not parsed.

        Parameters
        ----------
        wanted : int64 array (K,)
            Their numbers, from 0, ascending.

        Raises
        ------
        SourceError
            One of them is damaged; the error names the first fault of the file.
        """
        found, done = [], 0
        for block in self._blocks():
            begin = 0 if block.start else self._start
            rows = t.count_rows(block.view, begin, numbered=False)
            here = wanted[(wanted >= done) & (wanted < done + rows)] - done
            if len(here):
                edges = np.append(t.row_starts(block.view, begin, numbered=False), len(block.view))
                for start, stop in zip(edges[here].tolist(), edges[here + 1].tolist(), strict=True):
                    values, fault = t.parse_rows(block.view[start:stop], 0, 1, self._columns)
                    if fault is not None:
                        self.refuse_faults()
                        raise changed(self.path)
                    found.append(values)
            done += rows
        if len(found) != len(wanted):
            raise changed(self.path)
        return np.concatenate(found) * self._scale

    def refuse_faults(self) -> None:
        """Parse all frames, and raise the SourceError of the first fault if there is one."""
        for _ in self.blocks():
            pass

    def parsed(self, memory: RowMemory) -> Iterator[npt.NDArray[np.float64]]:
        source = self._blocks()
        for block in source:
            begin, line = (0, 1) if block.start else (self._start, self._line)
            room = memory.free(len(block.view))
            values, fault = t.parse_rows(block.view, begin, line, self._columns, room)
            if fault is not None:
                raise self._error(fault, memory.filled, block, source)
            memory.filled += len(values)
            values *= self._scale
            yield values

    def _error(self, fault: t.Fault, rows: int, block: Block, source: Iterator[Block]) -> SourceError:
        """Return the SourceError for a fault after `rows` valid rows of a block; `source` yields later blocks."""
        if fault.code == t.FULL:
            return changed(self.path)
        at, data = fault.line + block.line - 1, block.data
        if fault.code == t.TOO_FEW:
            ends = LINE_END.finditer(data)
            start = next((end.end() for number, end in enumerate(ends, 2) if number == fault.line), 0)
            last = LINE_END.search(data[start:].rstrip()) is None and all(not more.data.strip() for more in source)
            message = (
                f"frame {fault.start + rows} has {fault.stop} numbers, the hierarchy has {self._columns} channels"
                + ": the file is cut off in the middle of a frame" * last
            )
            return SourceError(self.path, message, line=at)
        token = any_text(data[fault.start : min(fault.stop, fault.start + 40)])
        if fault.code == t.TOO_MANY:
            message = f"unexpected {token!r}: more numbers than the {self._columns} channels of the hierarchy"
            return SourceError(self.path, message, line=at)
        return SourceError(self.path, f"not a number: {token!r}", line=at)


def _motion_header(text: BvhText) -> tuple[int, float, list[str]]:
    """Parse Frames and Frame Time; return the claimed number of frames, the rate and warnings."""
    count = _setting(text, _COUNT, "'Frames: <how many>'")
    if not re.fullmatch("[0-9]{1,18}", count):
        raise text.error(f"Frames must be a whole number, got {count!r}")
    time = _setting(text, _TIME, "'Frame Time: <seconds>', for instance 'Frame Time: 0.0333333' for 30 Hz")
    if not _NUMBER.fullmatch(time):
        raise text.error(f"Frame Time must be a number of seconds, got {time!r}; write 0.0333333 for 30 Hz")
    seconds = float(time)
    if 1 / SLOWEST_HZ < seconds < MILLISECONDS / SLOWEST_HZ:
        rate_hz = frame_rate(f"{Decimal(time) / MILLISECONDS}")
        return int(count), rate_hz, [f"frame time {time} is read as milliseconds: {rate_hz:.6g} Hz"]
    if not 1 / FASTEST_HZ <= seconds <= 1 / SLOWEST_HZ:
        raise text.error(
            f"Frame Time must be from {1 / FASTEST_HZ:g} to {1 / SLOWEST_HZ:g} seconds, got {time}; "
            "write 0.0333333 for 30 Hz"
        )
    rate_hz = frame_rate(time)
    bent = abs(rate_hz * seconds - 1.0) > 1e-3
    return int(count), rate_hz, [f"frame time {time} is read as {rate_hz:.6g} Hz"] if bent else []


def _setting(text: BvhText, pattern: re.Pattern[bytes], expected: str) -> str:
    word = text.word()
    found = pattern.match(text.data, text.at)
    if found is None:
        raise text.error(f"expected {expected}, got {shown(word)}")
    text.pos = found.end()
    value = found[1].rstrip()
    text.settings.append((found.start(1), found.start(1) + len(value)))
    return any_text(value).strip()
