"""FBX files whose records are changed one by one, for `studies.mutations`."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.storage.formats.motion.fbx_records import Record, read_records
from kinedex.storage.formats.motion.fbx_scene import BONES, rotations_of
from studies.skeleton_mutations import BvhText, node_names
from studies.wild_variants import euler_angles
from tests.bvh_files import POSITIONS, ROTATIONS, Joint
from tests.fbx_files import ORDERS, Builder, Part, properties

_AXES = ("d|X", "d|Y", "d|Z")


@dataclass
class FbxScene:
    """An FBX file: the file that it was made of, whether it is written as text, and its records."""

    name: str
    as_text: bool
    records: Builder

    form: ClassVar[str] = "FBX"
    ending: ClassVar[str] = ".fbx"

    def copied(self) -> FbxScene:
        """Return a copy that can be changed."""
        return FbxScene(self.name, self.as_text, copy.deepcopy(self.records))

    @property
    def names(self) -> dict[int, str]:
        """A dict from each bone to its name, parents first."""
        bones = {model.values[0]: model.values[1][1] for model in self._models() if model.values[2] in BONES}
        above, depth = self.parents, {}
        for bone in bones:
            at, depth[bone] = bone, 0
            while at in above:
                at, depth[bone] = above[at], depth[bone] + 1
        return {bone: bones[bone] for bone in sorted(bones, key=depth.__getitem__)}

    @property
    def parents(self) -> dict[int, int]:
        """A dict from each node to its parent, without roots."""
        models = {model.values[0] for model in self._models()}
        links = (link.values for link in self.records.links.below)
        return {link[1]: link[2] for link in links if link[0] == "OO" and link[1] in models and link[2] in models}

    def offset(self, node: int) -> F64:
        """Return the place of a node relative to its parent, outside of clips."""
        given = _property(self._model(node), "Lcl Translation")
        return np.array(given.values[4:7] if given is not None else (0.0, 0.0, 0.0), np.float64)

    def rename(self, node: int, name: str) -> None:
        """Give a node another name."""
        model = self._model(node)
        model.values = (node, ("Model", name), *model.values[2:])

    def move(self, node: int, change: Callable[[F64], F64]) -> None:
        """Change a node's places relative to its parent, outside of clips and in them; axis by axis."""
        _set(self._model(node), "Lcl Translation", change(self.offset(node)).tolist())
        for axis, curve in self._curves(node, "Lcl Translation").items():
            values = _array(curve, "KeyValueFloat")
            rows = np.zeros((len(values), 3))
            rows[:, axis] = values
            _set_array(curve, "KeyValueFloat", change(rows)[:, axis].astype("<f4"))

    def divide(self, node: int, name: str) -> None:
        """Insert a bone without rotation halfway between a bone and its parent."""
        above = self.parents[node]
        self.move(node, lambda place: place / 2)
        twist = self._bone(name, self.offset(node))
        for link in self.records.links.below:
            if link.values[:3] == ("OO", node, above):
                link.values = ("OO", node, twist)
        self.records.link(twist, above)
        worlds = self.bound
        if node in worlds and above in worlds:
            worlds[twist] = worlds[above].copy()
            worlds[twist][:3, 3] = (worlds[above][:3, 3] + worlds[node][:3, 3]) / 2
            self.bind(worlds)

    def add_end(self, node: int, name: str, offset: F64) -> None:
        """Add a bone below another."""
        end = self._bone(name, offset)
        self.records.link(end, node)
        worlds = self.bound
        if node in worlds:
            worlds[end] = worlds[node].copy()
            worlds[end][:3, 3] += worlds[node][:3, :3] @ offset
            self.bind(worlds)

    def hang(self, degrees: float, scale: float) -> None:
        """Hang the bones from a node that is turned about X and scaled."""
        turned = properties(Lcl_Rotation=[degrees, 0.0, 0.0], Lcl_Scaling=[scale] * 3)
        node, bones = self.records.add("Model", "Armature", "Null", turned), self.names
        for link in self.records.links.below:
            if link.values[0] == "OO" and link.values[1] in bones and link.values[2] not in bones:
                link.values = ("OO", link.values[1], node)
        self.records.link(node, 0)

    def pace(self, factor: float) -> None:
        """Let the clips run so many times as fast."""
        for curve in self._all("AnimationCurve"):
            _set_array(curve, "KeyTime", np.round(_array(curve, "KeyTime") / factor).astype("<i8"))
        for stack in self._all("AnimationStack"):
            for key in ("LocalStart", "LocalStop"):
                if (given := _property(stack, key)) is not None:
                    given.values = (*given.values[:4], round(given.values[4] / factor))

    def shuffle(self, random: np.random.Generator) -> None:
        """List objects and connections in another order."""
        for part in (self.records.objects, self.records.links):
            part.below = [part.below[i] for i in random.permutation(len(part.below))]

    def reorder(self) -> None:
        """Let the bones turn about Y, then X, then Z, with the same rotations."""
        for node in self.names:
            model, curves = self._model(node), self._curves(node, "Lcl Rotation")
            still = _property(model, "Lcl Rotation")
            if len(curves) < 3 or _property(model, "PreRotation") or _property(model, "PostRotation"):
                continue
            active = (_property(model, "RotationActive") or Part("", (0,) * 5)).values[4]
            order = (_property(model, "RotationOrder") or Part("", (0,) * 5)).values[4] if active else 0
            angles = [_array(curves[axis], "KeyValueFloat") for axis in range(3)]
            if len({len(values) for values in angles}) > 1:
                continue
            turns = rotations_of(np.stack(angles, axis=1).astype(np.float64), ORDERS[order])
            y, x, z = np.rad2deg(euler_angles(turns, (1, 0, 2)))
            for axis, values in enumerate((x, y, z)):
                _set_array(curves[axis], "KeyValueFloat", values.astype("<f4"))
            if still is not None:
                turn = rotations_of(np.array([still.values[4:7]], np.float64), ORDERS[order])
                y, x, z = np.rad2deg(euler_angles(turn, (1, 0, 2)))
                _set(model, "Lcl Rotation", [float(x[0]), float(y[0]), float(z[0])])
            _set(model, "RotationActive", [1])
            _set(model, "RotationOrder", [ORDERS.index("ZXY")])

    def state(self, **settings: Sequence[float] | None) -> None:
        """Let the header state other settings; None removes one."""
        for name, values in settings.items():
            below = _properties(self.records.settings).below
            _properties(self.records.settings).below = [one for one in below if one.values[0] != name]
            if values is not None:
                _set(self.records.settings, name, values)

    def stated(self, name: str) -> float:
        """Return a number of the header."""
        given = _property(self.records.settings, name)
        return float(given.values[4]) if given is not None else 1.0

    @property
    def bound(self) -> dict[int, F64]:
        """A dict from bone to its matrix in the pose of binding; empty if the file has none."""
        return {
            _first(entry, "Node").values[0]: _array(entry, "Matrix").reshape(4, 4).T.copy()
            for pose in self._all("Pose")
            for entry in pose.below
            if entry.name == "PoseNode"
        }

    def bind(self, worlds: Mapping[int, F64]) -> None:
        """Replace the pose of binding."""
        if worlds:
            self.records.objects.below = [one for one in self.records.objects.below if one.name != "Pose"]
            entries = [
                Part("PoseNode", (), [Part("Node", (node,)), Part("Matrix", (world.T.ravel().astype("<f8"),))])
                for node, world in worlds.items()
            ]
            self.records.add("Pose", "bind", "BindPose", *entries)

    def write(self, path: Path) -> None:
        """Write the file."""
        path.write_bytes(self.records.text() if self.as_text else self.records.binary())

    def _bone(self, name: str, offset: F64) -> int:
        return self.records.add("Model", name, "LimbNode", properties(Lcl_Translation=offset.tolist()))

    def _all(self, kind: str) -> list[Part]:
        return [part for part in self.records.objects.below if part.name == kind]

    def _models(self) -> list[Part]:
        return self._all("Model")

    def _model(self, node: int) -> Part:
        return next(model for model in self._models() if model.values[0] == node)

    def _curves(self, node: int, what: str) -> dict[int, Part]:
        """Return the curves of a property of a node by axis."""
        links = [link.values for link in self.records.links.below]
        moves = {link[1] for link in links if link[0] == "OP" and link[2] == node and link[3] == what}
        curves = {part.values[0]: part for part in self._all("AnimationCurve")}
        return {_AXES.index(link[3]): curves[link[1]] for link in links if link[2] in moves and link[1] in curves}


