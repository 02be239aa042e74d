"""Mutations of motion on skeletons, BVH files and AMC files with their ASF, for `studies.mutations`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from kinedex.ops.arrays import F64
from studies.wild_variants import euler_angles

FRAMES = 240
"""Most frames of a recording."""

LEAST_FRAMES = 10
"""Least frames of a recording that is kept apart."""

_FILES = ("cmu/same_take_amc_and_bvh/01_01.bvh", "wild/pybvh/bvh_test2.bvh", "wild/pybvh/bvh_test3.bvh",
          "wild/video2bvh/cxk.bvh", "wild/npybvh/example.bvh", "wild/makehuman/zombieWalk1.bvh")  # fmt: skip
"""BVH files that are read rightly, and one file of Bandai beside them."""


@dataclass(frozen=True)
class BvhNode:
    """A joint or an end site: its name (empty for an end site), parent, offset and channels."""

    name: str
    parent: int
    offset: tuple[float, float, float]
    channels: tuple[str, ...]


@dataclass(frozen=True)
class BvhText:
    """A BVH file: its nodes, parents first, the values (T, channels), and the seconds of a frame.

    Attributes
    ----------
    name : str
        The file.
    nodes : tuple of BvhNode
        The hierarchy in the order of the file.
    values : float64 array (T, C)
        The channels of all nodes.
    frame_s : float
        The time of a frame.
    """

    name: str
    nodes: tuple[BvhNode, ...]
    values: F64
    frame_s: float

    def columns(self, node: int) -> slice:
        """Return the columns of a node's channels."""
        start = sum(len(one.channels) for one in self.nodes[:node])
        return slice(start, start + len(self.nodes[node].channels))


@dataclass(frozen=True)
class SkeletonMutation:
    """A file in which one thing is changed: the mutation, what it changed, and whether the file alone can show it."""

    name: str
    what: str
    file: BvhText
    knowable: bool = True


