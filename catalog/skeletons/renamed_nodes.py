"""Find nodes of a skeleton mapping that have other names in a file, by their places in the tree."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

from kinedex.catalog.skeletons.body_evidence import Evidence
from kinedex.catalog.skeletons.recognition.names import load_vocabulary, normal_names
from kinedex.catalog.skeletons.skeleton_fit import Fit, SkeletonMapping

_CHAINS = (
    ("root", "belly", "chest", "neck", "head", "headtop"),
    *(("root", *(f"{side}{part}" for part in ("hip", "knee", "ankle", "toes"))) for side in "lr"),
    *(("chest", *(f"{side}{part}" for part in ("clavicle", "shoulder", "elbow", "wrist", "fingers"))) for side in "lr"),
)
"""Joints from the pelvis outwards, each beyond the one before it."""

_MOST = 3  # names that a mapping may lack: of a renamed joint, its end, and a bone's source


def renamed_fit(mappings: Iterable[SkeletonMapping], evidence: Evidence) -> Fit | None:
    """Return the fit of a mapping of which a tree lacks a few names, if nodes with unknown names are in their places.

    Parameters
    ----------
    mappings : iterable of SkeletonMapping
        The mappings that may be used.
    evidence : Evidence
        Nodes with `parents`.

    Returns
    -------
    Fit or None
        The fit that supplies the most joints, with a doubt that lists the nodes found by their places; None if every
        mapping needs a node for whose place there is no candidate, or more than one.
    """
    parents, offsets = evidence.parents, evidence.offsets
    nameless = _nameless(evidence.names)
    if parents is None or not nameless:
        return None
    nodes = {
        name: i
        for i, name in enumerate(evidence.names)
        if offsets is None or not name.endswith("_end") or bool(offsets[i].any())
    }
    found = [_renamed(mapping, nodes, parents, nameless) for mapping in mappings]
    return max((fit for fit in found if fit is not None), key=lambda fit: fit.named, default=None)


@lru_cache(maxsize=64)  # The takes of an archive share a few skeletons.
def _nameless(names: tuple[str, ...]) -> dict[int, bool]:
    """Return the nodes with unknown names, each with True if it is an end."""
    vocabulary = load_vocabulary("joints")
    words = normal_names(names, vocabulary)
    return {i: name.end for i, name in enumerate(words) if not vocabulary.parts(name)}


def _renamed(
    mapping: SkeletonMapping, nodes: Mapping[str, int], parents: Sequence[int], nameless: Mapping[int, bool]
) -> Fit | None:
    """Return the fit of a mapping that lacks a few names; None if it lacks none, too many, or one that is not found."""
    plain = mapping.fit(nodes)
    needed, lacking = _lacking(plain)
    if not lacking or len(needed) > _MOST:
        return None
    named, shown, tips = dict(nodes), set(nodes.values()), set(range(len(parents))).difference(parents)
    for name in sorted(lacking, key=lambda one: one.endswith("_end")):
        indices = mapping.indices(named)
        near, far = _bounds(mapping, name, indices)
        end = name.endswith("_end")
        taken = {indices.get(other) for other in _all_names(mapping)}
        free = [i for i, ends in nameless.items() if (ends or i in tips if end else not ends)]
        free = [i for i in free if i not in taken and i in shown]
        there = [i for i in free if _lies(i, near, far, parents)]
        if len(there) > 1 and end and (stem := indices.get(name.removesuffix("_end"))) is not None:
            there = [i for i in there if parents[i] == stem]
        if len(there) == 1:
            named[name] = there[0]
        elif name in needed:
            return None
    fit = mapping.fit(named)
    found = [name for name in lacking if name in named]
    if fit.missing or not found:
        return None
    text = {i: name for name, i in nodes.items()}
    pairs = ", ".join(f"'{text[named[name]]}' is '{name}'" for name in found)
    doubt = f"its names are those of mapping '{mapping.name}' but for {len(found)}, read by place in the tree: {pairs}"
    return replace(fit, doubts=(doubt,))


def _all_names(mapping: SkeletonMapping) -> set[str]:
    """Return the nodes that a mapping names: in the first choice of each joint, and for its bones."""
    mixes = [choices[0] for choices in mapping.joints.values() if choices and choices[0] is not None]
    needed = {name for mix in mixes if not mix.of_joints for name in mix.names}
    return needed.union(mapping.bones, *mapping.bones.values())


def _lacking(fit: Fit) -> tuple[list[str], list[str]]:
    """Return the missing nodes without which a mapping cannot be used, and these with missing nodes that improve it.

    A node improves the mapping if its joint would otherwise be built from other joints, or from another node than the
    joint of the other side.
    """
    mapping = fit.mapping
    needed: list[str] = []
    better: list[str] = []
    for joint, choices in mapping.joints.items():
        first = choices[0]
        if first is None or first.of_joints:
            continue
        names = [name for name in first.names if name not in fit.indices]
        if joint not in fit.joints:
            needed += names
        elif joint in fit.fallen:
            better += names
    needed += [name for bone, weights in mapping.bones.items() for name in (bone, *weights) if name not in fit.indices]
    return list(dict.fromkeys(needed)), list(dict.fromkeys([*needed, *better]))


def _bounds(mapping: SkeletonMapping, name: str, indices: Mapping[str, int]) -> tuple[int | None, list[int]]:
    """Return the nearest known node above a node, and known nodes below it, by the order of joints in a body."""
    at = {
        joint: mix.node
        for joint, choices in mapping.joints.items()
        if (mix := choices[0]) is not None and mix.node is not None
    }
    near: int | None = None
    far: list[int] = []
    for bone, weights in mapping.bones.items():
        if name in weights and bone in indices:
            far.append(indices[bone])
    for chain in _CHAINS:
        nodes = [at[joint] for joint in chain if joint in at]
        if name not in nodes:
            continue
        place = nodes.index(name)
        before = [indices[node] for node in nodes[:place] if node in indices]
        near = before[-1] if before else near
        far += [indices[node] for node in nodes[place + 1 :] if node in indices][:1]
    return near, far


def _lies(node: int, near: int | None, far: Sequence[int], parents: Sequence[int]) -> bool:
    """Return whether a node lies below one node and above others, of which at least one must be known."""
    if near is None and not far:
        return False
    return (near is None or _is_above(near, node, parents)) and all(_is_above(node, other, parents) for other in far)


def _is_above(node: int, other: int, parents: Sequence[int]) -> bool:
    """Return whether a node is an ancestor of another."""
    above = parents[other]
    while above >= 0 and above != node:
        above = parents[above]
    return above == node and node >= 0