def _first(part: Part, name: str) -> Part:
    return next(one for one in part.below if one.name == name)


def _properties(part: Part) -> Part:
    return _first(part, "Properties70")


def _property(part: Part, name: str) -> Part | None:
    return next((one for one in _properties(part).below if one.values[0] == name), None)


def _set(part: Part, name: str, values: Sequence[float]) -> None:
    given = _property(part, name)
    if given is None:
        given = Part("P", (name, "Number", "", "A"))
        _properties(part).below.append(given)
    given.values = (*given.values[:4], *values)


def _array(part: Part, name: str) -> np.ndarray[Any, Any]:
    return np.asarray(_first(part, name).values[0])


def _set_array(part: Part, name: str, values: np.ndarray[Any, Any]) -> None:
    _first(part, name).values = (values,)


def parse_fbx(path: Path) -> FbxScene:
    """Read the records of an FBX file that describe nodes and their motion."""
    top, _ = read_records(path, path.read_bytes())
    made = Builder()
    made.settings, made.objects, made.links = (
        _part(top.first(name)) for name in ("GlobalSettings", "Objects", "Connections")
    )
    made.numbers = 1 + max(one.values[0] for one in made.objects.below if isinstance(one.values[0], int))
    for one in made.objects.below:
        if not any(below.name == "Properties70" for below in one.below):
            one.below.append(Part("Properties70"))
    return FbxScene(path.name, False, made)


