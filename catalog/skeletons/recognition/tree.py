"""The tree of a file's nodes with lengths, reach, and the body parts that names may mean, for recognition."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from kinedex.catalog.skeletons.body_evidence import Evidence
from kinedex.catalog.skeletons.recognition.names import NodeName, Vocabulary, normal_names
from kinedex.catalog.skeletons.recognition.node_places import placed_names
from kinedex.ops.arrays import F64

LEG = ("thigh", "calf", "foot")
ARM = ("upperarm", "forearm", "hand")
FINGERS = ("middle", "index", "ring", "finger", "little", "thumb")
ASIDE = frozenset({"helper", "face", "cloth", "animal"})
"""Parts that no named joint is made of."""

_CORE = frozenset({*LEG, *ARM, "clavicle", "neck", "head", "hips", "spine"})


@dataclass(frozen=True)
class Tree:
    """The nodes of one body as a tree.

    Attributes
    ----------
    names : tuple of NodeName
        The names of N nodes.
    parts : tuple of tuple of str
        The parts of the body that each name may mean; empty for names that no vocabulary knows.
    parents : tuple of int
        −1 for a root.
    children : tuple of tuple of int
        The children of each node, without branches that are no part of a limb (twists, faces, clothes).
    positions : float64 array (N, 3, K)
        Positions of the nodes in the sampled frames.
    rest : float64 array (N, 3)
        Positions of the nodes in the rest pose.
    lengths : tuple of float
        The distance of each node from its parent, 0 for a root.
    reach : tuple of float
        The length of the longest path down from each node.
    """

    names: tuple[NodeName, ...]
    parts: tuple[tuple[str, ...], ...]
    parents: tuple[int, ...]
    children: tuple[tuple[int, ...], ...]
    positions: F64
    rest: F64
    lengths: tuple[float, ...]
    reach: tuple[float, ...]
    _far: dict[int, list[float]] = field(default_factory=dict, init=False, repr=False, compare=False)

    def ancestors(self, node: int) -> list[int]:
        """Return a node and all its ancestors, the root last."""
        path = [node]
        while self.parents[path[-1]] >= 0:
            path.append(self.parents[path[-1]])
        return path

    def way(self, above: int, below: int) -> list[int]:
        """Return the nodes from one down to another, both included; empty if the other does not hang from it."""
        path = [below]
        while path[-1] != above:
            if self.parents[path[-1]] < 0:
                return []
            path.append(self.parents[path[-1]])
        return path[::-1]

    def longest_way(self, node: int) -> list[int]:
        """Return the nodes from one down to the end that is farthest along the bones, or to toes that branch off."""
        path = [node]
        while children := self.children[path[-1]]:
            toes = [child for child in children if "toes" in self.parts[child]]
            path.append(max(toes or children, key=lambda child: self.lengths[child] + self.reach[child]))
        return path

    def below(self, node: int) -> list[int]:
        """Return a node and all below it, parents first."""
        found = [node]
        for other in found:
            found.extend(self.children[other])
        return found

    def distance(self, a: int, b: int) -> float:
        """Return the median distance of two nodes."""
        if a not in self._far:
            with np.errstate(over="ignore", invalid="ignore"):
                self._far[a] = medians(lengths(self.positions - self.positions[a], 1)).tolist()
        return self._far[a][b]


def lengths(vectors: F64, axis: int = 0) -> F64:
    """Return the lengths of vectors along an axis: those of `numpy.linalg.norm`, in half the time for a few."""
    return np.asarray(np.sqrt((vectors * vectors).sum(axis=axis)))


def medians(values: F64) -> F64:
    """Return the medians along the last axis: those of `numpy.median`, which takes five times as long for a few."""
    ordered = np.sort(values, axis=-1)
    low, high = ordered[..., (values.shape[-1] - 1) // 2], ordered[..., values.shape[-1] // 2]
    middle = high if values.shape[-1] % 2 else (low + high) / 2
    return np.where(np.isnan(ordered[..., -1]), np.nan, middle)


def build_tree(evidence: Evidence, vocabulary: Vocabulary) -> Tree:
    """Build the tree of a file's nodes.

    Parameters
    ----------
    evidence : Evidence
        Nodes with `parents`.
    vocabulary : Vocabulary
        The names of parts.
    """
    assert evidence.parents is not None
    parents = evidence.parents
    count = len(parents)
    names, parts = _named(evidence.names, parents, vocabulary)
    above = np.array(parents, dtype=np.intp)
    offsets = np.zeros((count, 3)) if evidence.offsets is None else evidence.offsets
    rest = np.zeros((count, 3))
    for i, parent in enumerate(parents):
        rest[i] = offsets[i] + (rest[parent] if parent >= 0 else 0.0)
    positions = evidence.positions if evidence.positions.shape[2] else rest[:, :, None]
    with np.errstate(over="ignore", invalid="ignore"):
        far = medians(lengths(positions - positions[above], 1))
    bones = np.where(above < 0, 0.0, np.nan_to_num(far, nan=0.0, posinf=0.0)).tolist()
    used = _used(parts, parents)
    children: list[list[int]] = [[] for _ in range(count)]
    reach = [0.0] * count
    for i in range(count - 1, -1, -1):
        parent = parents[i]
        if parent >= 0 and used[i]:
            children[parent].insert(0, i)
            reach[parent] = max(reach[parent], bones[i] + reach[i])
    return Tree(names, parts, parents, tuple(map(tuple, children)), positions, rest, tuple(bones), tuple(reach))


@lru_cache(maxsize=64)  # The takes of an archive share a few skeletons.
def _named(
    texts: tuple[str, ...], parents: tuple[int, ...], vocabulary: Vocabulary
) -> tuple[tuple[NodeName, ...], tuple[tuple[str, ...], ...]]:
    """Return the names of nodes in normal form, and the parts that each may mean by its name or its place."""
    children: list[list[int]] = [[] for _ in texts]
    for i, parent in enumerate(parents):
        if parent >= 0:
            children[parent].append(i)
    names = placed_names(normal_names(texts, vocabulary), parents, children, vocabulary)
    return names, tuple(vocabulary.parts(name) for name in names)


def _used(parts: tuple[tuple[str, ...], ...], parents: tuple[int, ...]) -> list[bool]:
    """Return whether each node may be part of a limb.

    Nodes named as one of `ASIDE`, and all nodes below them, may not, unless a node further down has a core name.
    A heel without toes below it is no part of a leg: at the end of the longest branch, it makes feet point backwards.
    """
    used = [True] * len(parts)
    core, ahead = [False] * len(parts), [False] * len(parts)
    for i in range(len(parts) - 1, -1, -1):
        core[i] = core[i] or bool(_CORE & set(parts[i]))
        ahead[i] = ahead[i] or core[i] or "toes" in parts[i]
        used[i] = core[i] or not (ASIDE & set(parts[i]) or ("heel" in parts[i] and not ahead[i]))
        if parents[i] >= 0:
            core[parents[i]] |= core[i]
            ahead[parents[i]] |= ahead[i]
    for i, parent in enumerate(parents):
        used[i] = used[i] and (parent < 0 or used[parent])
    return used
