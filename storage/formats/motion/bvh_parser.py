"""The parser of BVH files: a skeleton and its motion in one text, as many programs write them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from decimal import Decimal
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.ops import textnumbers as t
from kinedex.ops.body import kinematics as k
from kinedex.ops.errors import SourceError, did_you_mean
from kinedex.storage.formats.motion.reader import FASTEST_HZ, SLOWEST_HZ
from kinedex.storage.formats.motion.text_blocks import LONGEST, Block, after_last_line, blocks

MOST_JOINTS = 10_000
"""A body has some hundred joints with every finger; a file that claims more than this is refused."""

MILLISECONDS = 1000
"""A frame time of more than a second is one in milliseconds."""

_CHANNELS = {
    "xrotation": k.ROTATE_X, "yrotation": k.ROTATE_Y, "zrotation": k.ROTATE_Z,
    "xposition": k.MOVE_X, "yposition": k.MOVE_Y, "zposition": k.MOVE_Z,
}  # fmt: skip
_USUAL_HZ = (
    *(24.0, 25.0, 30.0, 48.0, 50.0, 60.0, 72.0, 75.0, 90.0, 100.0, 120.0, 125.0, 144.0, 150.0, 180.0, 200.0),
    *(240.0, 250.0, 256.0, 300.0, 360.0, 400.0, 480.0, 500.0, 600.0, 720.0, 960.0, 1000.0),
    *(24000 / 1001, 30000 / 1001, 60000 / 1001, 120000 / 1001),
)
_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
_TOKEN = re.compile(rb"[{}]|[^\s{}]+")
_LINE_END = re.compile(rb"\r\n?|\n")
_TO_LINE_END = re.compile(rb"[^\r\n]*")
_NAME = re.compile(rb"[^\r\n{}]*")
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
        Reservations about the file.
    redundant : frozenset of int
        Indices of End Sites at the place of their joint, which add nothing to it.
    """

    path: str
    nodes: tuple[k.Node, ...]
    channels: npt.NDArray[np.float64]
    rate_hz: float
    warnings: tuple[str, ...] = ()
    redundant: frozenset[int] = frozenset()

    @property
    def places(self) -> dict[str, int]:
        """Node name → index, for all nodes that a skeleton mapping can use."""
        return _places(self.nodes, self.redundant)


def _places(nodes: tuple[k.Node, ...], redundant: frozenset[int]) -> dict[str, int]:
    return {node.name: i for i, node in enumerate(nodes) if i not in redundant}


