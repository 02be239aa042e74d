"""Find bones that a skeleton file leaves without length although a body needs one, and estimate their offsets.

Many files have bones without length that are right: helpers, the first joint of the spine at the hips, neck and
shoulders that begin where the spine ends. A bone is lost if its partner on the other side has a length, or if it lies
within spine, neck or head and these are short without it.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product

import numpy as np

from kinedex.catalog.skeletons.recognition.names import NodeName, load_vocabulary, normal_names
from kinedex.catalog.skeletons.recognition.node_places import twist_nodes
from kinedex.catalog.skeletons.recognition.tree import ASIDE
from kinedex.catalog.skeletons.skeleton_fit import Fit
from kinedex.ops.arrays import F64

_NOTHING = 1e-3  # share of the longest bone; shorter ones have no length
_UNLIKE = 0.15  # largest share by which the bones of both sides may differ in a skeleton that is mirrored
_SHORT = 0.9  # of the legs; the way from the hips to the end of the head is longer in a body, by 1.0 in the mean
_TO_NECK = 0.52  # of the legs; a spine that is longer reaches to the neck
_MIDDLE = frozenset({"spine", "neck", "head", "headtop"})
_FURTHER = 2  # bones of the spine beyond its first joint from which on that joint is not expected at the hips


@dataclass(frozen=True)
class LostBones:
    """Bones without length that a body needs.

    Attributes
    ----------
    offsets : dict of int to float64 array (3,)
        The estimated offset of each node.
    of_partner : tuple of int
        The nodes whose offset is that of the partner on the other side, mirrored.
    along : tuple of int
        The nodes whose offset is the mean of those of the bones before and after it.
    doubtful : tuple of int
        The nodes that may need a length, and have none.
    """

    offsets: dict[int, F64]
    of_partner: tuple[int, ...]
    along: tuple[int, ...]
    doubtful: tuple[int, ...]

    def marked(self, fit: Fit, names: Sequence[str]) -> Fit:
        """Return a fit with warnings on these bones, and the joints at their ends marked as estimated."""
        how = {
            joint: "its bone has no length in the file"
            for joint, mix in fit.joints.items()
            if mix is not None and mix.node is not None and fit.indices[mix.node] in self.offsets
        }
        return replace(fit, estimated={**fit.estimated, **how}, doubts=(*fit.doubts, *self.warnings(names)))

    def warnings(self, names: Sequence[str]) -> list[str]:
        """Return sentences for a take's warnings."""
        found = []
        if self.of_partner:
            found.append(f"{_bones(names, self.of_partner)} no length in the file; the other side's is taken")
        if self.along:
            found.append(f"{_bones(names, self.along)} no length in the file; the mean of the bones beside is taken")
        if self.doubtful:
            found.append(f"{_bones(names, self.doubtful)} no length in the file, which may be wrong")
        return found


def _bones(names: Sequence[str], nodes: Sequence[int]) -> str:
    listed = ", ".join(names[node] for node in nodes)
    return f"bone {listed} has" if len(nodes) == 1 else f"bones {listed} have"


def lost_bones(
    names: Sequence[str], parents: Sequence[int], offsets: F64, apart: Collection[int] = ()
) -> LostBones | None:
    """Return the bones of a skeleton that have lost their lengths; None if there are none.

    Parameters
    ----------
    names : sequence of str
        The N nodes, parents first.
    parents : sequence of int
        The parent of each node, −1 for a root.
    offsets : float64 array (N, 3)
        Each node's offset from its parent.
    apart : collection of int, optional
        Nodes that are no bones: ends, and nodes that are moved instead of offset.
    """
    far = np.abs(offsets).sum(axis=1)
    short = np.flatnonzero(far <= _NOTHING * far.max()).tolist()
    empty = tuple(i for i in short if parents[i] >= 0 and i not in apart)
    return _found(tuple(names), tuple(parents), offsets.tobytes(), empty) if empty else None


@lru_cache(maxsize=64)  # The takes of an archive share a few skeletons.
def _found(names: tuple[str, ...], parents: tuple[int, ...], data: bytes, empty: tuple[int, ...]) -> LostBones | None:
    offsets = np.frombuffer(data).reshape(-1, 3)
    if twists := twist_nodes(names, parents):
        above, offsets = list(parents), offsets.copy()
        for i in range(len(names)):  # a bone that is divided has its whole length
            while above[i] in twists:
                offsets[i] += offsets[above[i]]
                above[i] = parents[above[i]]
        parents = tuple(above)
        far = np.abs(offsets).sum(axis=1)
        empty = tuple(i for i in empty if i not in twists and far[i] <= _NOTHING * far.max())
    words = normal_names(names, load_vocabulary("joints"))
    found = _of_partners(words, offsets, empty)
    of_partner = tuple(found)
    lost, doubtful = _in_the_middle(words, parents, offsets, [i for i in empty if i not in found])
    found |= lost
    return LostBones(found, of_partner, tuple(lost), doubtful) if found or doubtful else None