def parse(path: Path) -> BvhText:
    """Read a BVH file, cut to `FRAMES` frames."""
    head, _, motion = path.read_text(encoding="latin-1").partition("MOTION")
    nodes: list[BvhNode] = []
    above: list[int] = []
    words = head.split()
    i = 0
    while i < len(words):
        word = words[i].upper()
        if word in ("ROOT", "JOINT", "END"):
            name = "" if word == "END" else words[i + 1]
            nodes.append(BvhNode(name, above[-1] if above else -1, (0.0, 0.0, 0.0), ()))
            i += 1
        elif word == "{":
            above.append(len(nodes) - 1)
        elif word == "}":
            above.pop()
        elif word == "OFFSET":
            x, y, z = (float(part) for part in words[i + 1 : i + 4])
            nodes[-1] = replace(nodes[-1], offset=(x, y, z))
        elif word == "CHANNELS":
            nodes[-1] = replace(nodes[-1], channels=tuple(words[i + 2 : i + 2 + int(words[i + 1])]))
        i += 1
    lines = [line for line in motion.splitlines() if line.strip()]
    frame_s = float(lines[1].split(":")[1])
    step = max(1, (len(lines) - 2) // FRAMES)
    values = np.array([[float(part) for part in line.split()] for line in lines[2::step]])
    return BvhText(path.name, tuple(nodes), values, frame_s * step)


def about(axis: int, angle: F64) -> F64:
    """Return rotation matrices (T, 3, 3) about an axis by angles in radians."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    turn = np.repeat(np.eye(3)[None], len(angle), axis=0)
    turn[:, i, i] = turn[:, j, j] = np.cos(angle)
    turn[:, j, i] = np.sin(angle)
    turn[:, i, j] = -turn[:, j, i]
    return turn


def local_motion(made: BvhText, node: int) -> tuple[F64, F64 | None]:
    """Return the rotations (T, 3, 3) of a node of a BVH file, and its positions (T, 3) if it has channels for them."""
    one, values = made.nodes[node], made.values[:, made.columns(node)]
    turns = np.broadcast_to(np.eye(3), (len(values), 3, 3))
    places: F64 | None = None
    for name, column in zip(one.channels, values.T, strict=True):
        axis = "xyz".index(name[0].lower())
        if name.lower().endswith("rotation"):
            turns = turns @ about(axis, np.deg2rad(column))
        else:
            places = np.tile(one.offset, (len(values), 1)) if places is None else places
            places[:, axis] = column
    return turns, places


def node_names(made: BvhText) -> list[str]:
    """Return the names of the nodes of a BVH file, all different; End Sites are `Head_end`, `Head_end2`, and so on."""
    found: list[str] = []
    for one in made.nodes:
        name = one.name or f"{made.nodes[one.parent].name}_end"
        again = [name, *(f"{name}{i}" for i in range(2, len(made.nodes) + 2))]
        found.append(next(other for other in again if other not in found))
    return found


def write(path: Path, made: BvhText) -> None:
    """Write a BVH file."""
    lines = ["HIERARCHY"]

    def describe(node: int, depth: int) -> None:
        one, pad = made.nodes[node], "\t" * depth
        kind = "ROOT" if one.parent < 0 else "JOINT" if one.name else "End Site"
        lines.extend([f"{pad}{kind} {one.name}".rstrip(), f"{pad}{{"])
        lines.append(f"{pad}\tOFFSET {' '.join(f'{x:.6f}' for x in one.offset)}")
        if one.name:
            lines.append(f"{pad}\tCHANNELS {len(one.channels)} {' '.join(one.channels)}".rstrip())
        for child, other in enumerate(made.nodes):
            if other.parent == node:
                describe(child, depth + 1)
        lines.append(f"{pad}}}")

    describe(0, 0)
    lines += ["MOTION", f"Frames: {len(made.values)}", f"Frame Time: {made.frame_s:.7f}"]
    lines += [" ".join(f"{x:.6f}" for x in row) for row in made.values]
    path.write_text("\n".join(lines) + "\n", encoding="latin-1")


def bvh_files(data: Path, apart: bool = False) -> list[BvhText]:
    """Read files of a folder of real data that are there: those named here, or all others but for most of Bandai's."""
    named, bandai = [data / name for name in _FILES], sorted((data / "bandai").rglob("*.bvh"))
    if apart:
        others = {*data.rglob("*.bvh")} - {*named, *bandai}
        parsed = {path.name: parse(path) for path in [*sorted(others), *bandai[-1:]]}
        return [file for file in parsed.values() if len(file.values) >= LEAST_FRAMES]
    return [parse(path) for path in [*named, *bandai[:1]] if path.is_file()]


def _with(made: BvhText, node: int, **changes: object) -> BvhText:
    nodes = list(made.nodes)
    nodes[node] = replace(nodes[node], **changes)  # type: ignore[arg-type]
    return replace(made, nodes=tuple(nodes))


def _scaled(made: BvhText, offsets: float, root: float) -> BvhText:
    """Return a file whose offsets and whose positions are scaled."""
    nodes = tuple(replace(one, offset=tuple(offsets * x for x in one.offset)) for one in made.nodes)  # type: ignore[arg-type]
    values = made.values.copy()
    names = [name for one in made.nodes for name in one.channels]
    values[:, [i for i, name in enumerate(names) if name.lower().endswith("position")]] *= root
    return replace(made, nodes=nodes, values=values)


def _inserted(made: BvhText, node: int) -> BvhText:
    """Return a file with a twist joint between a node and its parent: half of the offset each, and no rotation."""
    one = made.nodes[node]
    half = tuple(x / 2 for x in one.offset)
    moved = [replace(other, parent=other.parent + (other.parent >= node)) for other in made.nodes]
    twist = replace(one, name=f"{one.name}Twist", offset=half)
    child = replace(moved[node], parent=node, offset=half)
    nodes = (*moved[:node], twist, child, *moved[node + 1 :])
    at = made.columns(node)
    still = np.zeros((len(made.values), len(one.channels)))
    return replace(made, nodes=nodes, values=np.insert(made.values, [at.start], still, axis=1))


def _reordered(made: BvhText) -> BvhText:
    """Return a file whose rotations have the order Y, X, Z."""
    nodes, values = list(made.nodes), made.values.copy()
    for i, one in enumerate(made.nodes):
        turning = [name for name in one.channels if name.lower().endswith("rotation")]
        if len(turning) != 3:
            continue
        columns = [made.columns(i).start + one.channels.index(name) for name in turning]
        turn = np.broadcast_to(np.eye(3), (len(values), 3, 3))
        for name, column in zip(turning, columns, strict=True):
            turn = turn @ about("xyz".index(name[0].lower()), np.deg2rad(made.values[:, column]))
        values[:, columns] = np.rad2deg(np.stack(euler_angles(turn, (1, 0, 2)), axis=1))
        order = iter(("Yrotation", "Xrotation", "Zrotation"))
        channels = tuple(next(order) if name in turning else name for name in one.channels)
        nodes[i] = replace(one, channels=channels)
    return replace(made, nodes=tuple(nodes), values=values)


def bvh_mutations(made: BvhText) -> Iterator[SkeletonMutation]:
    """Yield mutations of a BVH file, each of them a whole file."""
    joints = [i for i, one in enumerate(made.nodes) if one.name and one.parent >= 0]
    names, parents = ({i: getattr(one, key) for i, one in enumerate(made.nodes)} for key in ("name", "parent"))
    for i in joints:
        name = made.nodes[i].name
        yield SkeletonMutation("joint renamed", name, _with(made, i, name=f"xq{i}z"))
        if any(made.nodes[i].offset):
            empty = _with(made, i, offset=(0.0, 0.0, 0.0))
            yield SkeletonMutation("bone of no length", name, empty, knowable=not is_at_root(i, names, parents))
        yield SkeletonMutation("added twist joint", name, _inserted(made, i))
    by_name = {one.name: i for i, one in enumerate(made.nodes)}
    for name, i in by_name.items():
        other = by_name.get(other_side(name)) if other_side(name) else None
        if other is not None:
            twin = made.nodes[other].name
            yield SkeletonMutation("left and right exchanged", name, _with(_with(made, i, name=twin), other, name=name))
    yield SkeletonMutation("other order of channels", "", _reordered(made))
    for factor in (0.01, 0.0254, 100.0):
        yield SkeletonMutation("root in another unit than offsets", f"{factor:g}", _scaled(made, 1.0, factor))
        yield SkeletonMutation("other unit", f"{factor:g}", _scaled(made, factor, factor))
    for factor in (2.0, 4.0, 0.5):
        lying = replace(made, frame_s=made.frame_s / factor)
        yield SkeletonMutation("rate lying", f"{factor:g}", lying, knowable=False)
    shifted = made.values.copy()
    shifted[:, 0] += 100.0 * np.abs(np.array([one.offset for one in made.nodes])).sum()
    yield SkeletonMutation("origin far away", "", replace(made, values=shifted))


def is_at_root(node: int, names: Mapping[int, str], parents: Mapping[int, int]) -> bool:
    """Return whether only both legs hang from a joint below the root, which may as well lie at the root."""
    above = parents[node]
    below = [names[other] for other in names if parents.get(other) == node]
    beside = [other for other in names if parents.get(other) == above and other != node]
    return (
        parents.get(above, -1) not in names
        and len(below) == 2
        and other_side(below[0]) == below[1]
        and len(beside) == 1
    )


def other_side(name: str) -> str:
    """Return the name of the joint of the other side; an empty text if a name has no side."""
    for left, right in (("Left", "Right"), ("left", "right"), ("L_", "R_"), ("_L", "_R"), ("_l", "_r")):
        if left in name:
            return name.replace(left, right)
    return ""
