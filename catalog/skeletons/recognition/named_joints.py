"""The named joints of a recognised body, as nodes or as fixed combinations of nodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from kinedex.catalog.skeletons.recognition.anatomy import ARM_TO_LEG, Anatomy, Sides
from kinedex.catalog.skeletons.recognition.limbs import Limb
from kinedex.catalog.skeletons.recognition.tree import FINGERS, Tree
from kinedex.catalog.skeletons.skeleton_fit import Mix

SPINE_SHARES = {"belly": 1 / 3, "chest": 2 / 3}
"""The positions of spine joints as shares of the path from root to neck: Acclaim's three bones are equally long."""

_SPINE_NAMES = {
    "belly": ({"belly", "abdomen", "stomach", "navel", "naval", "waist"}, (0.2, 0.5)),
    "chest": ({"chest", "thorax", "ribs", "ribcage"}, (0.5, 0.85)),
}
"""Last words of the names of spine joints, and the shares of the path from root to neck where these are meant.

A joint called `Chest` at a quarter of the way, as in skeletons with one joint of the spine, is the waist. A spine of
`Chest`, `Chest2`, `Chest3` is only numbered.
"""

NECK_SHARE = 0.7
"""The position of the neck as a fraction of the path from root to head: 0.65 in HDM05 and CMU, 0.75+ in game rigs."""

HEAD_M = 0.14
"""The distance from the head joint to the top of the head, along the neck, as a fraction of thigh and calf."""

FINGERS_SHARE = 0.25
"""The distance from wrist to first knuckle as a fraction of the forearm (0.247 in every skeleton of HDM05 and CMU)."""

_TO_KNUCKLE = 0.6  # share of the forearm; knuckles are nearer to the wrist
_FOOT_AHEAD, _FOOT_DOWN = 0.2, 0.06  # shares of the leg: from the ankle to estimated toes
_PAST_BALL = 0.45  # the distance from ball to toes as a share of that from ankle to ball
_CLAVICLE = 0.15  # share of the way from neck to shoulder


@dataclass
class JointMixes:
    """The named joints of a body.

    Attributes
    ----------
    mixes : dict of str to Mix
        The joints that are known, measured and estimated ones.
    estimated : dict of str to str
        A phrase for each joint that the file does not hold, which describes how it is estimated.
    """

    mixes: dict[str, Mix] = field(default_factory=dict)
    estimated: dict[str, str] = field(default_factory=dict)

    def estimate(self, joint: str, mix: Mix, how: str) -> None:
        """Add a joint that the file does not hold."""
        self.mixes[joint] = mix
        self.estimated[joint] = how


def joint_mixes(tree: Tree, body: Anatomy, sides: Sides) -> JointMixes:
    """Return the named joints of a body.

    Parameters
    ----------
    tree : Tree
        The nodes.
    body : Anatomy
        The parts of the body.
    sides : Sides
        Its left and right limbs.
    """
    found = JointMixes()
    found.mixes["root"] = _node(tree, body.hips)
    for side, leg in zip("lr", sides.legs or (), strict=False):
        for joint, node in zip(("hip", "knee", "ankle"), leg.nodes, strict=True):
            found.mixes[side + joint] = _node(tree, node)
        _add_toes(found, tree, body, sides, side, leg)
    if sides.arms is None:
        return found
    reach = _TO_KNUCKLE * sum(arm.bones[2] for arm in sides.arms) / 2  # the same on both sides
    for side, arm in zip("lr", sides.arms, strict=True):
        for joint, node in zip(("shoulder", "elbow", "wrist"), arm.nodes, strict=True):
            found.mixes[side + joint] = _node(tree, node)
        _add_fingers(found, tree, side, arm, reach)
    _add_trunk(found, tree, body, sides)
    for side, arm in zip("lr", sides.arms, strict=True):
        _add_clavicle(found, tree, side, arm)
    return found


def _node(tree: Tree, node: int) -> Mix:
    return Mix(((tree.names[node].text, 1.0),))


def _nodes(tree: Tree, weights: Sequence[tuple[int, float]]) -> Mix:
    return Mix(tuple((tree.names[node].text, round(weight, 4)) for node, weight in weights))


