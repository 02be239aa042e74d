"""Read scenes of FBX files: nodes with their transforms, clips with their curves, axes, unit and rate.

The transform of a node follows the documentation of the FBX SDK ("Computing transformation matrices").
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.ops.body.keyframe_tracks import Curve
from kinedex.ops.body.kinematics import euler
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.fbx_records import Record, Value, read_records
from kinedex.storage.formats.motion.reader import MAX_POINTS
from kinedex.storage.formats.source_files import source_bytes

F64 = npt.NDArray[np.float64]

TICKS = 46_186_158_000
"""FBX time units per second."""

RATES_HZ = {
    1: 120.0, 2: 100.0, 3: 60.0, 4: 50.0, 5: 48.0, 6: 30.0, 7: 30.0, 8: 29.97, 9: 29.97, 10: 25.0, 11: 24.0,
    12: 1000.0, 13: 23.976, 15: 96.0, 16: 72.0, 17: 59.94, 18: 119.88,
}  # fmt: skip
"""A dict from the file's TimeMode to frames per second; 14 stands for a rate that the file states itself."""

ORDERS = ("XYZ", "XZY", "YZX", "YXZ", "ZXY", "ZYX", "XYZ")
"""The order of a node's rotations about its axes, the first applied one first, indexed by RotationOrder."""

CHANNELS = {"Lcl Translation": 0, "Lcl Rotation": 1, "Lcl Scaling": 2}
"""A dict from the properties that move a node to their indices."""

BONES = {"LimbNode", "Limb", "Root", "Effector"}
"""Classes of nodes that are bones."""

_ANIMATION = ("Stack", "Layer", "CurveNode", "Curve")

_POINTS = {"RotationOffset", "RotationPivot", "ScalingOffset", "ScalingPivot", "PreRotation", "PostRotation"}


@dataclass(eq=False)
class SceneNode:
    """A node of the scene.

    Attributes
    ----------
    name, kind : str
        Its name, and its class, such as "LimbNode".
    moves : list of float64 array (3,)
        Translation, rotation in degrees, and scale outside of clips.
    points : dict of str to float64 array (3,)
        Pivots, offsets, and pre- and post-rotations that are not 0.
    order : str
        The order of its rotations, the first applied one first.
    """

    name: str
    kind: str
    moves: list[F64] = field(default_factory=lambda: [np.zeros(3), np.zeros(3), np.ones(3)])
    points: dict[str, F64] = field(default_factory=dict)
    order: str = "XYZ"

    def local(self, moved: F64, turned: F64, scaled: F64) -> tuple[F64, F64]:
        """Return rotation with scale (T, 3, 3), and position (T, 3), relative to the parent.

        Parameters
        ----------
        moved, turned, scaled : float64 array (T, 3)
            Translation, rotation in degrees, and scale.
        """
        zero = np.zeros(3)
        offset, pivot = (self.points.get(f"Rotation{end}", zero) for end in ("Offset", "Pivot"))
        scale_offset, scale_pivot = (self.points.get(f"Scaling{end}", zero) for end in ("Offset", "Pivot"))
        before, after = (euler_rotation(self.points.get(name, zero)) for name in ("PreRotation", "PostRotation"))
        rotations = before @ rotations_of(turned, self.order) @ after.T
        linear = rotations * scaled[:, None, :]
        about = scale_offset + scale_pivot - pivot
        place = moved + offset + pivot + rotations @ about - linear @ scale_pivot
        return linear, place


def euler_rotation(degrees: F64) -> F64:
    """Return the matrix of rotations about X, then Y, then Z, as pre- and post-rotations use it."""
    return euler((float(degrees[0]), float(degrees[1]), float(degrees[2])), "XYZ")


def rotations_of(degrees: F64, order: str) -> F64:
    """Return the matrices (T, 3, 3) of angles (T, 3) about X, Y and Z, applied in the order of `order`."""
    angles = np.deg2rad(degrees)
    result = np.broadcast_to(np.eye(3), (len(degrees), 3, 3))
    for name in order:
        axis = "XYZ".index(name)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        matrix = np.zeros((len(degrees), 3, 3))
        matrix[:, axis, axis] = 1.0
        matrix[:, i, i] = matrix[:, j, j] = np.cos(angles[:, axis])
        matrix[:, j, i] = np.sin(angles[:, axis])
        matrix[:, i, j] = -matrix[:, j, i]
        result = matrix @ result
    return result


