"""Find legs and arms in a tree: pairs of similar branches, and the three joints of each."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import accumulate, combinations

import numpy as np

from kinedex.catalog.skeletons.recognition.names import NodeName
from kinedex.catalog.skeletons.recognition.tree import ARM, LEG, Tree

_MIN_LENGTH = 0.12  # least length of a limb as a share of the longest path through the tree
_OF_LIMBS = frozenset({*LEG, *ARM, "clavicle", "pelvis side"})
_NAME_WEIGHT = 4.0  # a name outweighs a length that is a third too long
_WORST = -10.0  # least score of lengths
_PASSED, _BENT, _SKIPPED = 0.4, 1.2, 1.5  # costs of a node within a bone: without a name, bent, with a joint's name
_JOINTS = frozenset({*LEG, *ARM})
_LONGEST = 14  # most nodes of a branch that are considered


@dataclass(frozen=True)
class Limb:
    """Three nodes of a branch as hip, knee and ankle, or as shoulder, elbow and wrist.

    Attributes
    ----------
    path : tuple of int
        The nodes of the branch, from its first down to its end.
    nodes : tuple of int
        The three nodes, from the body outwards.
    bones : tuple of float
        The lengths from the body to the first node, between the three, and past the last.
    names : float
        The fit of the names, up to 3; negative where they name another limb.
    shape : float
        The fit of the lengths; 0 is perfect, and lower values are worse.
    """

    path: tuple[int, ...]
    nodes: tuple[int, int, int]
    bones: tuple[float, float, float, float]
    names: float
    shape: float

    @property
    def score(self) -> float:
        """Return the weighted sum of the fits of names and lengths."""
        return _NAME_WEIGHT * self.names + self.shape

    @property
    def length(self) -> float:
        """Return the length of the two bones."""
        return self.bones[1] + self.bones[2]


@dataclass(frozen=True)
class Pair:
    """Two limbs that hang from one node and are alike."""

    at: int
    first: Limb
    second: Limb

    @cached_property
    def likeness(self) -> float:
        """Return the similarity of the bone lengths of the two limbs; 0 if they are equal, else negative."""
        parts = [
            abs(math.log(max(a, 1e-9) / max(b, 1e-9)))
            for a, b in zip(self.first.bones[1:3], self.second.bones[1:3], strict=True)
        ]
        return -sum(min(part / 0.15, 4.0) ** 2 / 2 for part in parts)

    @cached_property
    def score(self) -> float:
        """Return the score of both limbs and of their likeness."""
        return self.first.score + self.second.score + self.likeness

    @property
    def names(self) -> float:
        """Return the mean fit of the names of both limbs, up to 3."""
        return (self.first.names + self.second.names) / 2

    @property
    def shape(self) -> float:
        """Return the mean fit of the lengths of both limbs, plus half of their likeness."""
        return (self.first.shape + self.second.shape) / 2 + self.likeness / 2

    @property
    def length(self) -> float:
        """Return the mean length of their two bones."""
        return (self.first.length + self.second.length) / 2


def limb_pairs(tree: Tree, kind: Sequence[str], most: int = 6) -> list[Pair]:
    """Return the pairs of branches that may be legs (`LEG`) or arms (`ARM`), the best first."""
    whole = max((tree.reach[i] for i, parent in enumerate(tree.parents) if parent < 0), default=0.0)
    found: list[Pair] = []
    known: dict[int, Limb | None] = {}
    for at, children in enumerate(tree.children):
        long = [c for c in children if tree.lengths[c] + tree.reach[c] > _MIN_LENGTH * whole > 0]
        for a, b in combinations(long[:24], 2):
            sides = {tree.names[a].side, tree.names[b].side}
            if sides not in ({""}, {"l", "r"}):
                continue
            near, far = sorted(tree.lengths[c] + tree.reach[c] for c in (a, b))
            if near < 0.55 * far:
                continue
            for top in (a, b):
                if top not in known:
                    known[top] = _best_limb(tree, top, kind)
            first, second = known[a], known[b]
            if first is not None and second is not None:
                found.append(_matched(tree, at, first, second, kind))
    return sorted(found, key=lambda pair: -pair.score)[:most]


def _matched(tree: Tree, at: int, first: Limb, second: Limb, kind: Sequence[str]) -> Pair:
    """Return two limbs as a pair; if their joints differ, try those of each limb for both, and keep the best pair."""
    pair = Pair(at, first, second)
    if pair.likeness < -1.0:
        for own, other, swapped in ((first, second, False), (second, first, True)):
            positions = [own.path.index(node) for node in own.nodes]
            if positions[2] < len(other.path):
                twin = _Branch(tree, other.path, kind).limb((positions[0], positions[1], positions[2]))
                both = Pair(at, twin, own) if swapped else Pair(at, own, twin)
                pair = max(pair, both, key=lambda one: one.score)
    return pair


def _best_limb(tree: Tree, top: int, kind: Sequence[str]) -> Limb | None:
    path = tuple(tree.longest_way(top)[:_LONGEST])
    branch = _Branch(tree, path, kind)
    best = max(combinations(range(len(path)), 3), key=branch.score, default=None)
    return None if best is None else branch.limb(best)


class _Branch:
    """The nodes of a branch with the scores of its cuts: choices of three nodes as the joints of a limb."""

    def __init__(self, tree: Tree, path: tuple[int, ...], kind: Sequence[str]) -> None:
        self.path, self.arm = path, tuple(kind) == ARM
        self.far = list(accumulate(tree.lengths[node] for node in path))
        names, parts = tuple(tree.names[node] for node in path), tuple(tree.parts[node] for node in path)
        self.named = _named_parts(names, parts, tuple(kind))
        self.joints = list(accumulate(_joint(tree, path, at) for at in range(len(path))))

    def bones(self, cut: tuple[int, int, int]) -> tuple[float, float, float, float]:
        """Return the lengths before, between and past the three joints of a cut."""
        near, middle, last = (self.far[at] for at in cut)
        return near, middle - near, last - middle, self.far[-1] - last

    def names(self, cut: tuple[int, int, int]) -> float:
        """Return how well the names of the three joints of a cut fit, up to 3."""
        return self.named[0][cut[0]] + self.named[1][cut[1]] + self.named[2][cut[2]]

    def score(self, cut: tuple[int, int, int]) -> float:
        """Return the score of the limb that a cut makes."""
        return _NAME_WEIGHT * self.names(cut) + self.shape(cut)

    def shape(self, cut: tuple[int, int, int]) -> float:
        """Return how well lengths fit, and how little the nodes between the three bend."""
        near, middle, last = cut
        between = self.joints[middle - 1] - self.joints[near] + self.joints[last - 1] - self.joints[middle]
        return max(_shape(*self.bones(cut), self.arm) - between, _WORST)

    def limb(self, cut: tuple[int, int, int]) -> Limb:
        """Return the limb that a cut makes."""
        bones = self.bones(cut)
        nodes = (self.path[cut[0]], self.path[cut[1]], self.path[cut[2]])
        return Limb(self.path, nodes, bones, self.names(cut), self.shape(cut))


def _joint(tree: Tree, path: Sequence[int], at: int) -> float:
    """Return the cost of a node within a bone.

    A node without a name costs something, and more if the bone bends there; so does a node that is named as a joint.
    """
    if not 0 < at < len(path) - 1:
        return 0.0
    parts = set(tree.parts[path[at]])
    if parts:
        first = not any(parts & set(tree.parts[node]) for node in path[:at])
        return _SKIPPED if first and parts & _JOINTS else 0.0
    before, after = tree.lengths[path[at]], tree.lengths[path[at + 1]]
    if min(before, after) < 0.02 * (before + after):
        return 0.0
    straight = tree.positions[path[at + 1]] - tree.positions[path[at - 1]]
    bend = 1.0 - float(np.sqrt((straight * straight).sum(axis=0).min())) / (before + after)
    return _PASSED + (_BENT if bend > 0.02 else 0.0)


@lru_cache(maxsize=1024)  # The takes of an archive share a few skeletons.
def _named_parts(
    names: tuple[NodeName, ...], parts: tuple[tuple[str, ...], ...], kind: tuple[str, ...]
) -> tuple[tuple[float, ...], ...]:
    """Return how well the names of a branch's nodes fit each part of a limb."""
    return tuple(tuple(_named(names, parts, at, part, kind) for at in range(len(names))) for part in kind)