def polyline_point(lengths: Sequence[float], share: float) -> tuple[int, float]:
    """Locate the point at a fraction of a polyline's length: return its segment, and the fraction along the segment.

    Parameters
    ----------
    lengths : sequence of float
        The lengths of the segments, at least one.
    share : float
        The fraction of the whole length, from 0 to 1.

    Returns
    -------
    segment : int
        The index of the segment.
    fraction : float
        The fraction of the segment's length, from 0 to 1.
    """
    left = share * sum(lengths)
    for i, length in enumerate(lengths):
        if left <= length or i == len(lengths) - 1:
            return i, min(left / length, 1.0) if length > 0 else 0.0
        left -= length
    raise ValueError("a polyline has at least one segment")


def _add_trunk(found: JointMixes, tree: Tree, body: Anatomy, sides: Sides) -> None:
    """Add neck, head, the top of the head, and the joints of the spine by their names or by arc length."""
    neck, head, top = head_nodes(tree, body.head)
    line = list(body.trunk)
    if neck is not None:
        line += body.head[: body.head.index(neck) + 1]
        found.mixes["neck"] = _node(tree, neck)
        whole = 1.0
    elif head is not None:
        line += body.head[: body.head.index(head) + 1]
        whole = NECK_SHARE
    else:
        whole = 1.0
    if neck is None and head is None:
        assert sides.arms is not None
        ends = [(arm.nodes[0], 0.5) for arm in sides.arms]
        found.estimate("neck", _nodes(tree, ends), "midway between the shoulders")
        line += [node for node in (sides.arms[0].nodes[0],) if len(line) < 2]
    lengths = [tree.distance(a, b) for a, b in pairwise(line)]
    if lengths and sum(lengths) > 0:
        for joint, share in SPINE_SHARES.items():
            named = _named_on_spine(tree, line, lengths, joint, whole)
            mix = _spine_mix(tree, line, lengths, share * whole) if named is None else _node(tree, named)
            found.mixes[joint] = mix
            if mix.node is None:
                found.estimated[joint] = f"{100 * share:.0f} % of the way along the spine from the root to the neck"
        if neck is None and head is not None:
            how = f"at {100 * whole:.0f} % of the way along the spine from the root to the head"
            found.estimate("neck", _spine_mix(tree, line, lengths, whole), how)
    if head is not None:
        found.mixes["head"] = _node(tree, head)
        _add_top(found, tree, body, sides, line, head, top)


def _named_on_spine(tree: Tree, line: Sequence[int], lengths: Sequence[float], joint: str, whole: float) -> int | None:
    """Return the only node on the spine with a name of the joint, if it lies in the usual part of the spine."""
    words, (low, high) = _SPINE_NAMES[joint]
    named = [i for i, node in enumerate(line) if words & {*tree.names[node].words[-1:]} and "spine" in tree.parts[node]]
    share = sum(lengths[: named[0]]) / (sum(lengths) * whole) if named else 0.0
    return line[named[0]] if len(named) == 1 and low <= share <= high else None


def _spine_mix(tree: Tree, line: Sequence[int], lengths: Sequence[float], share: float) -> Mix:
    i, part = polyline_point(lengths, share)
    if part < 0.03 or part > 0.97:
        return _node(tree, line[i + (part > 0.5)])
    part = round(part, 4)
    return _nodes(tree, [(line[i], 1.0 - part), (line[i + 1], part)])


def head_nodes(tree: Tree, head: Sequence[int]) -> tuple[int | None, int | None, int | None]:
    """Return the nodes of neck, head and the top of the head among those beyond the trunk; None where there is none."""
    inner = [node for node in head if not tree.names[node].end and "headtop" not in tree.parts[node]]
    ends = [node for node in head if node not in inner]
    necks = [node for node in inner if "neck" in tree.parts[node]]
    heads = [node for node in inner if "head" in tree.parts[node] and node not in necks]
    if heads:
        ends += [node for node in inner[inner.index(heads[0]) + 1 :] if not tree.parts[node]]
        return (necks[0] if necks else None), heads[0], (ends[0] if ends else None)
    if necks:
        nameless = [node for node in inner if node not in necks]
        way = [*necks, *(node for node in nameless if head.index(node) > head.index(necks[-1]))]
        if len(way) > 1:
            return way[0], way[-1], (ends[0] if ends else None)
        return way[0], (ends[0] if ends and tree.lengths[ends[0]] > 0 else None), None
    if len(inner) > 2 and not ends:
        return inner[0], inner[-2], inner[-1]
    if len(inner) > 1:
        return inner[0], inner[-1], (ends[0] if ends else None)
    return None, (inner[0] if inner else None), (ends[0] if ends else None)


