"""Rotations and positions of the nodes of BVH files relative to their parents, for studies."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from kinedex.ops.arrays import F64

if TYPE_CHECKING:
    from studies.skeleton_mutations import BvhText


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
