"""Acclaim files: ASF skeletons and AMC motion, as real archives write them."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.ops import textnumbers as t
from kinedex.ops.body import kinematics as k
from kinedex.ops.errors import SourceError, did_you_mean

INCH_M = 0.0254
RATE_HZ = 120.0  # Acclaim files do not say their rate; Vicon wrote them at 120 Hz

_DOFS = {"rx": k.ROTATE_X, "ry": k.ROTATE_Y, "rz": k.ROTATE_Z, "tx": k.MOVE_X, "ty": k.MOVE_Y, "tz": k.MOVE_Z}
_LARGEST = 1e9  # lengths beyond this are no body's, and what is computed of them would overflow
_SECTION = re.compile(r"^:([A-Za-z-]+)\s*(.*)$")


@dataclass
class Bone:
    """One bone of an ASF file, in the file's own units and degrees."""

    name: str
    line: int
    direction: tuple[float, float, float] = (0.0, 0.0, 0.0)
    length: float = 0.0
    axis: tuple[float, float, float] = (0.0, 0.0, 0.0)
    order: str = "XYZ"
    dofs: tuple[str, ...] = ()


@dataclass(frozen=True)
class Skeleton:
    """An ASF file as a chain of nodes; node 0 is the root.

    channels: per row of an AMC frame its name and dof names, in the order of the channel matrix's columns.
    root_frame: (3, 3) the root's fixed orientation; the root's orientation in a frame is its own turn times this.
    length_scale: the ASF's `length` unit; metres = value / length_scale · unit_m.
    degrees: whether the ASF's angles are degrees.
    """

    path: str
    name: str
    nodes: tuple[k.Node, ...]
    channels: tuple[tuple[str, tuple[str, ...]], ...]
    root_frame: npt.NDArray[np.float64]
    length_scale: float
    unit_m: float
    degrees: bool

    @property
    def bones(self) -> dict[str, int]:
        """Bone name → node index."""
        return {node.name: i for i, node in enumerate(self.nodes)}


@dataclass
class _Asf:
    """What the sections of an ASF file say, before it becomes a chain."""

    path: Path
    name: str = ""
    length: float = 1.0
    degrees: bool = True
    root_order: tuple[str, ...] = ("tx", "ty", "tz", "rx", "ry", "rz")
    root_axis: str = "XYZ"
    root_position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    root_orientation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    bones: dict[str, Bone] = field(default_factory=dict)
    children: list[tuple[int, str, list[str]]] = field(default_factory=list)

    def error(self, message: str, line: int | None = None) -> SourceError:
        return SourceError(self.path, message, line=line)

    def floats(self, words: list[str], count: int, what: str, line: int) -> tuple[float, ...]:
        try:
            values = tuple(float(word) for word in words[:count])
        except ValueError:
            raise self.error(f"{what} must be {count} numbers, got {' '.join(words)!r}", line) from None
        if len(values) < count or not all(abs(value) <= _LARGEST for value in values):
            raise self.error(f"{what} must be {count} numbers of at most {_LARGEST:g}, got {' '.join(words)!r}", line)
        return values

    def axes(self, word: str, line: int) -> str:
        if sorted(word.upper()) != ["X", "Y", "Z"]:
            raise self.error(f"axis order must be a permutation of XYZ, got {word!r}", line)
        return word.upper()


def read_text(path: str | Path, data: bytes | None = None) -> bytes:
    """The bytes of a source file (`data`, once they are read), or a SourceError: an empty one, too."""
    try:
        data = Path(path).read_bytes() if data is None else data
    except OSError as fault:
        raise SourceError(path, f"cannot be read: {fault.strerror}") from fault
    if not data or data.isspace():
        raise SourceError(path, "the file is empty")
    return data