@dataclass(eq=False)
class Clip:
    """A clip, which FBX calls an animation stack.

    Attributes
    ----------
    name : str
        Its name.
    curves : dict
        (node, property, axis) → curve; properties are those of `CHANNELS`.
    span : tuple of float, optional
        Start and end of the clip in seconds, if the file states them.
    layers : int
        2 if several layers move nodes, of which only the first is read; else 0.
    """

    name: str
    curves: dict[tuple[int, int, int], Curve] = field(default_factory=dict)
    span: tuple[float, float] | None = None
    layers: int = 0


class Scene:
    """The nodes and clips of an FBX file.

    Parameters
    ----------
    path : Path
        The file.
    data : bytes, optional
        Its content, if it has been read already.

    Raises
    ------
    SourceError
        The file is damaged or not FBX.
    """

    def __init__(self, path: Path, data: bytes | None = None) -> None:
        self.path = path
        content = source_bytes(path, data)
        self.size = len(content)
        top, self.version = read_records(path, content)
        self.settings = _properties(top.first("GlobalSettings"))
        self.nodes: list[SceneNode] = []
        self.parents: list[int] = []
        self.clips: list[Clip] = []
        self._objects = top.first("Objects")
        self._links = _links(top.first("Connections"))
        self._place: dict[int, int] = {}
        self._read_nodes()
        self._read_clips()

    @cached_property
    def axes(self) -> F64:
        """The matrix (3, 3) from the file's axes and unit to metres, X left, Y up, Z forward."""
        rows = []
        for key, usual in (("CoordAxis", 0), ("UpAxis", 1), ("FrontAxis", 2)):
            axis = self.settings.get(key, [usual])
            sign = self.settings.get(f"{key}Sign", [1])
            row = np.zeros(3)
            row[int(_first(axis, usual)) % 3] = -1.0 if _first(sign, 1) < 0 else 1.0
            rows.append(row)
        axes = np.array(rows)
        if abs(np.linalg.det(axes)) < 0.5:
            raise SourceError(self.path, "GlobalSettings has one axis for two of UpAxis, FrontAxis and CoordAxis")
        unit = _first(self.settings.get("UnitScaleFactor", [1.0]), 1.0)
        if not 1e-6 <= unit <= 1e6:
            raise SourceError(self.path, f"UnitScaleFactor must be the centimetres of the unit, got {unit:g}")
        return axes * (0.01 * unit)

    @property
    def rate_hz(self) -> float | None:
        """The frames per second that the file states; None if it states none, or no plausible number."""
        mode = int(_first(self.settings.get("TimeMode", [0]), 0))
        if mode == 14:
            rate = _first(self.settings.get("CustomFrameRate", [0.0]), 0.0)
            return rate if 1.0 <= rate <= 10_000.0 else None
        return RATES_HZ.get(mode)

    def bind_pose(self) -> dict[int, F64]:
        """Return a dict from node to transform (4, 4) in the scene's axes, from the file's bind pose."""
        found: dict[int, F64] = {}
        for pose in self._objects.all("Pose"):
            if "BindPose" not in pose.values:
                continue
            for entry in pose.all("PoseNode"):
                number = next(iter(entry.first("Node").values), None)
                matrix = entry.first("Matrix").numbers()
                if isinstance(number, int) and number in self._place and len(matrix) == 16 and _usable(matrix):
                    found[self._place[number]] = matrix.reshape(4, 4).T
        return found

    def _read_nodes(self) -> None:
        for record in self._objects.all("Model"):
            number, name, kind = ([*record.values, "", "", ""])[:3]
            if not isinstance(number, int) or number in self._place:
                continue
            if len(self.nodes) == MAX_POINTS:
                raise SourceError(self.path, f"has more than {MAX_POINTS} nodes")
            self._place[number] = len(self.nodes)
            self.nodes.append(_node(_called(name), str(kind), _properties(record)))
        self.parents = [-1] * len(self.nodes)
        for below, above, _ in self._links:
            if below in self._place and above in self._place and self.parents[self._place[below]] < 0:
                self.parents[self._place[below]] = self._place[above]
        for node in range(len(self.nodes)):
            self._refuse_circle(node)

    def _refuse_circle(self, node: int) -> None:
        at, steps = node, 0
        while at >= 0:
            at, steps = self.parents[at], steps + 1
            if steps > len(self.nodes):
                raise SourceError(self.path, f"node '{self.nodes[node].name[:60]}' hangs from itself")

    def _read_clips(self) -> None:
        stacks, layers, moves, curves = (self._numbered(f"Animation{kind}") for kind in _ANIMATION)
        of_stack = {below: above for below, above, _ in self._links if below in layers and above in stacks}
        of_layer = {below: above for below, above, _ in self._links if below in moves and above in layers}
        target: dict[int, tuple[int, int]] = {}
        for below, above, name in self._links:
            if below in moves and above in self._place and name in CHANNELS:
                target[below] = (self._place[above], CHANNELS[name])
        clips = {
            number: Clip(_called(([*stack.values, "", ""])[1]) or "clip", span=_span(stack))
            for number, stack in stacks.items()
        }
        first: dict[int, int] = {}
        for below, above, name in self._links:
            axis = "XYZ".find(name[-1:]) if name else -1
            if axis < 0 or below not in curves or above not in target or of_layer.get(above) not in of_stack:
                continue
            layer = of_layer[above]
            clip = clips[of_stack[layer]]
            if first.setdefault(of_stack[layer], layer) != layer:
                clip.layers = 2
            else:
                clip.curves[(*target[above], axis)] = self._curve(curves[below])
        self.clips = list(clips.values())

    def _numbered(self, kind: str) -> dict[int, Record]:
        """Return the objects of a kind by their ids."""
        found: dict[int, Record] = {}
        for record in self._objects.all(kind):
            number = record.values[0] if record.values else None
            if isinstance(number, int):
                found[number] = record
        return found

    def _curve(self, record: Record) -> Curve:
        """Return the curve of a record, its times in seconds."""
        times = record.first("KeyTime").whole_numbers() / TICKS
        values = record.first("KeyValueFloat").numbers()
        flags, counts = (record.first(name).whole_numbers() for name in ("KeyAttrFlags", "KeyAttrRefCount"))
        slopes = record.first("KeyAttrDataFloat").numbers()
        if not len(times) or len(values) != len(times) or (np.diff(times) < 0).any() or not _usable(values):
            raise SourceError(
                self.path,
                f"a curve must have ascending times and as many finite values, got {len(times)} times and "
                f"{len(values)} values",
            )
        whole = len(counts) == len(flags) and (counts > 0).all() and counts.sum() == len(times)
        if not whole or len(slopes) != 4 * len(flags):
            return Curve(times, values)
        runs = np.repeat(np.arange(len(flags)), counts)
        tangents = np.where(np.abs(slopes.reshape(-1, 4)) < 1e12, slopes.reshape(-1, 4), 0.0)
        return Curve(times, values, flags[runs], tangents[runs])


