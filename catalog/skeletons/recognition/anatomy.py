"""Find the parts of a body in a tree: the branches that are legs and arms, and the nodes between them.

Left and right are found by names, and by the direction in which feet point and knees bend.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from kinedex.catalog.skeletons.recognition.limbs import Limb, Pair, limb_pairs
from kinedex.catalog.skeletons.recognition.tree import ARM, LEG, Tree, lengths, medians
from kinedex.ops.arrays import F64

ARM_TO_LEG = 0.68
"""Upper arm and forearm as a fraction of thigh and calf (0.66 to 0.70 in the skeletons of HDM05 and CMU)."""

TRUNK_TO_LEG = 0.6
"""The distance from mid-hips to mid-shoulders as a fraction of thigh and calf, in the same skeletons."""

_NAMED = 2.2  # a score of names, of at most 3, from which on a limb counts as named
_UNLIKELY = -4.0
_HEAD = ("neck", "head", "headtop")

_SEEN = 0.012  # share of a leg's length; shorter feet or knee bends have no clear direction
_SURE = 0.3  # least mean cosine, in absolute value, at which feet and knees decide against names


@dataclass(frozen=True)
class Anatomy:
    """The parts of a body.

    Attributes
    ----------
    legs, arms : Pair, optional
        The limbs; None where the body has none.
    hips : int
        The node of the pelvis.
    trunk : tuple of int
        The nodes from the hips to where neck or head leave the trunk, as they lie in the tree.
    head : tuple of int
        The nodes beyond the trunk: neck, head and its end; empty if there are none.
    score : float
        The score of the parts and of their proportions.
    """

    legs: Pair | None
    arms: Pair | None
    hips: int
    trunk: tuple[int, ...]
    head: tuple[int, ...]
    score: float

    @property
    def names(self) -> float:
        """Return the fraction of the limbs' parts that are named, from 0 to 1; negative where names contradict."""
        pairs = [pair for pair in (self.legs, self.arms) if pair is not None]
        return sum(pair.names for pair in pairs) / (3 * len(pairs))


def find_anatomies(tree: Tree) -> list[Anatomy]:
    """Return the bodies that a tree may represent, the best first.

    If no whole body is likely, bodies with only legs or only arms are included, provided that names identify the limbs.
    """
    legs, arms = limb_pairs(tree, LEG), limb_pairs(tree, ARM)
    found = [
        body for leg in legs for arm in arms if _apart(tree, leg, arm) and (body := _whole(tree, leg, arm)) is not None
    ]
    if not any(body.score > -6.0 for body in found):
        for kind, pairs in (("legs", legs), ("arms", arms)):
            found += [_part(tree, pair, kind) for pair in pairs if pair.names >= _NAMED and pair.shape > _UNLIKELY]
    return sorted(found, key=lambda body: -body.score)


def _apart(tree: Tree, legs: Pair, arms: Pair) -> bool:
    """Return whether two pairs share no branch, and neither hangs from a branch of the other."""
    tops = {limb.path[0] for pair in (legs, arms) for limb in (pair.first, pair.second)}
    if len(tops) < 4:
        return False
    for one, other in ((legs, arms), (arms, legs)):
        above = set(tree.ancestors(one.at))
        if above & {other.first.path[0], other.second.path[0]}:
            return False
    return True


def _whole(tree: Tree, legs: Pair, arms: Pair) -> Anatomy | None:
    up_from_legs, up_from_arms = tree.ancestors(legs.at), tree.ancestors(arms.at)
    common = next((node for node in up_from_legs if node in set(up_from_arms)), None)
    if common is None:
        return None
    hips = _hips(tree, common, legs)
    top = arms.at
    trunk, head = _trunk_and_head(tree, common, hips, top, legs, arms)
    score = legs.score + arms.score + _relations(tree, legs, arms, bool(head))
    score += 1.0 if common == legs.at or legs.at in tree.children[common] else -1.0
    return Anatomy(legs, arms, hips, trunk, head, score)


def _relations(tree: Tree, legs: Pair, arms: Pair, head: bool) -> float:
    """Return how well the proportions between legs, arms and trunk fit a human's; 0 is perfect, lower is worse."""
    score = -((math.log(arms.length / legs.length / ARM_TO_LEG) / 0.25) ** 2) / 2
    score -= (math.log(max(trunk_length(tree, legs, arms) / legs.length, 1e-3) / TRUNK_TO_LEG) / 0.35) ** 2 / 2
    return max(score, -12.0) - (0.0 if head else 1.5)


