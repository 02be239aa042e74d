"""Synthetic motion on the skeletons of others: BVH files in their dialects, with the true place of every named joint.

A skeleton is given by names, parents and offsets (`wild_skeletons.json`). Its rest pose, names, channels and tree stay;
its bones get the lengths of a synthetic actor, and its turns follow the actor's motion. The joints that its nodes stand
for are read from `wild_roles.yaml`, which a person wrote; recognition knows nothing of it.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml

F64 = npt.NDArray[np.float64]

ROLES = Path(__file__).with_name("wild_roles.yaml")
UNITS_M = (1.0, 0.01, 0.0254, 0.001, 0.0254 / 0.45)
BALL_OF_FOOT = 0.68  # of the way from the ankle to the tip of the toes
CLAVICLE = 0.15  # of the way from the neck to the shoulder
_LIMBS = (("root", "hip", "knee", "ankle", "toes"), ("clavicle", "shoulder", "elbow", "wrist", "fingers"))
_SPINE = ("root", "belly", "chest", "neck")


@dataclass(frozen=True)
class Skeleton:
    """The skeleton of a file.

    Attributes
    ----------
    label : str
        Source and file.
    names : tuple of str
        Of N nodes, parents first.
    parents : tuple of int
        −1 for the root.
    offsets : float64 array (N, 3)
        In the file's unit.
    channels : tuple of tuple of str
        Of every node; empty for end sites.
    """

    label: str
    names: tuple[str, ...]
    parents: tuple[int, ...]
    offsets: F64
    channels: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Actor:
    """The motion of an actor.

    Attributes
    ----------
    joints : dict of str to float64 array (3, T)
        Named joints in metres, Y up.
    orientation : float64 array (4, T)
        The root's quaternion.
    rate_hz : float
        Frames per second.
    """

    joints: dict[str, F64]
    orientation: F64
    rate_hz: float


@dataclass(frozen=True)
class Variant:
    """A BVH text in the dialect of a skeleton, and the truth.

    Attributes
    ----------
    truth : dict of str to float64 array (3, T)
        Named joints in metres, Y up.
    own : frozenset of str
        The joints for which the skeleton has a node of its own, or a place in its spine.
    unknown : frozenset of str
        The joints that a part of a body lacks.
    """

    text: str
    truth: dict[str, F64]
    own: frozenset[str]
    unknown: frozenset[str]


def load_skeletons(path: Path) -> list[Skeleton]:
    """Read the BVH skeletons of `wild_skeletons.json`."""
    found = []
    for entry in json.loads(path.read_text(encoding="utf-8"))["bvh"]:
        joints = entry["joints"]
        index: dict[str, int] = {}
        parents = []
        for i, joint in enumerate(joints):
            parents.append(-1 if joint["parent"] is None else index[joint["parent"]])
            index[joint["name"]] = i
        found.append(
            Skeleton(
                f"{entry['source']}/{entry['file']}",
                tuple(joint["name"] for joint in joints),
                tuple(parents),
                np.array([joint["offset"] for joint in joints], dtype=np.float64),
                tuple(tuple(joint.get("channels", ())) for joint in joints),
            )
        )
    return found


def roles_of(skeleton: Skeleton) -> tuple[str, dict[str, int]] | None:
    """Return the family of a skeleton and the node of every named joint that has one; None for no human.

    Raises
    ------
    ValueError
        The file of roles knows no family that fits.
    """
    known: dict[str, Any] = yaml.safe_load(ROLES.read_text(encoding="utf-8"))
    if {skeleton.label, f"{skeleton.label}/{len(skeleton.names)}"} & set(known["no_human"]):
        return None
    for family, entry in known["families"].items():
        short = {
            re.sub(f"^{entry['strip']}", "", skeleton.names[i]).lower(): i for i in reversed(range(len(skeleton.names)))
        }
        needed = _nodes(entry["roles"], entry["sides"], short)
        if None not in needed.values():
            others = _nodes(entry["optional"], entry["sides"], short)
            return family, {joint: node for joint, node in (needed | others).items() if node is not None}
    raise ValueError(f"{skeleton.label}: no family of {ROLES.name} fits")


def _nodes(roles: dict[str, Any], sides: Sequence[str], short: dict[str, int]) -> dict[str, int | None]:
    found: dict[str, int | None] = {}
    for role, names in roles.items():
        names = names if isinstance(names, list) else [names]
        for letter, side in zip("lr", sides, strict=True) if "{S}" in names[0] else [("", "")]:
            whole = [name.replace("{S}", side).lower() for name in names]
            found[letter + role] = next((short[name] for name in whole if name in short), None)
    return found


def variant(skeleton: Skeleton, nodes: dict[str, int], actor: Actor, turn: F64) -> Variant:
    """Move a skeleton like an actor.

    Parameters
    ----------
    skeleton : Skeleton
        The skeleton.
    nodes : dict of str to int
        Named joint → node.
    actor : Actor
        The motion.
    turn : float64 array (3, 3)
        Turns the whole file, rest pose and motion: the identity, or a rotation to another vertical axis.

    Returns
    -------
    Variant
        Its truth is not turned.
    """
    nodes = dict(nodes)
    unknown = frozenset(_lacking(nodes))
    for side in "lr":
        _take_end(skeleton, nodes, f"{side}ankle", f"{side}toes")
        _take_end(skeleton, nodes, f"{side}wrist", f"{side}fingers")
    _take_end(skeleton, nodes, "head", "headtop")
    wanted = _targets(skeleton, nodes, actor)
    positions, rotations, offsets = _moved(skeleton, wanted, actor)
    truth, own = _truth(skeleton, nodes, positions, actor)
    unit_m = _unit(skeleton, offsets)
    text = _text(
        skeleton, offsets @ turn.T / unit_m, turn @ positions[0] / unit_m, turn @ rotations @ turn.T, actor.rate_hz
    )
    return Variant(text, truth, own, unknown)


def sliding(skeleton: Skeleton) -> str:
    """Return the BVH text of a skeleton that slides ahead in its rest pose for two seconds, for bodies of no human."""
    frames = 60
    rotations = np.broadcast_to(np.eye(3), (len(skeleton.names), frames, 3, 3))
    root = np.zeros((3, frames))
    root[2] = np.linspace(0.0, float(np.abs(skeleton.offsets).max()), frames)
    return _text(skeleton, skeleton.offsets, root, rotations, 30.0)


def _lacking(nodes: dict[str, int]) -> set[str]:
    legs = {f"{side}{role}" for side in "lr" for role in ("hip", "knee", "ankle", "toes")}
    arms = {f"{side}{role}" for side in "lr" for role in ("clavicle", "shoulder", "elbow", "wrist", "fingers")}
    lacking: set[str] = set()
    if "lhip" not in nodes:
        lacking |= legs
    if "lshoulder" not in nodes:
        lacking |= arms | {"belly", "chest", "neck", "head", "headtop"}
    elif "head" not in nodes:
        lacking |= {"headtop"}
    return lacking


def _children(skeleton: Skeleton, node: int) -> list[int]:
    return [i for i, parent in enumerate(skeleton.parents) if parent == node]


def _take_end(skeleton: Skeleton, nodes: dict[str, int], parent: str, joint: str) -> None:
    """Take the only child of a joint for another joint, if it is an end that is somewhere else."""
    at = nodes.get(joint, nodes.get(parent)) if joint.endswith("toes") else nodes.get(parent)
    if at is None or (joint in nodes and not joint.endswith("toes")):
        return
    ends = [i for i in _children(skeleton, at) if not skeleton.channels[i] and np.any(skeleton.offsets[i])]
    if len(ends) == 1 and len(_children(skeleton, at)) == 1:
        if joint in nodes:
            nodes[f"{joint[0]}ball"] = nodes[joint]
        nodes[joint] = ends[0]
    elif joint in nodes and joint.endswith("toes"):
        nodes[f"{joint[0]}ball"] = nodes.pop(joint)


def _targets(skeleton: Skeleton, nodes: dict[str, int], actor: Actor) -> dict[int, F64]:
    """Return where nodes shall be: joints at the actor's, nodes between them along the way."""
    joints = dict(actor.joints)
    for side in "lr":
        joints[f"{side}ball"] = joints[f"{side}ankle"] + BALL_OF_FOOT * (joints[f"{side}toes"] - joints[f"{side}ankle"])
        joints[f"{side}clavicle"] = joints["neck"] + CLAVICLE * (joints[f"{side}shoulder"] - joints["neck"])
    found = {node: joints[joint] for joint, node in nodes.items()}
    for side in "lr":
        for limb in _LIMBS:
            chain = ["root" if role == "root" else side + role for role in limb]
            chain = [joint for joint in [*chain[:4], f"{side}ball", *chain[4:]] if joint in nodes]
            for a, b in pairwise(chain):
                _between(skeleton, nodes[a], nodes[b], [joints[a], joints[b]], found)
    spine = [joints[joint] for joint in _SPINE]
    if "neck" in nodes:
        _between(skeleton, nodes["root"], nodes["neck"], spine, found)
        if "head" in nodes:
            _between(skeleton, nodes["neck"], nodes["head"], [joints["neck"], joints["head"]], found)
    elif "head" in nodes:
        _between(skeleton, nodes["root"], nodes["head"], [*spine, joints["head"]], found)
    return found


