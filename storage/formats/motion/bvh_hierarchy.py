"""Parse the hierarchy of a BVH file: its joints with offsets and channels, and the chain that they form."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.ops.body import kinematics as k
from kinedex.ops.errors import SourceError, did_you_mean
from kinedex.storage.formats.source_files import any_text

LINE_END = re.compile(rb"\r\n?|\n")
"""The end of a line, as Windows, Unix or an old Macintosh writes it."""

_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
_TOKEN = re.compile(rb"[{}]|[^\s{}]+")
_TOLINE_END = re.compile(rb"[^\r\n]*")
_NAME = re.compile(rb"[^\r\n{}]*")


@dataclass
class BvhText:
    """The bytes of a file, and the position up to which they are parsed."""

    path: Path
    data: bytes
    pos: int = 0
    at: int = field(default=0, init=False)  # byte at which the last word began
    settings: list[tuple[int, int]] = field(default_factory=list, init=False)  # byte ranges of Frames and of Frame Time

    def line(self, at: int) -> int:
        """Return the line number of a byte, from 1."""
        return 1 + len(LINE_END.findall(self.data, 0, at))

    def error(self, message: str, at: int | None = None) -> SourceError:
        """Return an error that names the line of a byte, by default of the last word."""
        return SourceError(self.path, message, line=self.line(self.at if at is None else at))

    def word(self) -> str | None:
        """Return the next word or brace, skipping comments (# or // to the line's end); None at the end of the file."""
        while found := _TOKEN.search(self.data, self.pos):
            self.at, self.pos = found.span()
            if not found[0].startswith((b"#", b"//")):
                return any_text(found[0])
            self.pos = self._match(_TOLINE_END).end()
        self.at = self.pos = len(self.data)
        return None

    def rest(self) -> str:
        """Return the text up to the next brace or the end of the line."""
        found = self._match(_NAME)
        self.pos = found.end()
        return any_text(found[0]).strip()

    def _match(self, pattern: re.Pattern[bytes]) -> re.Match[bytes]:
        found = pattern.match(self.data, self.pos)
        assert found is not None  # both patterns match the empty text
        return found

    def number(self, what: str) -> float:
        """Parse a finite number; the error states what was expected."""
        word = self.word()
        value = float(word) if word is not None and _NUMBER.fullmatch(word) else np.nan
        if not np.isfinite(value):
            raise self.error(f"{what} must be a number, got {shown(word)}")
        return value


def shown(word: str | None) -> str:
    """Return a word in the form in which messages show it."""
    return "the end of the file" if word is None else repr(word[:40])


MAX_JOINTS = 10_000
"""The largest number of joints; a body has some hundred joints with every finger."""

_CHANNELS = {
    "xrotation": k.ROTATE_X, "yrotation": k.ROTATE_Y, "zrotation": k.ROTATE_Z,
    "xposition": k.MOVE_X, "yposition": k.MOVE_Y, "zposition": k.MOVE_Z,
}  # fmt: skip
_BOM = b"\xef\xbb\xbf"
_MOTION = re.compile(rb"(?<![^\s{}])MOTION(?![^\s{}])")
_KNOWN_BYTES = 1 << 17  # a longer hierarchy is parsed again for every file


@dataclass
class BvhJoint:
    """A ROOT, JOINT or End Site of the hierarchy while it is parsed."""

    name: str
    at: int
    parent: int
    end: bool = False
    offset: tuple[float, ...] | None = None
    channels: list[str] | None = None
    numbers: tuple[int, int] = (0, 0)  # start and stop of its OFFSET's numbers, in bytes
    stop: int = 0  # the byte after its closing brace


@dataclass(frozen=True)
class Hierarchy:
    """The joints of a BVH file as a chain; files with the same text before MOTION share one.

    Attributes
    ----------
    stop : int
        The byte after MOTION.
    nodes : tuple of Node
        Nodes, parents first, each with a unique name.
    rotations : bool array (C,)
        The channels that are rotations.
    offsets : float64 array (N, 3)
        The OFFSET of every node.
    redundant : frozenset of int
        Indices of End Sites at the position of their joint.
    spans, numbers : tuple of (int, int)
        Bytes of every node, and of the numbers of its OFFSET.
    warnings : tuple of str
        Warnings about the names.
    """

    stop: int
    nodes: tuple[k.Node, ...]
    rotations: npt.NDArray[np.bool_]
    offsets: npt.NDArray[np.float64]
    redundant: frozenset[int]
    spans: tuple[tuple[int, int], ...]
    numbers: tuple[tuple[int, int], ...]
    warnings: tuple[str, ...]


def read_hierarchy(text: BvhText) -> Hierarchy:
    """Parse the text up to MOTION; a hierarchy that was parsed before is taken from a cache.

    Raises
    ------
    SourceError
        The hierarchy is damaged; the error names the line.
    """
    found = _MOTION.search(text.data, 0, _KNOWN_BYTES)
    try:
        hierarchy = _known(text.data[: found.end()]) if found is not None else _parsed(text)
    except SourceError:
        hierarchy = _parsed(text)  # MOTION was part of a comment, or the error must name this file
    text.pos = hierarchy.stop
    return hierarchy


@lru_cache(maxsize=64)  # The takes of an archive share a few skeletons.
def _known(text: bytes) -> Hierarchy:
    return _parsed(BvhText(Path(), text))


def _parsed(text: BvhText) -> Hierarchy:
    text.pos = len(_BOM) if text.data.startswith(_BOM) else 0
    joints = _joints(text)
    warnings = name_joints(joints)
    nodes, rotations = chain_of(joints)
    offsets = np.array([joint.offset for joint in joints])
    for shared in (rotations, offsets):
        shared.flags.writeable = False
    return Hierarchy(
        stop=text.pos,
        nodes=nodes,
        rotations=rotations,
        offsets=offsets,
        redundant=frozenset(i for i, joint in enumerate(joints) if joint.end and not any(joint.offset or ())),
        spans=tuple((joint.at, joint.stop) for joint in joints),
        numbers=tuple(joint.numbers for joint in joints),
        warnings=tuple(warnings),
    )


def _joints(text: BvhText) -> list[BvhJoint]:
    """Parse the text up to MOTION, and return the joints in the order of the file, parents first."""
    word = text.word()
    if word is None or word.upper() != "HIERARCHY":
        raise text.error(f"expected HIERARCHY, got {shown(word)}: this is no BVH file")
    joints: list[BvhJoint] = []
    inside: list[int] = []
    while (word := text.word()) is not None:
        key = word.upper()
        if key == "MOTION" and joints and not inside:
            return joints
        if key in ("ROOT", "JOINT", "END"):
            _open_joint(text, key, joints, inside)
        elif not inside:
            expected = "MOTION" if joints else "ROOT"
            raise text.error(f"expected {expected}, got {shown(word)}{did_you_mean(word.upper(), [expected])}")
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
            raise text.error(f"expected OFFSET, CHANNELS, JOINT, End Site or '}}', got {shown(word)}")
    raise text.error("the file ends in its hierarchy, before MOTION (is it cut off?)")


def _called(joint: BvhJoint) -> str:
    return "an End Site" if joint.end else f"joint '{joint.name}'"


def _open_joint(text: BvhText, key: str, joints: list[BvhJoint], inside: list[int]) -> None:
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
    if len(joints) == MAX_JOINTS:
        raise text.error(f"more than {MAX_JOINTS} joints: this is no body", at)
    inside.append(len(joints))
    joints.append(BvhJoint(name, at, parent, end=key == "END"))


def _read_offset(text: BvhText, joint: BvhJoint) -> None:
    if joint.offset is not None:
        raise text.error(f"a second OFFSET of {_called(joint)}")
    values = [text.number(f"OFFSET of {_called(joint)}")]
    first = text.at
    values += [text.number(f"OFFSET of {_called(joint)}") for _ in range(2)]
    joint.offset, joint.numbers = tuple(values), (first, text.pos)


def _read_channels(text: BvhText, joint: BvhJoint) -> None:
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
            raise text.error(f"{_called(joint)} has {count:g} channels; expected one, got {shown(word)}{near}")
        if word.lower() in joint.channels:
            raise text.error(f"{_called(joint)} has channel {word} twice", at)
        joint.channels.append(word.lower())


def name_joints(joints: list[BvhJoint]) -> list[str]:
    """Name End Sites, and make all names unique, in place; return warnings."""
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
    """Return the name if it is unused, otherwise the name followed by the next free number."""
    free = name
    while free in used:
        used[name] += 1
        free = f"{name}{mark}{used[name]}"
    used[free] = 1
    return free


def chain_of(joints: Iterable[BvhJoint]) -> tuple[tuple[k.Node, ...], npt.NDArray[np.bool_]]:
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