def leg_length(body: Anatomy) -> float:
    """Return the length of thigh and calf; of a body without legs, it is estimated from the arms."""
    if body.legs is not None:
        return body.legs.length
    assert body.arms is not None
    return body.arms.length / ARM_TO_LEG


def _add_top(
    found: JointMixes, tree: Tree, body: Anatomy, sides: Sides, line: Sequence[int], head: int, top: int | None
) -> None:
    leg = leg_length(body)
    if top is not None and 0.06 * leg < tree.distance(head, top) < 0.6 * leg:
        found.mixes["headtop"] = _node(tree, top)
        return
    neck = found.mixes["neck"]
    shoulders = [arm.nodes[0] for arm in sides.arms or ()]
    positions = {tree.names[node].text: tree.positions[node] for node in (*line, *shoulders, head)}
    at = neck.apply(positions, 1.0)
    far = float(((tree.positions[head] - at) ** 2).sum(axis=0).mean() ** 0.5)
    if far <= 0.02 * leg:
        return
    past = round(min(HEAD_M * leg / far, 3.0), 3)
    how = f"{past:.2f} times the way from neck to head farther on"
    found.estimate("headtop", Mix((("neck", -past), ("head", 1.0 + past)), of_joints=True), how)


def _add_clavicle(found: JointMixes, tree: Tree, side: str, arm: Limb) -> None:
    before = arm.path[: arm.path.index(arm.nodes[0])]
    named = [node for node in before if "clavicle" in tree.parts[node]]
    if before:
        found.mixes[f"{side}clavicle"] = _node(tree, named[-1] if named else before[0])
    elif "neck" in found.mixes:
        mix = Mix((("neck", 1.0 - _CLAVICLE), (f"{side}shoulder", _CLAVICLE)), of_joints=True)
        found.estimate(f"{side}clavicle", mix, f"{100 * _CLAVICLE:.0f} % of the way from neck to shoulder")


def _add_fingers(found: JointMixes, tree: Tree, side: str, arm: Limb, reach: float) -> None:
    """Add the first knuckle of the middle finger, or the nearest substitute; a knuckle is nearer than `reach`."""
    wrist = arm.nodes[2]
    forearm = arm.bones[2]
    below = [node for node in tree.below(wrist)[1:] if tree.distance(wrist, node) > 0.12 * forearm]
    hands = [node for node in arm.path[arm.path.index(wrist) + 1 :] if node in below and "hand" in tree.parts[node]]
    hands = [node for node in hands if not tree.names[node].end]
    for part in ("hand", *FINGERS[:-1]):
        own = [node for node in below if part in tree.parts[node] and not tree.names[node].end]
        known = hands if part == "hand" else own
        near = [node for node in known if tree.distance(wrist, node) < reach]
        if part == "finger":
            near = _knuckles(tree, near, wrist, forearm)
        if near:
            far = {node: tree.distance(wrist, node) for node in near}
            knuckles = [node for node in near if far[node] > 0.22 * forearm] or near
            knuckle = min(knuckles, key=far.__getitem__)
            tip = tree.longest_way(knuckle)[-1]
            short = far[knuckle] <= 0.22 * forearm and tree.distance(wrist, tip) < 0.5 * forearm
            found.mixes[f"{side}fingers"] = _node(tree, tip if short else knuckle)
            return
    branches = _knuckles(tree, [node for node in below if not tree.parts[node]], wrist, forearm)
    if branches:
        found.mixes[f"{side}fingers"] = _node(tree, branches[0])
        return
    tips = [node for node in below if not tree.children[node] and "thumb" not in tree.parts[node]]
    if tips:
        tip = max(tips, key=lambda node: (node in arm.path, tree.distance(wrist, node)))
        far_tip = tree.distance(wrist, tip)
        if far_tip <= 0.5 * forearm:
            found.mixes[f"{side}fingers"] = _node(tree, tip)
            return
        share = round(0.35 * forearm / far_tip, 3)
        how = f"{100 * share:.0f} % of the way from the wrist to the tip of the hand"
        found.estimate(f"{side}fingers", _nodes(tree, [(wrist, 1.0 - share), (tip, share)]), how)
        return
    mix = Mix(((f"{side}elbow", -FINGERS_SHARE), (f"{side}wrist", 1.0 + FINGERS_SHARE)), of_joints=True)
    found.estimate(f"{side}fingers", mix, f"{FINGERS_SHARE:g} forearms past the wrist")