def _part(record: Record) -> Part:
    values: list[Any] = []
    for value in record.values:
        if isinstance(value, str) and "\0\1" in value:
            name, _, kind = value.partition("\0\1")
            values.append((kind, name))
        else:
            values.append(value)
    return Part(record.name, tuple(values), [_part(below) for below in record.records])


def fbx_of(made: BvhText, unit_m: float, rate_hz: float, as_text: bool, bound: bool) -> FbxScene:
    """Return the skeleton and motion of a BVH file as an FBX file; the parameters are as in `gltf_of`."""
    names = node_names(made)
    joints: list[Joint] = []
    motion: list[dict[str, list[float]]] = [{} for _ in made.values]
    for i, (one, name) in enumerate(zip(made.nodes, names, strict=True)):
        turning = tuple(channel for channel in one.channels if channel.lower().endswith("rotation")) or ROTATIONS
        channels = (*POSITIONS, *turning) if i == 0 else turning
        joints.append(Joint(name, one.offset, channels))
        if one.parent >= 0:
            joints[one.parent].children.append(joints[i])
        columns = dict(zip(one.channels, made.values[:, made.columns(i)].T, strict=True))
        for t, frame in enumerate(motion):
            frame[name] = [float(columns[channel][t]) if channel in columns else 0.0 for channel in channels]
    records = Builder(UnitScaleFactor=[100.0 * unit_m], TimeMode=[14], CustomFrameRate=[rate_hz])
    bones = records.bones(joints[0])
    records.clip("clip", bones, joints[0], motion, rate_hz)
    scene = FbxScene(made.name, as_text, records)
    if bound:
        worlds: dict[int, F64] = {}
        for one, name in zip(made.nodes, names, strict=True):
            world = np.eye(4)
            world[:3, 3] = one.offset
            if one.parent >= 0:
                world[:3, 3] += worlds[bones[names[one.parent]]][:3, 3]
            worlds[bones[name]] = world
        scene.bind(worlds)
    return scene
