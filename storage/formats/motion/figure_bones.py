"""Replace lengths that bones of figures lack in the file: from the other side, from neighbours, or from a mapping."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from kinedex.catalog.skeletons.lost_bones import LostBones, lost_bones
from kinedex.catalog.skeletons.mappings import Fit
from kinedex.catalog.skeletons.recognition.node_places import twist_nodes
from kinedex.ops.arrays import F64
from kinedex.storage.formats.motion.figure_poses import Figure

_NO_LENGTH_M = 1e-5


@dataclass(frozen=True)
class RestoredBone:
    """A bone without length in the file: its node with all descendants, its parent, and its vector in the rest pose."""

    members: tuple[int, ...]
    parent: int
    way: F64


def measured_offsets(figure: Figure, positions: F64) -> F64:
    """Return the rest offsets of the nodes (N, 3); 0 for nodes that lie at their parents in the frames of a sample.

    Parameters
    ----------
    figure : Figure
        The figure.
    positions : float64 array (N, 3, K)
        The nodes in K frames.
    """
    offsets = figure.rest.copy()
    for node, above in enumerate(figure.parents):
        if above >= 0:
            offsets[node] -= figure.rest[above]
            if _together(positions, node, above):
                offsets[node] = 0.0
    return offsets


def bones_of_body(figure: Figure, offsets: F64) -> tuple[LostBones | None, list[RestoredBone]]:
    """Return the bones that lack a length that a body needs, and those whose length can be estimated.

    Lengths are estimated from the other side and from neighbours. As the two sides may be mirror images of each other
    either in the scene's axes or in the bones' own axes at rest, both are tried, and the one with more results counts.

    Parameters
    ----------
    figure : Figure
        The figure.
    offsets : float64 array (N, 3)
        The nodes' offsets from their parents, as `measured_offsets` returns them.

    Returns
    -------
    lost : LostBones or None
        The bones as `lost_bones` finds them; None if there are none.
    restored : list of RestoredBone
        The bones of `lost` with an estimated length.
    """
    whole = np.where(np.array(figure.parents)[:, None] < 0, 0.0, offsets)  # a root's place is no bone
    turns = figure.turns[list(figure.parents)] if figure.turns is not None else np.eye(3)[None]
    own = np.einsum("nba,nb->na", np.broadcast_to(turns, (len(whole), 3, 3)), whole)
    tries = [(lost_bones(figure.names, figure.parents, whole), np.eye(3)[None])]
    tries += [(lost_bones(figure.names, figure.parents, own), turns)] if figure.turns is not None else []
    found, axes = max(tries, key=lambda one: -1 if one[0] is None else len(one[0].offsets))
    if found is None:
        return None, []
    axes = np.broadcast_to(axes, (len(whole), 3, 3))
    return found, [_bone(figure, node, axes[node] @ way) for node, way in found.offsets.items()]


def bones_of_mapping(figure: Figure, fit: Fit, positions: F64) -> list[RestoredBone]:
    """Return the bones that have no length in the frames of a sample, but one in the mapping."""
    bones = []
    above = list(figure.parents)
    for i in sorted(twist_nodes(figure.names, figure.parents)):
        above = [figure.parents[i] if parent == i else parent for parent in above]
    for name, weights in fit.mapping.bones.items():
        node = fit.indices[name]
        if figure.parents[node] < 0 or not _together(positions, node, figure.parents[node]):
            continue
        others = [(weight, fit.indices[other]) for other, weight in weights.items()]
        way = sum(weight * (figure.rest[other] - figure.rest[above[other]]) for weight, other in others)
        bones.append(_bone(figure, node, np.asarray(way)))
    return bones


def with_bones(figure: Figure, bones: Sequence[RestoredBone]) -> Figure:
    """Return a figure in whose rest pose bones have their lengths."""
    if not bones:
        return figure
    rest = figure.rest.copy()
    for bone in bones:
        rest[list(bone.members)] += bone.way
    return replace(figure, rest=rest)


def lengthen(places: F64, bones: Sequence[RestoredBone], turns: F64) -> None:
    """Move the nodes beyond restored bones, in place, by the vectors of these bones.

    Parameters
    ----------
    places : float64 array (N, 3, K)
        The nodes in K frames.
    bones : sequence of RestoredBone
        M bones.
    turns : float64 array (M, 9, K)
        The rotations of the bones' parents from their rest pose.
    """
    for bone, turn in zip(bones, turns, strict=True):
        places[list(bone.members)] += np.einsum("abk,b->ak", turn.reshape(3, 3, -1), bone.way)


def _bone(figure: Figure, node: int, way: F64) -> RestoredBone:
    members = [node]
    for i, above in enumerate(figure.parents):
        if above in members:
            members.append(i)
    return RestoredBone(tuple(members), figure.parents[node], way)


def _together(positions: F64, node: int, other: int) -> bool:
    return bool(np.abs(positions[node] - positions[other]).max() < _NO_LENGTH_M)