@dataclass(frozen=True)
class Layout:
    """The text before the frames of a BVH file, and the bytes of its parts.

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


@dataclass
class _Joint:
    """One ROOT, JOINT or End Site of the hierarchy as it is read."""

    name: str
    at: int
    parent: int
    end: bool = False
    offset: tuple[float, ...] | None = None
    channels: list[str] | None = None
    numbers: tuple[int, int] = (0, 0)  # the bytes of its OFFSET's numbers
    stop: int = 0  # the byte after its closing brace


@dataclass
class _Text:
    """The bytes of a file, and the place up to which they are read."""

    path: Path
    data: bytes
    pos: int = 0
    at: int = field(default=0, init=False)  # where the last word began
    settings: list[tuple[int, int]] = field(default_factory=list, init=False)  # bytes of Frames, of Frame Time

    def line(self, at: int) -> int:
        return 1 + len(_LINE_END.findall(self.data, 0, at))

    def error(self, message: str, at: int | None = None) -> SourceError:
        return SourceError(self.path, message, line=self.line(self.at if at is None else at))

    def word(self) -> str | None:
        """Return the next word or brace, skipping comments (# or // to the line's end); None at the end of the file."""
        while found := _TOKEN.search(self.data, self.pos):
            self.at, self.pos = found.span()
            if not found[0].startswith((b"#", b"//")):
                return _decode(found[0])
            self.pos = self._match(_TO_LINE_END).end()
        self.at = self.pos = len(self.data)
        return None

    def rest(self) -> str:
        """Return the text up to the next brace or the end of the line."""
        found = self._match(_NAME)
        self.pos = found.end()
        return _decode(found[0]).strip()

    def _match(self, pattern: re.Pattern[bytes]) -> re.Match[bytes]:
        found = pattern.match(self.data, self.pos)
        assert found is not None  # both patterns match the empty text
        return found

    def number(self, what: str) -> float:
        word = self.word()
        value = float(word) if word is not None and _NUMBER.fullmatch(word) else np.nan
        if not np.isfinite(value):
            raise self.error(f"{what} must be a number, got {_shown(word)}")
        return value


def _decode(text: bytes) -> str:
    """Decode a name: UTF-8 in some files, any code page in others."""
    try:
        return text.decode("utf-8")
    except UnicodeDecodeError:
        return text.decode("latin-1")


def _shown(word: str | None) -> str:
    return "the end of the file" if word is None else repr(word[:40])


def parse_bvh(path: str | Path, data: bytes | None = None) -> Bvh:
    """Read a BVH file.

    A joint's rotation is the product of its rotation channels in the order in which they are listed, leftmost first.
    A position channel stands in the place of the same axis of the joint's OFFSET, at the root and at any other joint:
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
    channels = np.concatenate(list(file.blocks()))
    return Bvh(str(path), file.nodes, channels, file.rate_hz, tuple(file.warnings), file.redundant)


class BvhFile:
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
        As in `Bvh`, as are the other attributes.
    frames : int
        The number of frames.
    offsets : float64 array (N, 3)
        The OFFSET of every node, also of those whose position channels stand in its place.
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
        text, joints, claimed = self._read_header()
        self._start, self._line = text.pos, text.line(text.pos)
        self.frames, ended = 0, False
        for block in self._blocks():
            begin = self._start if block.line == 1 else 0
            self.frames += t.count_rows(block.data, begin, numbered=False)
            ended = block.data.endswith((b"\n", b"\r")) or (ended and not block.data)
        if not self.frames:
            raise text.error(f"no frames: the file ends after its header, which states {claimed} frames", text.pos)
        if claimed != self.frames:
            cut = "" if ended or claimed < self.frames else "; its last line has no end"
            self.warnings.append(
                f"the header states {claimed} frames, the file holds {self.frames}, which are kept{cut}"
            )
        self.warnings += _name(joints)
        spans = tuple((joint.at, joint.stop) for joint in joints)
        numbers = tuple(joint.numbers for joint in joints)
        self.layout = Layout(text.data[: text.pos], text.settings[-2], text.settings[-1], spans, numbers)
        self.nodes, self._rotations = _chain(joints)
        self.offsets = np.array([joint.offset for joint in joints])
        self.redundant = frozenset(i for i, joint in enumerate(joints) if joint.end and not any(joint.offset or ()))

    @property
    def places(self) -> dict[str, int]:
        """Node name → index, for all nodes that a skeleton mapping can use."""
        return _places(self.nodes, self.redundant)

    @property
    def columns(self) -> int:
        """Return the number of channels."""
        return len(self._rotations)

    def _read_header(self) -> tuple[_Text, list[_Joint], int]:
        """Read hierarchy and header from the first block, or from a longer one as long as it ends within them."""
        self._least = 0
        while True:
            block = next(self._blocks())
            text = _Text(self.path, block.data, pos=3 if block.data.startswith(b"\xef\xbb\xbf") else 0)
            try:
                joints = _hierarchy(text)
                claimed, self.rate_hz, self.warnings = _motion_header(text)
            except SourceError:
                if block.last or len(block.data) > LONGEST:
                    raise
                self._least = 2 * len(block.data)
                continue
            self._columns = sum(len(joint.channels or ()) for joint in joints)
            if not self._columns:
                raise text.error("no joint of the hierarchy has CHANNELS, so nothing can move", joints[0].at)
            return text, joints, claimed

    def _blocks(self) -> Iterator[Block]:
        return blocks(self.path, self._data, after_last_line, self._least)

    def blocks(self) -> Iterator[npt.NDArray[np.float64]]:
        """Yield the channels (T, C) of consecutive frames, in radians and the file's unit.

        Raises
        ------
        SourceError
            The file is damaged; the error names the line of the first fault.
        """
        rows, scale = 0, np.where(self._rotations, np.pi / 180.0, 1.0)
        source = self._blocks()
        for block in source:
            begin, line = (self._start, self._line) if block.line == 1 else (0, block.line)
            values, fault = t.parse_rows(block.data, begin, line, self._columns)
            if fault is not None:
                if fault.code == t.TOO_FEW:
                    fault = replace(fault, start=fault.start + rows)
                    rest = block.data[_line_start(block.data, fault.line - block.line + 1) :].rstrip()
                    last = _LINE_END.search(rest) is None and all(not more.data.strip() for more in source)
                    raise SourceError(self.path, _too_few(fault, self._columns, last), line=fault.line)
                raise SourceError(self.path, _explain(fault, block.data, self._columns), line=fault.line)
            rows += len(values)
            values *= scale
            yield values


def _hierarchy(text: _Text) -> list[_Joint]:
    """Read up to MOTION and return the joints in the order of the file, parents first."""
    word = text.word()
    if word is None or word.upper() != "HIERARCHY":
        raise text.error(f"expected HIERARCHY, got {_shown(word)}: this is no BVH file")
    joints: list[_Joint] = []
    inside: list[int] = []
    while (word := text.word()) is not None:
        key = word.upper()
        if key == "MOTION" and joints and not inside:
            return joints
        if key in ("ROOT", "JOINT", "END"):
            _open_joint(text, key, joints, inside)
        elif not inside:
            expected = "MOTION" if joints else "ROOT"
            raise text.error(f"expected {expected}, got {_shown(word)}{did_you_mean(word.upper(), [expected])}")
        elif key == "}":
            joint = joints[inside.pop()]
            joint.stop = text.pos
            if joint.offset is None:
                raise text.error(f"{_called(joint)} has no OFFSET", joint.at)
        elif key == "OFFSET":
            _read_offset(text, joints[inside[-1]])
        elif key == "CHANNELS":
            _read_channels(text, joints[inside[-1]])
        else:
            opened = joints[inside[-1]]
            if key == "MOTION":
                raise text.error(f"MOTION before {_called(opened)} (line {text.line(opened.at)}) is closed with '}}'")
            raise text.error(f"expected OFFSET, CHANNELS, JOINT, End Site or '}}', got {_shown(word)}")
    raise text.error("the file ends in its hierarchy, before MOTION (is it cut off?)")


def _called(joint: _Joint) -> str:
    return "an End Site" if joint.end else f"joint '{joint.name}'"


def _open_joint(text: _Text, key: str, joints: list[_Joint], inside: list[int]) -> None:
    at = text.at
    name = text.rest()
    if key == "ROOT" and inside:
        raise text.error(f"ROOT '{name}' inside another joint; expected JOINT, or a '}}' before it", at)
    if key != "ROOT" and not inside:
        raise text.error(f"{key} '{name}' outside the ROOT" + ("; is a '}' too many above?" if joints else ""), at)
    parent = inside[-1] if inside else -1
    if parent >= 0 and joints[parent].end:
        raise text.error("an End Site has no joints below it", at)
    if key != "END" and not name:
        raise text.error(f"{key} has no name", at)
    if text.word() != "{":
        raise text.error(f"expected '{{' after {key} {name}")
    if len(joints) == MOST_JOINTS:
        raise text.error(f"more than {MOST_JOINTS} joints: this is no body", at)
    inside.append(len(joints))
    joints.append(_Joint(name, at, parent, end=key == "END"))


def _read_offset(text: _Text, joint: _Joint) -> None:
    if joint.offset is not None:
        raise text.error(f"a second OFFSET of {_called(joint)}")
    values = [text.number(f"OFFSET of {_called(joint)}")]
    first = text.at
    values += [text.number(f"OFFSET of {_called(joint)}") for _ in range(2)]
    joint.offset, joint.numbers = tuple(values), (first, text.pos)


def _read_channels(text: _Text, joint: _Joint) -> None:
    at = text.at
    if joint.channels is not None:
        raise text.error(f"a second CHANNELS of {_called(joint)}")
    if joint.end:
        raise text.error("an End Site has no CHANNELS")
    count = text.number(f"the number of CHANNELS of {_called(joint)}")
    if count not in range(7):
        raise text.error(f"the number of CHANNELS of {_called(joint)} must be 0 to 6, got {count:g}")
    joint.channels = []
    for _ in range(int(count)):
        word = text.word()
        if word is None or word.lower() not in _CHANNELS:
            known = ("Xposition", "Yposition", "Zposition", "Xrotation", "Yrotation", "Zrotation")
            near = did_you_mean(word, known) if word else ""
            raise text.error(f"{_called(joint)} has {count:g} channels; expected one, got {_shown(word)}{near}")
        if word.lower() in joint.channels:
            raise text.error(f"{_called(joint)} has channel {word} twice", at)
        joint.channels.append(word.lower())


def _motion_header(text: _Text) -> tuple[int, float, list[str]]:
    """Read Frames and Frame Time, up to where the frames begin; return frames claimed, rate and warnings."""
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


def _setting(text: _Text, pattern: re.Pattern[bytes], expected: str) -> str:
    word = text.word()
    found = pattern.match(text.data, text.at)
    if found is None:
        raise text.error(f"expected {expected}, got {_shown(word)}")
    text.pos = found.end()
    value = found[1].rstrip()
    text.settings.append((found.start(1), found.start(1) + len(value)))
    return _decode(value).strip()


def frame_rate(frame_time: str) -> float:
    """Return the frames per second of a frame time as it is written.

    Frame times are cut or rounded to a few digits: 0.0083333 stands for 120 Hz and not for 120.0005. So the rate is a
    usual one where its own frame time, cut or rounded to as many digits (or to a 32-bit float), is the one that is
    written and no more than 2.5 % away; whole rates come before those of television (29.97). It is 1 / frame time
    where no usual rate is that near.

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
    """Return a frame time that `frame_rate` turns into a rate: with 8 decimals where they say enough."""
    short = f"{1.0 / rate_hz:.8f}"
    return short if frame_rate(short) == rate_hz else repr(1.0 / rate_hz)


def _too_few(fault: t.Fault, columns: int, last: bool) -> str:
    cut = ": the file is cut off in the middle of a frame" if last else ""
    return f"frame {fault.start} has {fault.stop} numbers, the hierarchy has {columns} channels{cut}"


def _explain(fault: t.Fault, data: bytes, columns: int) -> str:
    token = _decode(data[fault.start : min(fault.stop, fault.start + 40)])
    if fault.code == t.TOO_MANY:
        return f"unexpected {token!r}: more numbers than the {columns} channels of the hierarchy"
    return f"not a number: {token!r}"


def _line_start(data: bytes, line: int) -> int:
    ends = _LINE_END.finditer(data)
    return next((end.end() for number, end in enumerate(ends, 2) if number == line), 0)


def _name(joints: list[_Joint]) -> list[str]:
    """Give End Sites their names and every joint a name of its own; return warnings."""
    used: dict[str, int] = {}
    twice: list[str] = []
    for joint in joints:
        if not joint.end:
            twice += [joint.name] if joint.name in used else []
            joint.name = _free(joint.name, "#", used)
    for joint in joints:
        if joint.end:
            joint.name = _free(f"{joints[joint.parent].name}_end", "", used)
    names = list(dict.fromkeys(twice))
    if not names:
        return []
    shown = ", ".join(f"'{name}'" for name in names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")
    return [f"several joints have one name ({shown}); the second of them is read as '<name>#2', and so on"]


def _free(name: str, mark: str, used: dict[str, int]) -> str:
    """Return the name itself, or with the next number behind it if it is used already."""
    free = name
    while free in used:
        used[name] += 1
        free = f"{name}{mark}{used[name]}"
    used[free] = 1
    return free


def _chain(joints: Iterable[_Joint]) -> tuple[tuple[k.Node, ...], npt.NDArray[np.bool_]]:
    """Return the joints as nodes, and a mask of the channels that are rotations."""
    nodes = []
    rotations: list[bool] = []
    for joint in joints:
        offset = np.array(joint.offset, dtype=np.float64)
        kinds = [_CHANNELS[channel] for channel in joint.channels or ()]
        for kind in kinds:
            if kind >= k.MOVE_X:
                offset[kind - k.MOVE_X] = 0.0
        steps = tuple(k.Step(kind, column) for column, kind in enumerate(kinds, len(rotations)))
        rotations += [kind <= k.ROTATE_Z for kind in kinds]
        nodes.append(k.Node(joint.name, joint.parent, np.eye(3), offset, np.zeros(3), np.zeros(3), steps))
    return tuple(nodes), np.array(rotations)