def read_asf(path: str | Path, unit_m: float = INCH_M) -> Skeleton:
    """Read an ASF skeleton.

    Parameters
    ----------
    path: the file. unit_m: metres of one unit once the file's `length` has been divided out (Acclaim: inches).

    Raises
    ------
    SourceError: with the line of the first thing that is wrong or missing.
    """
    asf = _Asf(Path(path))
    # Real headers hold bytes of every code page; Latin-1 reads them all.
    lines = read_text(path).decode("latin-1").splitlines()
    section, bone = "", None
    for number, raw in enumerate(lines, 1):
        text = raw.split("#", 1)[0].strip()
        if not text:
            continue
        found = _SECTION.match(text)
        if found:
            section = found[1].lower()
            if section == "name":
                asf.name = found[2].strip()
            continue
        words = text.split()
        if section == "units":
            _read_unit(asf, words, number)
        elif section == "root":
            _read_root(asf, words, number)
        elif section == "bonedata":
            bone = _read_bone(asf, bone, words, number)
        elif section == "hierarchy" and words[0] not in ("begin", "end"):
            asf.children.append((number, words[0], words[1:]))
    if bone is not None:
        raise asf.error(f"the bone that begins here has no 'end': the file is cut off{_named(bone)}", bone.line)
    if not asf.bones:
        raise asf.error("no :bonedata section: this is no ASF skeleton, or it is cut off")
    if not asf.children:
        raise asf.error("no :hierarchy section: the file is cut off")
    return _chain(asf, unit_m)


def _named(bone: Bone) -> str:
    return f" (bone '{bone.name}')" if bone.name else ""


def _read_unit(asf: _Asf, words: list[str], line: int) -> None:
    if words[0].lower() == "length":
        (asf.length,) = asf.floats(words[1:], 1, "length", line)
        if asf.length < 1 / _LARGEST:
            raise asf.error(f"length must be positive, at least {1 / _LARGEST:g}, got {asf.length}", line)
    elif words[0].lower() == "angle":
        if len(words) < 2 or words[1].lower()[:3] not in ("deg", "rad"):
            raise asf.error(f"angle must be deg or rad, got {' '.join(words[1:])!r}", line)
        asf.degrees = words[1].lower().startswith("deg")


def _read_root(asf: _Asf, words: list[str], line: int) -> None:
    key = words[0].lower()
    if key == "order":
        order = tuple(word.lower() for word in words[1:])
        wrong = [word for word in order if word not in _DOFS]
        if wrong or len(set(order)) != len(order):
            raise asf.error(f"root order must name each of TX TY TZ RX RY RZ at most once, got {words[1:]}", line)
        asf.root_order = order
    elif key == "axis":
        asf.root_axis = asf.axes("".join(words[1:]), line)
    elif key == "position":
        x, y, z = asf.floats(words[1:], 3, "position", line)
        asf.root_position = (x, y, z)
    elif key == "orientation":
        x, y, z = asf.floats(words[1:], 3, "orientation", line)
        asf.root_orientation = (x, y, z)


def _read_bone(asf: _Asf, bone: Bone | None, words: list[str], line: int) -> Bone | None:
    key = words[0].lower()
    if key == "begin":
        if bone is not None:
            raise asf.error(f"'begin' inside the bone that begins in line {bone.line}{_named(bone)}", line)
        return Bone("", line)
    if bone is None:
        raise asf.error(f"expected 'begin', got {words[0]!r}", line)
    if key == "end":
        if not bone.name:
            raise asf.error("this bone has no name", bone.line)
        if bone.name in asf.bones or bone.name == "root":
            raise asf.error(f"a second bone named '{bone.name}'", bone.line)
        asf.bones[bone.name] = bone
        return None
    if key == "name":
        bone.name = words[1] if len(words) > 1 else ""
    elif key == "direction":
        x, y, z = asf.floats(words[1:], 3, "direction", line)
        bone.direction = (x, y, z)
    elif key == "length":
        (bone.length,) = asf.floats(words[1:], 1, "length", line)
    elif key == "axis":
        x, y, z = asf.floats(words[1:], 3, "axis", line)
        bone.axis = (x, y, z)
        bone.order = asf.axes(words[4] if len(words) > 4 else "XYZ", line)
    elif key == "dof":
        bone.dofs = tuple(word.lower() for word in words[1:])
        wrong = [dof for dof in bone.dofs if dof not in _DOFS and dof != "l"]
        if wrong or len(set(bone.dofs)) != len(bone.dofs):
            raise asf.error(f"dof must name each of rx ry rz tx ty tz l at most once, got {words[1:]}", line)
    return bone