def _knuckles(tree: Tree, nodes: Sequence[int], wrist: int, forearm: float) -> list[int]:
    """Return the knuckle of the middle finger among nodes of fingers, by its place in the middle of the row.

    If there are fewer than three fingers, the given nodes are returned, or none if the first has an unknown name.
    """
    far = {node: tree.distance(wrist, node) for node in nodes}
    long = [node for node in nodes if far[node] > 0.22 * forearm]
    row = [node for node in long if not set(tree.ancestors(node)[1:]) & set(long)]
    if len(row) < 3:
        return list(nodes) if nodes and tree.parts[nodes[0]] else []
    positions = tree.rest[row] - tree.rest[row].mean(axis=0)
    _, _, axes = np.linalg.svd(positions, full_matrices=False)
    order = np.argsort(positions @ axes[0])
    middle = positions[order[len(row) // 2]]
    thumb_last = np.linalg.norm(positions[order[-1]] - middle) > np.linalg.norm(positions[order[0]] - middle)
    return [row[int(order[len(row) // 2 - (1 if thumb_last and len(row) % 2 == 0 else 0)])]]


def _add_toes(found: JointMixes, tree: Tree, body: Anatomy, sides: Sides, side: str, leg: Limb) -> None:
    """Add the tip of the toes, or the nearest substitute."""
    joint, ankle = f"{side}toes", leg.nodes[2]
    past = leg.path[leg.path.index(ankle) + 1 :]
    far = [node for node in past if 0.07 * leg.length < tree.distance(ankle, node) < 0.6 * leg.length]
    if far and (tree.names[far[-1]].end or not tree.children[far[-1]]) and far[-1] != _ball(tree, past):
        found.mixes[joint] = _node(tree, far[-1])
        return
    if far:
        mix = _nodes(tree, [(ankle, -_PAST_BALL), (far[-1], 1.0 + _PAST_BALL)])
        found.estimate(joint, mix, f"{_PAST_BALL:g} times the way from the ankle to the ball of the foot farther on")
        return
    assert sides.legs is not None
    left, right = (other.nodes[0] for other in sides.legs)
    trunk = [node for node in (*body.trunk[1:], *body.head) if tree.distance(body.hips, node) > 0.1 * leg.length]
    width = tree.distance(left, right)
    if not trunk or width <= 0:
        return
    plane = tuple(tree.names[node].text for node in (right, left, trunk[0]))
    weights = ((tree.names[leg.nodes[1]].text, -_FOOT_DOWN), (tree.names[ankle].text, 1.0 + _FOOT_DOWN))
    mix = Mix(weights, plane=plane, out=round(_FOOT_AHEAD * leg.length / width, 3))
    found.estimate(joint, mix, "ahead of the ankle by the length of a foot, as the pelvis faces")


def _ball(tree: Tree, past: Sequence[int]) -> int | None:
    """Return the node of the ball of the foot, if the foot ends there; None if it has a tip."""
    toes = [node for node in past if "toes" in tree.parts[node] and not tree.names[node].end]
    rest = [node for node in past if node not in toes and tree.lengths[node] > 0]
    return toes[-1] if len(toes) == 1 and not rest else None
