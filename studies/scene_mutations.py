"""Mutations of animated scenes, glTF and FBX files, for `studies.mutations`."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol, TypeVar

import numpy as np

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.units import body_height
from kinedex.ops.arrays import F64
from kinedex.storage.formats.motion.gltf_writer import write_gltf
from kinedex.storage.formats.motion.joint_motion import JointMotion
from kinedex.storage.formats.motion.reader import Body
from studies.fbx_scenes import FbxScene, fbx_of, parse_fbx
from studies.gltf_scenes import GltfScene, gltf_of, parse_glb
from studies.skeleton_mutations import BvhText, is_at_root, other_side, write

FRAMES, RATE_HZ = 120, 30.0
"""Frames of a clip, and their rate."""

_FBX = "wild/bvh-toolbox/template.fbx"
_Z_UP = {"UpAxis": [2], "UpAxisSign": [1], "FrontAxis": [1], "FrontAxisSign": [-1]}


class SceneFile(Protocol):
    """A file of bones, each with a number, whose content is changed in place."""

    name: str

    @property
    def form(self) -> str:
        """The format."""
        ...

    @property
    def ending(self) -> str:
        """The ending of its name."""
        ...

    @property
    def names(self) -> dict[int, str]:
        """A dict from bone to name, parents first."""
        ...

    @property
    def parents(self) -> dict[int, int]:
        """A dict from node to parent."""
        ...

    @property
    def bound(self) -> dict[int, F64]:
        """A dict from bone to its matrix in the pose of binding."""
        ...

    def offset(self, node: int) -> F64:
        """Return the place of a node relative to its parent."""
        ...

    def rename(self, node: int, name: str) -> None:
        """Give a node another name."""
        ...

    def move(self, node: int, change: Callable[[F64], F64]) -> None:
        """Change a node's places relative to its parent."""
        ...

    def divide(self, node: int, name: str) -> None:
        """Insert a node halfway between a node and its parent."""
        ...

    def add_end(self, node: int, name: str, offset: F64) -> None:
        """Add a node below another."""
        ...

    def hang(self, degrees: float, scale: float) -> None:
        """Hang the scene from a node that is turned about X and scaled."""
        ...

    def pace(self, factor: float) -> None:
        """Let the clips run so many times as fast."""
        ...

    def shuffle(self, random: np.random.Generator) -> None:
        """List the nodes in another order."""
        ...

    def bind(self, worlds: dict[int, F64]) -> None:
        """Replace the pose of binding."""
        ...

    def write(self, path: Path) -> None:
        """Write the file."""
        ...


AnyScene = TypeVar("AnyScene", GltfScene, FbxScene)


@dataclass(frozen=True)
class SceneMutation:
    """A scene in which one thing is changed.

    Attributes
    ----------
    name, what : str
        The mutation, and what it changed.
    file : SceneFile
        The changed file.
    knowable : bool
        False if the file alone cannot show the change.
    size : float
        The size of the body that is right, as a multiple of the unchanged one.
    """

    name: str
    what: str
    file: SceneFile
    knowable: bool = True
    size: float = 1.0


def gltf_files(bvh: list[BvhText], read: Callable[[Path], Body]) -> list[GltfScene]:
    """Return BVH files as glTF files of several forms, and the first as `kinedex export` writes it."""
    made, joints = [], None
    for i, file in enumerate(bvh):
        body = _body(file, read)
        joints = body if joints is None else joints
        made.append(gltf_of(_cut(file), _unit_m(body), RATE_HZ, (".glb", ".gltf")[i % 2], bound=i % 3 < 2))
    return made if joints is None else [*made, _exported(bvh[0].name, joints)]