def _chain(asf: _Asf, unit_m: float) -> Skeleton:
    """Order the bones by the hierarchy and turn them into nodes.

    With H the orientation of a bone times its axis rotation C, the Acclaim rule L = C · M · C⁻¹ becomes
    H = H_parent · (C_parent⁻¹ · C) · M: the node's fixed frame is C_parent⁻¹ · C, and its bone points along
    C⁻¹ · direction.
    """
    scale = unit_m / asf.length
    turn = 1.0 if asf.degrees else 180.0 / np.pi
    root_turn = _euler(asf.root_orientation, asf.root_axis, turn)
    axes = {name: _euler(bone.axis, bone.order, turn) for name, bone in asf.bones.items()}
    # The root's own rotation M comes left of its fixed orientation, so its node keeps identity axes and its children
    # take the orientation over.
    nodes = [
        k.Node("root", -1, np.eye(3), np.array(asf.root_position) * scale, np.zeros(3), np.zeros(3),
               _steps(asf.root_order, 0))
    ]  # fmt: skip
    channels = [("root", asf.root_order)]
    column = len(asf.root_order)
    index = {"root": 0}
    for line, parent, children in asf.children:
        if parent not in index:
            known = [*asf.bones, "root"]
            why = "stands before its own parent" if parent in asf.bones else f"is no bone{did_you_mean(parent, known)}"
            raise asf.error(f"hierarchy: '{parent}' {why}", line)
        for name in children:
            if name not in asf.bones:
                raise asf.error(f"hierarchy: '{name}' is no bone{did_you_mean(name, asf.bones)}", line)
            if name in index:
                raise asf.error(f"hierarchy: '{name}' has two parents", line)
            bone = asf.bones[name]
            frame = (root_turn if parent == "root" else axes[parent].T) @ axes[name]
            direction = axes[name].T @ _unit(bone.direction)
            after = direction * bone.length * scale
            index[name] = len(nodes)
            nodes.append(k.Node(name, index[parent], frame, np.zeros(3), after, direction, _steps(bone.dofs, column)))
            column += len(bone.dofs)
            if bone.dofs:
                channels.append((name, bone.dofs))
    loose = [name for name in asf.bones if name not in index]
    if loose:
        raise asf.error(f"hierarchy: bone '{loose[0]}' has no parent", asf.bones[loose[0]].line)
    return Skeleton(str(asf.path), asf.name, tuple(nodes), tuple(channels), root_turn, asf.length, unit_m, asf.degrees)


def _euler(degrees_or_radians: tuple[float, float, float], order: str, turn: float) -> npt.NDArray[np.float64]:
    # The three numbers belong to X, Y, Z as written; `order` says which turn comes first.
    by_axis = dict(zip("XYZ", degrees_or_radians, strict=True))
    return k.euler(tuple(by_axis[axis] * turn for axis in order), order)  # type: ignore[arg-type]


def _unit(direction: tuple[float, float, float]) -> npt.NDArray[np.float64]:
    vector = np.array(direction)
    size = np.linalg.norm(vector)
    return vector / size if size > 0 else vector


def _steps(dofs: tuple[str, ...], column: int) -> tuple[k.Step, ...]:
    """The channels of a bone; the first listed turn is applied first, so its matrix stands rightmost."""
    steps = [k.Step(k.STRETCH if dof == "l" else _DOFS[dof], column + i) for i, dof in enumerate(dofs)]
    turns = [step for step in steps if step.kind <= k.ROTATE_Z]
    return (*(step for step in steps if step.kind > k.ROTATE_Z), *reversed(turns))


