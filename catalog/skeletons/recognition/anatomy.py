"""The parts of a body in a tree: which pair of branches are the legs, which the arms, and what lies between them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from kinedex.catalog.skeletons.recognition.limbs import Pair, limb_pairs
from kinedex.catalog.skeletons.recognition.tree import ARM, LEG, Tree, lengths, medians

ARM_TO_LEG = 0.68
"""Upper arm and forearm as a fraction of thigh and calf (0.66 to 0.70 in the skeletons of HDM05 and CMU)."""

TRUNK_TO_LEG = 0.6
"""The distance from mid-hips to mid-shoulders as a fraction of thigh and calf, in the same skeletons."""

_NAMED = 2.2  # a score of names, of at most 3, from which on a limb counts as named
_UNLIKELY = -4.0
_HEAD = ("neck", "head", "headtop")


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
    """Return the bodies that a tree may be, the best first: whole ones, and halves whose names leave no doubt."""
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
    low = (tree.places[legs.first.nodes[0]] + tree.places[legs.second.nodes[0]]) / 2
    high = (tree.places[arms.first.nodes[0]] + tree.places[arms.second.nodes[0]]) / 2
    return float(medians(lengths(high - low)))


def _hips(tree: Tree, common: int, legs: Pair) -> int:
    """Return the node of the pelvis: where legs and spine part, or a near node with a name of the hips."""
    middle = (tree.places[legs.first.nodes[0]] + tree.places[legs.second.nodes[0]]) / 2
    near = [common, *tree.ancestors(common)[1:], legs.at]
    for node in near:
        far = float(medians(lengths(tree.places[node] - middle)))
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
    """Return the trunk so that it begins at the hips."""
    if hips in line:
        return tuple(line[line.index(hips) :])
    return (hips, *(node for node in line if node != common)) if hips != common else tuple(line)


def _head_score(tree: Tree, at: int, child: int, line: list[int], legs: Pair) -> float:
    """Return how probably a branch is neck and head; 0 or less if it is not."""
    names = {part for node in tree.below(child) for part in tree.parts[node]}
    long = (tree.lengths[child] + tree.reach[child]) / legs.length
    if not 0.05 < long < 1.0:
        return 0.0
    named = 3.0 * ("head" in names) + 2.0 * ("neck" in names)
    return named + (0.5 if not names else 0.0) + 0.5 * (line.index(at) + 1) / len(line)


def _head_way(tree: Tree, top: int) -> tuple[int, ...]:
    """Return the nodes of neck and head: the path to the node named as head and past it, or the longest path."""
    named = [node for node in tree.below(top) if "head" in tree.parts[node] and not tree.names[node].end]
    if not named:
        return tuple(tree.longest_way(top))
    way = tree.way(top, named[0])
    ends = [child for child in tree.children[named[0]] if tree.names[child].end or set(tree.parts[child]) & set(_HEAD)]
    return (*way, *ends[:1])


def _part(tree: Tree, pair: Pair, kind: str) -> Anatomy:
    """Return the body of which only the legs, or only the arms, were found, with the hips near to them."""
    above = tree.ancestors(pair.at)
    if kind == "legs":
        return Anatomy(pair, None, _hips(tree, pair.at, pair), (), (), 2 * pair.score)
    named = [node for node in above if "hips" in tree.parts[node] and "reference" not in tree.parts[node]]
    spine = [node for node in above[1:] if "reference" not in tree.parts[node] or "hips" in tree.parts[node]]
    hips = named[0] if named else spine[-1] if spine else pair.at
    trunk, head = _trunk_and_head(tree, hips, hips, pair.at, pair, pair)
    return replace(Anatomy(None, pair, hips, trunk, head, 0.0), score=2 * pair.score)
