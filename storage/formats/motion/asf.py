"""Read ASF files, the skeletons of Acclaim motion, as real archives write them."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.ops.body import kinematics as k
from kinedex.ops.errors import SourceError, did_you_mean
from kinedex.storage.formats.motion.reader import MAX_POINTS
from kinedex.storage.formats.motion.text_blocks import LONGEST
from kinedex.storage.formats.source_files import file_size, source_bytes

INCH_M = 0.0254
"""Metres in an inch, the unit of Acclaim files."""

_DOFS = {"rx": k.ROTATE_X, "ry": k.ROTATE_Y, "rz": k.ROTATE_Z, "tx": k.MOVE_X, "ty": k.MOVE_Y, "tz": k.MOVE_Z}
_LARGEST = 1e9  # longer bones are implausible, and results computed from them would overflow
_SECTION = re.compile(r"^:([A-Za-z-]+)\s*(.*)$")


@dataclass
class Bone:
    """A bone of an ASF file, in the file's own units and in degrees."""

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

    Attributes
    ----------
    path : str
        The file.
    name : str
        The skeleton's name in the file.
    nodes : tuple of Node
        The bones, parents first.
    channels : tuple of (str, tuple of str)
        Bone and degrees of freedom of every line of an AMC frame, in the order of the channel matrix's columns.
    root_frame : float64 array (3, 3)
        The root's fixed orientation; in a frame, the root's orientation is its rotation times this matrix.
    length_scale : float
        The file's `length` unit; metres = value / length_scale · unit_m.
    unit_m : float
        Metres of one unit once `length_scale` has been divided out.
    degrees : bool
        True if the file's angles are degrees.
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
        """A dict from bone name to node index."""
        return {node.name: i for i, node in enumerate(self.nodes)}


@dataclass
class _Asf:
    """The content of an ASF file's sections, before it becomes a chain."""

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


def read_asf(path: str | Path, unit_m: float = INCH_M) -> Skeleton:
    """Read an ASF skeleton.

    Parameters
    ----------
    path : str or Path
        The file.
    unit_m : float, optional
        Metres of one unit once the file's `length` has been divided out; an inch by default.

    Raises
    ------
    SourceError
        The file is damaged; the error names the line of the first fault.
    """
    asf = _Asf(Path(path))
    size = file_size(asf.path)
    if size > LONGEST:
        raise asf.error(f"has {size / 1e6:.0f} MB; skeletons have at most {LONGEST >> 20} MB")
    # real headers hold bytes of any code page, and Latin-1 decodes them all
    lines = source_bytes(path).decode("latin-1").splitlines()
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
        if len(asf.bones) == MAX_POINTS:
            raise asf.error(f"more than {MAX_POINTS} bones: this is no body", bone.line)
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
    """Order the bones by the hierarchy, and convert them to nodes of a kinematic chain.

    With H the orientation of a bone times its axis rotation C, the Acclaim rule L = C · M · C⁻¹ becomes
    H = H_parent · (C_parent⁻¹ · C) · M: the node's fixed frame is C_parent⁻¹ · C, and its bone points along
    C⁻¹ · direction.
    """
    scale = unit_m / asf.length
    turn = 1.0 if asf.degrees else 180.0 / np.pi
    root_turn = _euler(asf.root_orientation, asf.root_axis, turn)
    axes = {name: _euler(bone.axis, bone.order, turn) for name, bone in asf.bones.items()}
    # The root's rotation M is left of its fixed orientation, so its node keeps identity axes and its children apply the
    # orientation.
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
            near = did_you_mean(parent, known)
            why = "must be a child in an earlier line" if parent in asf.bones else f"is no bone{near}"
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
    # The three numbers belong to X, Y, Z as written; `order` is the order of the rotations.
    by_axis = dict(zip("XYZ", degrees_or_radians, strict=True))
    return k.euler(tuple(by_axis[axis] * turn for axis in order), order)  # type: ignore[arg-type]


def _unit(direction: tuple[float, float, float]) -> npt.NDArray[np.float64]:
    vector = np.array(direction)
    size = np.linalg.norm(vector)
    return vector / size if size > 0 else vector


def _steps(dofs: tuple[str, ...], column: int) -> tuple[k.Step, ...]:
    """Return the channels of a bone; the first listed rotation is applied first, so its matrix is rightmost."""
    steps = [k.Step(k.STRETCH if dof == "l" else _DOFS[dof], column + i) for i, dof in enumerate(dofs)]
    rotations = [step for step in steps if step.kind <= k.ROTATE_Z]
    return (*(step for step in steps if step.kind > k.ROTATE_Z), *reversed(rotations))