def _usable(numbers: F64) -> bool:
    return bool((np.abs(numbers) <= 1e12).all())


def _first(values: list[float], default: float) -> float:
    return values[0] if values and np.isfinite(values[0]) else default


def _called(name: Value) -> str:
    """Return the name of an object: `Hips` of "Hips\\0\\1Model" (binary) and "Model::Hips" (text)."""
    text = name if isinstance(name, str) else ""
    if "\0" in text:
        return text.partition("\0")[0]
    return text.partition("::")[2] if text.startswith(("Model::", "AnimStack::")) else text


def _links(connections: Record) -> list[tuple[int, int, str]]:
    """Return the connections: the lower object, the upper one, and the property if one is connected."""
    found = []
    for record in connections.all("C"):
        kind, below, above, name = ([*record.values, "", "", "", ""])[:4]
        if kind in ("OO", "OP") and isinstance(below, int) and isinstance(above, int):
            found.append((below, above, name if isinstance(name, str) else ""))
    return found


def _properties(record: Record) -> dict[str, list[float]]:
    """Return the numeric properties of an object."""
    found: dict[str, list[float]] = {}
    for entry in record.first("Properties70").all("P"):
        if entry.values and isinstance(entry.values[0], str):
            numbers = [float(value) for value in entry.values[4:] if isinstance(value, int | float)]
            found[entry.values[0]] = numbers
    return found


def _span(stack: Record) -> tuple[float, float] | None:
    given = _properties(stack)
    start, stop = (_first(given.get(key, [0.0]), 0.0) / TICKS for key in ("LocalStart", "LocalStop"))
    return (start, stop) if stop > start else None


def _node(name: str, kind: str, given: Mapping[str, list[float]]) -> SceneNode:
    node = SceneNode(name, kind)
    for key, place in CHANNELS.items():
        if (found := _vector(given, key)) is not None:
            node.moves[place] = found
    active = _first(given.get("RotationActive", [0.0]), 0.0) != 0
    order = int(_first(given.get("RotationOrder", [0.0]), 0.0))
    for key in _POINTS:
        found = _vector(given, key)
        if found is not None and found.any() and (active or key not in ("PreRotation", "PostRotation")):
            node.points[key] = found
    if active and 0 <= order < len(ORDERS):
        node.order = ORDERS[order]
    return node


def _vector(given: Mapping[str, list[float]], key: str) -> F64 | None:
    numbers = np.array(given.get(key, ()), np.float64)
    return numbers[:3] if len(numbers) >= 3 and _usable(numbers[:3]) else None