def _of_partners(words: Sequence[NodeName], offsets: F64, empty: Sequence[int]) -> dict[int, F64]:
    """Return the offsets of bones without length whose partner on the other side has one.

    A partner's offset is reflected as suits the other pairs of bones; the result is empty if no reflection suits them.
    """
    at: dict[tuple[str, tuple[str, tuple[int, ...], bool]], list[int]] = {}
    for i, name in enumerate(words):
        if name.side:
            at.setdefault((name.side, (name.key, name.ordinals, name.end)), []).append(i)
    pairs = [
        pair
        for (side, which), own in at.items()
        if side == "l" and len(others := at.get(("r", which), [])) == len(own)
        for pair in zip(own, others, strict=True)
    ]
    partner = dict(pairs) | {other: i for i, other in pairs}
    alone = [i for i in empty if i in partner and partner[i] not in empty]
    whole = [(i, other) for i, other in pairs if not words[i].end and i not in empty and other not in empty]
    if not alone or not whole:
        return {}
    left, right = offsets[[i for i, _ in whole]], offsets[[i for _, i in whole]]
    size = np.abs(left).sum()
    misfits = {signs: float(np.abs(left - np.array(signs) * right).sum()) for signs in product((-1.0, 1.0), repeat=3)}
    signs = min(misfits, key=misfits.__getitem__)
    return {i: np.array(signs) * offsets[partner[i]] for i in alone} if misfits[signs] <= _UNLIKE * size else {}


def _in_the_middle(
    words: Sequence[NodeName], parents: Sequence[int], offsets: F64, empty: Sequence[int]
) -> tuple[dict[int, F64], tuple[int, ...]]:
    """Return the offsets of lost bones of spine, neck and head, and bones that may be lost."""
    vocabulary = load_vocabulary("joints")
    parts = [frozenset(vocabulary.parts(name)) for name in words]
    middle = [bool(own & _MIDDLE) and not own & ASIDE and not name.side for own, name in zip(parts, words, strict=True)]
    inner = [i for i in empty if middle[i]]
    far = _along_middle(words, parts, parents, offsets, middle) if inner else []
    if not far or max(far) > _SHORT:
        return {}, ()
    found: dict[int, F64] = {}
    doubtful = []
    leaves = set(range(len(words))).difference(parents)
    ends_far = any(i not in empty for i in leaves)  # else no bone of the file has a length at its end
    for i in inner:
        above = parents[i]
        first_neck = "neck" in parts[i] and "neck" not in parts[above]
        at_arms = any(parents[j] == above and words[j].side for j in empty)
        if "headtop" in parts[i] or words[i].end:
            if ends_far:
                doubtful.append(i)
        elif not middle[above]:
            further = [j for j in range(i + 1, len(words)) if "spine" in parts[j] and middle[j] and j not in empty]
            if not words[i].key.startswith("low") and len(further) >= _FURTHER:
                doubtful.append(i)
        elif not (first_neck and (at_arms or far[i] > _TO_NECK)):
            found[i] = _mean_bone(i, parents, middle, empty, offsets)
    return {i: offset for i, offset in found.items() if offset.any()}, tuple(doubtful)


def _along_middle(
    words: Sequence[NodeName],
    parts: Sequence[frozenset[str]],
    parents: Sequence[int],
    offsets: F64,
    middle: Sequence[bool],
) -> list[float]:
    """Return the length of spine, neck and head up to each node as a share of thigh and calf; empty without legs."""
    lengths = np.sqrt((offsets * offsets).sum(axis=1)).tolist()
    feet = [
        i for i, own in enumerate(parts) if "foot" in own and words[i].side and not words[i].end and parents[i] >= 0
    ]
    leg = max((lengths[i] + lengths[parents[i]] for i in feet), default=0.0)
    far = [0.0] * len(words)
    for i, parent in enumerate(parents):
        if parent >= 0 and middle[i] and leg > 0:
            far[i] = far[parent] + lengths[i] / leg
    return far if leg > 0 else []


def _mean_bone(node: int, parents: Sequence[int], middle: Sequence[bool], empty: Collection[int], offsets: F64) -> F64:
    """Return the mean of the nearest bones with a length before and after a node."""
    beside = []
    above = parents[node]
    while above >= 0 and middle[above] and above in empty:
        above = parents[above]
    if above >= 0 and middle[above]:
        beside.append(offsets[above])
    below = [node]
    while below and below[-1] in {*empty, node}:
        below = [j for j, parent in enumerate(parents) if parent == below[-1] and middle[j]][:1]
    beside += [offsets[j] for j in below]
    return np.asarray(np.mean(beside, axis=0)) if beside else np.zeros(3)