@dataclass(frozen=True)
class Motion:
    """An AMC file: channels float64 (T, C), radians and metres, in the skeleton's column order; warnings in words."""

    channels: npt.NDArray[np.float64]
    warnings: tuple[str, ...] = ()


def read_amc(path: str | Path, skeleton: Skeleton, data: bytes | None = None) -> Motion:
    """Read an AMC motion that belongs to a skeleton.

    Parameters
    ----------
    data: the file's bytes, where they have been read already.

    Raises
    ------
    SourceError: with the line of the first thing that is wrong; nothing of such a file is used.
    """
    data = read_text(path, data)
    start, line, degrees = _amc_header(Path(path), data)
    names = [name for name, _ in skeleton.channels]
    widths = [len(dofs) for _, dofs in skeleton.channels]
    values, first, fault = t.parse_frames(data, start, line, names, widths)
    if fault is not None:
        raise SourceError(path, _explain(fault, data, skeleton), line=fault.line)
    if not len(values):
        raise SourceError(path, "no frames: the file ends after its header", line=line)
    turn, metres = np.pi / 180.0 if degrees else 1.0, skeleton.unit_m / skeleton.length_scale
    values *= [turn if dof in ("rx", "ry", "rz") else metres for _, dofs in skeleton.channels for dof in dofs]
    warnings = () if first == 1 else (f"frame numbers begin at {first}; its source frame here is 0",)
    return Motion(values, warnings)


def _amc_header(path: Path, data: bytes) -> tuple[int, int, bool]:
    """Byte and line where the frames begin, and whether angles are degrees."""
    position, line, degrees = 0, 1, True
    while position < len(data):
        stop = next((i for i in range(position, len(data)) if data[i] in b"\r\n"), len(data))
        text = data[position:stop].decode("latin-1").strip()
        if text[:1].isdigit():
            return position, line, degrees
        if text.lower().startswith(":radians"):
            degrees = False
        elif text and text[0] not in ":#":
            raise SourceError(path, f"expected a frame number, got {text[:40]!r}", line=line)
        position = stop + (2 if data[stop : stop + 2] == b"\r\n" else 1)
        line += 1
    raise SourceError(path, "no frames: the file ends after its header", line=line)


def _explain(fault: t.Fault, data: bytes, skeleton: Skeleton) -> str:
    token = data[fault.start : min(fault.stop, fault.start + 40)].decode("latin-1")
    names = [name for name, _ in skeleton.channels]
    asf = os.path.basename(skeleton.path)
    match fault.code:
        case t.BAD_NUMBER:
            return f"not a number: {token!r}"
        case t.TOO_FEW:
            name, dofs = skeleton.channels[fault.start]
            return f"bone '{name}' has {fault.stop} numbers, {asf} gives it {len(dofs)} ({' '.join(dofs)})"
        case t.TOO_MANY:
            return f"unexpected {token!r} at the end of the line: more numbers than {asf} gives this bone"
        case t.UNKNOWN_NAME:
            if fault.stop == len(data):
                return f"the file ends in '{token}', in the middle of a frame: is it cut off?"
            return f"bone '{token}' is not in {asf}, or has no dof there{did_you_mean(token, names)}"
        case t.TWICE:
            return f"bone '{token}' stands twice in one frame"
        case t.MISSING:
            name = names[fault.start]
            if fault.stop:
                return f"the file ends in the middle of a frame: bone '{name}' is missing (is the file cut off?)"
            return f"the frame before this line lacks bone '{name}'"
        case t.NOT_NEXT:
            return f"frame {fault.stop} follows frame {fault.start}: frames are missing or out of order"
    return f"expected a frame number, got {token!r}"