def path_between(skeleton: Skeleton, above: int, below: int) -> list[int]:
    """Return the nodes from one to another below it, both included; empty if it is not below."""
    path = [below]
    while path[-1] != above and skeleton.parents[path[-1]] >= 0:
        path.append(skeleton.parents[path[-1]])
    return path[::-1] if path[-1] == above else []


def _between(skeleton: Skeleton, above: int, below: int, line: list[F64], found: dict[int, F64]) -> None:
    path = path_between(skeleton, above, below)
    lengths = np.linalg.norm(skeleton.offsets[path[1:]], axis=1)
    far = np.concatenate([[0.0], np.cumsum(lengths)])
    if len(path) > 2:
        for node, share in zip(path[1:-1], far[1:-1] / max(far[-1], 1e-12), strict=True):
            found[node] = along(line, float(share))


def along(line: Sequence[F64], share: float) -> F64:
    """Return the point (3, T) at a fraction of the mean length of a polyline of points (3, T)."""
    lengths = [float(np.linalg.norm(b - a, axis=0).mean()) for a, b in pairwise(line)]
    left = share * sum(lengths)
    for a, b, length in zip(line, line[1:], lengths, strict=False):
        if left <= length:
            return a + (left / max(length, 1e-12)) * (b - a)
        left -= length
    return line[-1]