def fbx_files(data: Path, bvh: list[BvhText], read: Callable[[Path], Body], apart: bool = False) -> list[FbxScene]:
    """Return BVH files as binary files and text, and a file of real data if it is there and not kept apart."""
    made = [
        fbx_of(_cut(file), _unit_m(_body(file, read)), RATE_HZ, as_text=i % 3 == 2, bound=i % 2 == 0)
        for i, file in enumerate(bvh)
    ]
    return [*made, parse_fbx(data / _FBX)] if (data / _FBX).is_file() and not apart else made


def _cut(file: BvhText) -> BvhText:
    return replace(file, values=file.values[:FRAMES])


def _body(file: BvhText, read: Callable[[Path], Body]) -> Body:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / file.name
        write(path, file)
        return read(path)


def _unit_m(body: Body) -> float:
    return float(body.unit.split()[0])


def _exported(name: str, body: Body) -> GltfScene:
    """Return a body as `kinedex export --format glb` writes it."""
    joints = load_feature_set().joints
    known = [i for i, joint in enumerate(joints) if joint not in body.unknown]
    positions = body.positions[known].transpose(2, 0, 1)[:FRAMES].astype(np.float32)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "take.glb"
        motion = JointMotion(name, tuple(joints[i] for i in known), positions, RATE_HZ)
        write_gltf(path, motion)
        return replace(parse_glb(path), name=f"{name} exported")


def scene_mutations(
    made: AnyScene, control: Body, joints: tuple[str, ...], random: np.random.Generator
) -> Iterator[SceneMutation]:
    """Yield mutations of a scene, each of them a whole file; `control` is what is read of the unchanged one."""
    yield from _skeletons(made)
    yield from _scenes(made, control, joints, random)
    if isinstance(made, FbxScene):
        yield from _headers(made)


def _skeletons(made: AnyScene) -> Iterator[SceneMutation]:
    names, parents = made.names, made.parents
    above = set(parents.values())
    for i, (node, name) in enumerate(names.items()):
        if node not in parents or parents[node] not in names:
            continue
        other = made.copied()
        other.rename(node, f"xq{i}z")
        yield SceneMutation("joint renamed", name, other)
        alone = parents[node] not in parents and list(parents.values()).count(parents[node]) == 1
        if np.abs(made.offset(node)).max() > 0 and not alone:
            usual = is_at_root(node, names, parents) or _begins_spine(node, names, parents) or _is_lone_end(made, node)
            yield SceneMutation("bone of no length", name, _emptied(made, node), knowable=not usual)
        other = made.copied()
        other.divide(node, f"{name}Twist")
        yield SceneMutation("added twist joint", name, other)
        if any(parents.get(child) == node for child in above):  # the last bone of a limb ends where its end is
            other = made.copied()
            other.add_end(node, f"{name}_tip", 0.4 * made.offset(node))
            yield SceneMutation("added end joint", name, other)
    by_name = {name: node for node, name in names.items()}
    for name, node in by_name.items():
        twin = other_side(name)
        if twin in by_name:
            other = made.copied()
            other.rename(node, twin)
            other.rename(by_name[twin], name)
            yield SceneMutation("left and right exchanged", name, other)


def _begins_spine(node: int, names: dict[int, str], parents: dict[int, int]) -> bool:
    """Return whether a node is the first joint of a spine, which lies at the hips in many skeletons."""
    return "spine" in names[node].lower() and parents.get(parents[node]) not in names


def _is_lone_end(made: AnyScene, node: int) -> bool:
    """Return whether a node is an end of a bone, in a file in which no other end has a length."""
    above = set(made.parents.values())
    lengths = {one: float(np.abs(made.offset(one)).max()) for one in made.names if one not in above}
    return node in lengths and max(lengths.values()) > 20.0 * sorted(lengths.values())[-2]


def _emptied(made: AnyScene, node: int) -> AnyScene:
    """Return a scene in which a bone has no length, in the pose of binding as well."""
    other = made.copied()
    other.move(node, np.zeros_like)
    worlds, above = other.bound, other.parents[node]
    if node in worlds and above in worlds:
        way = worlds[above][:3, 3] - worlds[node][:3, 3]
        below = {node}
        for one in other.names:
            if one == node or other.parents.get(one) in below:
                below.add(one)
                if one in worlds:
                    worlds[one][:3, 3] += way
        other.bind(worlds)
    return other