def trunk_length(tree: Tree, legs: Pair, arms: Pair) -> float:
    """Return the median distance from the middle of the hips to that of the shoulders."""
    low = (tree.positions[legs.first.nodes[0]] + tree.positions[legs.second.nodes[0]]) / 2
    high = (tree.positions[arms.first.nodes[0]] + tree.positions[arms.second.nodes[0]]) / 2
    return float(medians(lengths(high - low)))


def _hips(tree: Tree, common: int, legs: Pair) -> int:
    """Return the node of the pelvis, where legs and spine meet, or a nearby node that is named as hips."""
    middle = (tree.positions[legs.first.nodes[0]] + tree.positions[legs.second.nodes[0]]) / 2
    near = [common, *tree.ancestors(common)[1:], legs.at]
    for node in near:
        far = float(medians(lengths(tree.positions[node] - middle)))
        if "hips" in tree.parts[node] and far < 0.35 * legs.length:
            return node
    return common


def _trunk_and_head(
    tree: Tree, common: int, hips: int, top: int, legs: Pair, arms: Pair
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return the nodes from the hips to the neck's branch, and those of neck and head."""
    limbs = {limb.path[0] for pair in (legs, arms) for limb in (pair.first, pair.second)}
    line = tree.way(common, top) or [common]
    branches = [
        (node, child)
        for node in line
        for child in tree.children[node]
        if child not in limbs and child not in line and child != legs.at and not tree.names[child].side
    ]
    scores = [_head_score(tree, at, child, line, legs) for at, child in branches]
    best = branches[int(np.argmax(scores))] if max(scores, default=0.0) > 0 else None
    if best is None:
        # The arms may hang from the neck itself.
        neck = next((i for i, node in enumerate(line) if i and set(tree.parts[node]) & {"neck", "head"}), len(line))
        return _from_hips(hips, common, line[:neck]), tuple(line[neck:])
    trunk = line[: line.index(best[0]) + 1]
    neck = next((i for i, node in enumerate(trunk) if i and "neck" in tree.parts[node]), len(trunk))
    return _from_hips(hips, common, trunk[:neck]), (*trunk[neck:], *_head_way(tree, best[1]))


def _from_hips(hips: int, common: int, line: list[int]) -> tuple[int, ...]:
    """Return the nodes of the trunk, beginning at the hips."""
    if hips in line:
        return tuple(line[line.index(hips) :])
    return (hips, *(node for node in line if node != common)) if hips != common else tuple(line)


def _head_score(tree: Tree, at: int, child: int, line: list[int], legs: Pair) -> float:
    """Return a score that is higher the more a branch looks like neck and head; 0 if its length rules that out."""
    names = {part for node in tree.below(child) for part in tree.parts[node]}
    long = (tree.lengths[child] + tree.reach[child]) / legs.length
    if not 0.05 < long < 1.0:
        return 0.0
    named = 3.0 * ("head" in names) + 2.0 * ("neck" in names)
    return named + (0.5 if not names else 0.0) + 0.5 * (line.index(at) + 1) / len(line)


def _head_way(tree: Tree, top: int) -> tuple[int, ...]:
    """Return the nodes of neck and head: those from `top` to the first node named as head, and the end of the head.

    The end is the first child of the head that is an end or is named as a part of the head, else an only child with an
    unknown name; without either there is no end. If no node is named as head, the longest path below `top` is returned.
    """
    named = [node for node in tree.below(top) if "head" in tree.parts[node] and not tree.names[node].end]
    if not named:
        return tuple(tree.longest_way(top))
    way = tree.way(top, named[0])
    children = tree.children[named[0]]
    ends = [child for child in children if tree.names[child].end or set(tree.parts[child]) & set(_HEAD)]
    of_face = {tree.parents[i] for i in range(len(tree.parents)) if i not in tree.children[tree.parents[i]]}
    nameless = [child for child in children if not (tree.parts[child] or tree.names[child].side or child in of_face)]
    return (*way, *(ends[:1] or (nameless if len(children) == 1 else ())))


def _part(tree: Tree, pair: Pair, kind: str) -> Anatomy:
    """Return a body of which only the legs, or only the arms, were found, and its hips."""
    above = tree.ancestors(pair.at)
    if kind == "legs":
        return Anatomy(pair, None, _hips(tree, pair.at, pair), (), (), 2 * pair.score)
    named = [node for node in above if "hips" in tree.parts[node] and "reference" not in tree.parts[node]]
    spine = [node for node in above[1:] if "reference" not in tree.parts[node] or "hips" in tree.parts[node]]
    hips = named[0] if named else spine[-1] if spine else pair.at
    trunk, head = _trunk_and_head(tree, hips, hips, pair.at, pair, pair)
    return replace(Anatomy(None, pair, hips, trunk, head, 0.0), score=2 * pair.score)


@dataclass(frozen=True)
class Sides:
    """The left and the right limbs of a body.

    Attributes
    ----------
    legs, arms : tuple of Limb, optional
        The left and the right one; None where the body has none.
    named : bool
        True if names state the sides.
    mirrored : bool
        True if the limbs that are named left lie on the right: the file's axes are left-handed.
    facing : float
        A number from −1 to 1: positive if feet and knees show that the left limbs are on the left, 0 without evidence.
    crossed : bool
        True if the left leg and the left arm lie on different sides.
    """

    legs: tuple[Limb, Limb] | None
    arms: tuple[Limb, Limb] | None
    named: bool
    mirrored: bool
    facing: float
    crossed: bool


def find_sides(tree: Tree, body: Anatomy) -> Sides:
    """Find the left limbs of a body.

    The names of the limbs decide, if they state sides. Otherwise, left follows from the upward and the forward
    direction in right-handed axes: up is the direction from ankle to hip, and forward is where feet point and knees
    bend.
    """
    legs, arms = _ordered(tree, body.legs), _ordered(tree, body.arms)
    named = any(_stated(tree, limbs) for limbs in (legs, arms))
    facing = 0.0 if legs is None else _facing(tree, legs)
    if legs is not None and not _stated(tree, legs):
        together = 1.0 if arms is None else _along(tree, legs, arms)
        turn = together < 0 if arms is not None and _stated(tree, arms) else facing < 0
        if turn:
            legs, facing = legs[::-1], -facing
    crossed = False
    if legs is not None and arms is not None and _along(tree, legs, arms) < 0:
        if _stated(tree, arms):
            crossed = True
        else:
            arms = arms[::-1]
    return Sides(legs, arms, named, named and facing < -_SURE, facing, crossed)


def _ordered(tree: Tree, pair: Pair | None) -> tuple[Limb, Limb] | None:
    """Return a pair with the limb first whose names say left; unchanged if they say nothing."""
    if pair is None:
        return None
    first, second = pair.first, pair.second
    return (second, first) if _vote(tree, first) < _vote(tree, second) else (first, second)


def _vote(tree: Tree, limb: Limb) -> int:
    sides = [tree.names[node].side for node in limb.path]
    return sides.count("l") - sides.count("r")


def _stated(tree: Tree, limbs: tuple[Limb, Limb] | None) -> bool:
    return limbs is not None and _vote(tree, limbs[0]) > _vote(tree, limbs[1])


def _along(tree: Tree, legs: tuple[Limb, Limb], arms: tuple[Limb, Limb]) -> float:
    """Return the mean cosine between the line of the hips and that of the shoulders, both from right to left."""
    across = [_unit(tree.positions[pair[0].nodes[0]] - tree.positions[pair[1].nodes[0]]) for pair in (legs, arms)]
    return float(np.mean((across[0] * across[1]).sum(axis=0)))


def _facing(tree: Tree, legs: tuple[Limb, Limb]) -> float:
    """Return the mean cosine between the line from right to left hip and the left that follows from feet and knees."""
    across = _unit(tree.positions[legs[0].nodes[0]] - tree.positions[legs[1].nodes[0]])
    total, weight = 0.0, 0.0
    for leg in legs:
        hip, knee, ankle = (tree.positions[node] for node in leg.nodes)
        tip = tree.positions[leg.path[-1]]
        shank, line = _unit(knee - ankle), _unit(hip - ankle)
        for up, vector in ((shank, tip - ankle), (line, knee - ankle)):
            ahead = vector - up * (up * vector).sum(axis=0)
            left = _cross(up, ahead)
            length = lengths(ahead)
            seen = length > _SEEN * leg.length
            total += float((across * left).sum(axis=0)[seen].sum())
            weight += float(length[seen].sum())
    return total / weight if weight > 0 else 0.0


def _cross(a: F64, b: F64) -> F64:
    """Return the cross products of vectors (3, K); `numpy.cross` takes three times as long for a few."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _unit(vectors: F64) -> F64:
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        found = vectors / lengths(vectors)
        return found if np.isfinite(found).all() else np.nan_to_num(found)