def _moved(skeleton: Skeleton, wanted: dict[int, F64], actor: Actor) -> tuple[F64, F64, F64]:
    """Return places (N, 3, T) and turns (N, T, 3, 3) of all nodes, and the offsets (N, 3) in metres."""
    frames = actor.orientation.shape[1]
    count = len(skeleton.names)
    scale = _scale(skeleton, wanted)
    offsets, rotations, positions = np.zeros((count, 3)), np.zeros((count, frames, 3, 3)), np.zeros((count, 3, frames))
    for node, parent in enumerate(skeleton.parents):
        if parent < 0:
            positions[node] = wanted.get(node, next(iter(wanted.values())))
        else:
            offset = skeleton.offsets[node] * scale
            if node in wanted and parent in wanted and np.any(offset):
                length = float(np.linalg.norm(wanted[node] - wanted[parent], axis=0).mean())
                offset = offset / np.linalg.norm(offset) * length
            offsets[node] = offset
            positions[node] = positions[parent] + np.einsum("tab,b->at", rotations[parent], offset)
        above = rotations[parent] if parent >= 0 else np.broadcast_to(np.eye(3), (frames, 3, 3))
        arms = [i for i in _children(skeleton, node) if i in wanted and node in wanted and np.any(skeleton.offsets[i])]
        rotations[node] = _turn([skeleton.offsets[i] for i in arms], [wanted[i] - wanted[node] for i in arms], above)
    return positions, rotations, offsets


def _scale(skeleton: Skeleton, wanted: dict[int, F64]) -> float:
    """Return the ratio of the actor's bones to the skeleton's."""
    ours = theirs = 0.0
    for node, parent in enumerate(skeleton.parents):
        if node in wanted and parent in wanted:
            ours += float(np.linalg.norm(wanted[node] - wanted[parent], axis=0).mean())
            theirs += float(np.linalg.norm(skeleton.offsets[node]))
    return ours / theirs


def _turn(rest: list[F64], now: list[F64], above: F64) -> F64:
    """Return rotations (T, 3, 3) that take directions at rest to those of now: the nearest to the parent's."""
    if not rest:
        return above
    unit = [arm / np.linalg.norm(arm) for arm in rest]
    aim = [arm / np.maximum(np.linalg.norm(arm, axis=0), 1e-12) for arm in now]
    if len(rest) > 1 and np.linalg.matrix_rank(np.stack(unit), tol=0.1) > 1:
        cross = sum(np.einsum("at,b->tab", a, u) for a, u in zip(aim, unit, strict=True))
        u, _, vt = np.linalg.svd(cross)
        flip = np.ones((len(u), 3))
        flip[:, 2] = np.sign(np.linalg.det(u) * np.linalg.det(vt))
        best: F64 = np.einsum("tab,tb,tbc->tac", u, flip, vt)
        return best
    start = np.einsum("tab,b->at", above, unit[0])
    return _shortest(start, aim[0]) @ above


def _shortest(a: F64, b: F64) -> F64:
    """Return the smallest rotations (T, 3, 3) from unit vectors a to unit vectors b, both (3, T)."""
    axis, cosine = np.cross(a, b, axis=0), (a * b).sum(axis=0)
    skew = np.zeros((a.shape[1], 3, 3))
    for (i, j), k in {(0, 1): 2, (1, 2): 0, (2, 0): 1}.items():
        skew[:, i, j], skew[:, j, i] = -axis[k], axis[k]
    return np.eye(3) + skew + (skew @ skew) / np.maximum(1.0 + cosine, 1e-6)[:, None, None]