def _named(
    names: Sequence[NodeName], parts: Sequence[tuple[str, ...]], at: int, part: str, kind: Sequence[str]
) -> float:
    """Return how well the name of a node fits a part, at most 1; negative if the name means another part or node."""
    name, own = names[at], parts[at]
    if name.end and any(part in others and not other.end for other, others in zip(names, parts, strict=True)):
        return -1.0
    if part in own:
        sure = _only(own)
        before = any(part in others and _only(others) >= sure for others in parts[:at])
        helper = name.end or name.text.startswith("_")  # `__UpLeg_L` leads from the pelvis to `UpLeg_L`
        return (1.0 if sure else 0.75) * (0.6 if before else 1.0) * (0.5 if helper else 1.0)
    if any(part in others and _only(others) and not other.end for other, others in zip(names, parts, strict=True)):
        return -1.0  # another node of the branch has the name
    if not own:
        return 0.0
    limb = [other for other in own if other in (*LEG, *ARM)]
    return -1.0 if limb and not any(other in kind for other in limb) else -0.5


def _only(parts: tuple[str, ...]) -> bool:
    """Return whether a name means one part of a limb only."""
    return len({part for part in parts if part in _OF_LIMBS}) == 1


def _shape(before: float, upper: float, lower: float, rest: float, arm: bool) -> float:
    """Return how well the lengths of a limb fit a human's; 0 is perfect, and less is worse."""
    if min(upper, lower) <= 0:
        return 2 * _WORST
    whole = upper + lower
    score = -((math.log(upper / lower) / 0.25) ** 2) / 2
    score -= (max(before / whole - (0.75 if arm else 0.4), 0.0) / 0.12) ** 2 / 2
    score -= (max(rest / whole - 0.5, 0.0) / 0.1) ** 2 / 2
    score -= 0.3 if not arm and rest < 0.02 * whole else 0.0
    return max(score, _WORST)