def _scaled(made: AnyScene, offsets: float, root: float) -> AnyScene:
    """Return a scene whose bones, and whose roots' places, are scaled."""
    other = made.copied()
    names, parents = other.names, other.parents
    for node in names:
        factor = offsets if parents.get(node) in names else root
        if factor != 1.0:
            other.move(node, lambda place, by=factor: by * place)
    worlds = other.bound
    for world in worlds.values():
        world[:3, 3] *= offsets
    if offsets != 1.0:
        other.bind(worlds)
    return other


def _scenes(
    made: AnyScene, control: Body, joints: tuple[str, ...], random: np.random.Generator
) -> Iterator[SceneMutation]:
    other = made.copied()
    other.shuffle(random)
    yield SceneMutation("other order of nodes", "", other)
    for factor in (0.01, 0.0254, 100.0):
        yield SceneMutation("root in another unit than offsets", f"{factor:g}", _scaled(made, 1.0, factor))
        yield SceneMutation("other unit", f"{factor:g}", _scaled(made, factor, factor))
    for factor in (0.45, 2.2):
        yield SceneMutation("scene scaled", f"{factor:g}", _scaled(made, factor, factor))
    height = body_height(control.positions, joints)
    for size in (1.05, 2.05) if height is not None else ():
        factor = size / height
        whole = _scaled(made, factor, factor)
        yield SceneMutation("child's or tall body", f"{size:g} m", whole, size=factor)
    for scale in (0.01, 100.0):
        other = _scaled(made, 1.0 / scale, 1.0 / scale)
        other.hang(0.0, scale)
        yield SceneMutation("scene hung from a scaled node", f"{scale:g}", other)
    other = made.copied()
    other.hang(90.0, 1.0)
    yield SceneMutation("axis up, lying", "z", other)
    for factor in (2.0, 4.0, 0.5):
        other = made.copied()
        other.pace(factor)
        yield SceneMutation("rate lying", f"{factor:g}", other, knowable=False)
    unit_m = 0.01 * made.stated("UnitScaleFactor") if isinstance(made, FbxScene) else 1.0
    for axis in range(3):
        other, shift = made.copied(), 100.0 / unit_m * np.eye(3)[axis]
        names, parents = other.names, other.parents
        for node in (one for one in names if parents.get(one) not in names):
            other.move(node, lambda place, by=shift: place + by)
        yield SceneMutation("origin 100 m away", "xyz"[axis], other)


def _headers(made: FbxScene) -> Iterator[SceneMutation]:
    """Yield what only headers and channels of FBX files have."""
    other = made.copied()
    other.reorder()
    yield SceneMutation("other order of channels", "", other)
    other = made.copied()
    other.hang(90.0, 1.0)
    other.state(**_Z_UP)
    yield SceneMutation("axis up, stated", "z", other)
    other = made.copied()
    other.state(**_Z_UP)
    yield SceneMutation("axis up, lying", "y", other)
    own = made.stated("UnitScaleFactor")
    for unit, stated in {"mm": 0.1, "cm": 1.0, "in": 2.54, "dm": 10.0, "ft": 30.48, "m": 100.0}.items():
        other = _scaled(made, own / stated, own / stated)
        other.state(UnitScaleFactor=[stated])
        yield SceneMutation("unit right", unit, other)
        other = other.copied()
        other.state(UnitScaleFactor=None)
        yield SceneMutation("unit absent", unit, other)
        for lie, claimed in {"mm": 0.1, "cm": 1.0, "m": 100.0}.items():
            if lie != unit:
                other = other.copied()
                other.state(UnitScaleFactor=[claimed])
                yield SceneMutation("unit lying", f"{unit} as {lie}", other)