def _truth(
    skeleton: Skeleton, nodes: dict[str, int], positions: F64, actor: Actor
) -> tuple[dict[str, F64], frozenset[str]]:
    """Return the true joints, and those with a node: others keep the actor's place beside their neighbour."""
    truth = {joint: positions[node] for joint, node in nodes.items() if not joint.endswith(("ball", "clavicle"))}
    own = set(truth)
    line = [actor.joints[joint] for joint in (*_SPINE, "head")]
    lengths = [float(np.linalg.norm(b - a, axis=0).mean()) for a, b in pairwise(line)]
    end = "neck" if "neck" in nodes else "head" if "head" in nodes else None
    if end is not None:
        path = path_between(skeleton, nodes["root"], nodes[end])
        whole = sum(lengths[:3]) if end == "neck" else sum(lengths)
        for joint, far in zip(("belly", "chest", "neck"), np.cumsum(lengths[:3]), strict=True):
            if path and joint not in truth:
                truth[joint] = along([positions[node] for node in path], float(far) / whole)
                own.add(joint)
    beside = {"neck": "root", "belly": "root", "chest": "root", "head": "neck", "headtop": "head"}
    for side in "lr":
        beside |= {f"{side}clavicle": "neck", f"{side}hip": "root", f"{side}shoulder": "neck"}
        for chain in (("hip", "knee", "ankle", "toes"), ("shoulder", "elbow", "wrist", "fingers")):
            beside |= {f"{side}{b}": f"{side}{a}" for a, b in pairwise(chain)}
    for joint, neighbour in beside.items():
        if joint not in truth:
            truth[joint] = truth[neighbour] + actor.joints[joint] - actor.joints[neighbour]
    return truth, frozenset(own)


def _unit(skeleton: Skeleton, offsets: F64) -> float:
    """Return the usual unit, in metres, that leaves the skeleton's numbers nearest to what they were."""
    theirs, ours = np.abs(skeleton.offsets[1:]).sum(), np.abs(offsets[1:]).sum()
    return min(UNITS_M, key=lambda unit: abs(np.log(ours / unit / theirs)))


def _text(skeleton: Skeleton, offsets: F64, root: F64, rotations: F64, rate_hz: float) -> str:
    lines = ["HIERARCHY"]
    columns: list[F64] = []
    frames = root.shape[1]

    def describe(node: int, depth: int) -> None:
        pad, parent = "\t" * depth, skeleton.parents[node]
        numbers = " ".join(f"{x:.6f}" for x in offsets[node])
        if not skeleton.channels[node] and not _children(skeleton, node):
            lines.extend([f"{pad}End Site", f"{pad}{{", f"{pad}\tOFFSET {numbers}", f"{pad}}}"])
            return
        lines.extend([f"{pad}{'ROOT' if parent < 0 else 'JOINT'} {skeleton.names[node]}", f"{pad}{{"])
        lines.append(f"{pad}\tOFFSET {numbers}")
        names = skeleton.channels[node]
        lines.append(f"{pad}\tCHANNELS {len(names)} {' '.join(names)}".rstrip())
        above = rotations[parent] if parent >= 0 else np.broadcast_to(np.eye(3), (frames, 3, 3))
        place = root if parent < 0 else np.repeat(offsets[node][:, None], frames, axis=1)
        columns.extend(_channels(names, place, np.swapaxes(above, 1, 2) @ rotations[node]))
        for child in _children(skeleton, node):
            describe(child, depth + 1)
        lines.append(f"{pad}}}")

    describe(0, 0)
    lines += ["MOTION", f"Frames: {frames}", f"Frame Time: {1.0 / rate_hz:.7f}"]
    lines += [" ".join(f"{x:.5f}" for x in row) for row in np.stack(columns, axis=1)]
    return "\n".join(lines) + "\n"


def _channels(names: Sequence[str], place: F64, turn: F64) -> list[F64]:
    """Return a column for every channel; the turn is the product of the rotations in the order of their channels."""
    order = ["xyz".index(name[0].lower()) for name in names if name.lower().endswith("rotation")]
    angles = dict(zip(order, euler_angles(turn, order), strict=True)) if len(order) == 3 else {}
    found = []
    for name in names:
        axis = "xyz".index(name[0].lower())
        found.append(
            place[axis] if name.lower().endswith("position") else np.rad2deg(angles.get(axis, np.zeros(len(turn))))
        )
    return found


def euler_angles(rotations: F64, order: Sequence[int]) -> tuple[F64, F64, F64]:
    """Return the angles (T,) in radians whose rotations about three axes, multiplied in order, are `rotations`."""
    i, j, k = order
    sign = 1.0 if (j - i) % 3 == 1 else -1.0
    middle = np.arcsin(np.clip(sign * rotations[:, i, k], -1.0, 1.0))
    first = np.arctan2(-sign * rotations[:, j, k], rotations[:, k, k])
    last = np.arctan2(-sign * rotations[:, i, j], rotations[:, i, i])
    return first, middle, last
