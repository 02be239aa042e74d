"""This module finds the direction that a body faces on the ground, and moves motions to the origin, facing +Z.

It also mirrors motions across the plane x = 0, with left and right exchanged. Positions are in metres with Y up. The
left side of a body that faces +Z points to +X.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.ops.errors import ParameterError


class Placement(NamedTuple):
    """A body's position on the ground, x and z in metres, and its yaw from +Z in radians."""

    x: float
    z: float
    yaw: float


def facing_yaw(left: F64, right: F64) -> F64:
    """Return the yaw of a body, the angle about Y from +Z, from its left and right joints.

    The body faces across the line from its right to its left joints, seen from above.

    Parameters
    ----------
    left, right : float64 array (…, P, 3)
        Positions of P pairs of joints, such as the hips and the shoulders; NaN if a joint is not known.

    Returns
    -------
    float64 array (…)
        Yaw in radians, from −π to π; with yaw π/2, a body faces +X. NaN if no pair is known, or if the lines between
        the joints of all pairs are vertical.
    """
    across = left - right
    whole = np.isfinite(across).all(axis=-1, keepdims=True)
    x, _, z = np.moveaxis(np.where(whole, across, 0.0).sum(axis=-2), -1, 0)
    return np.where((x == 0.0) & (z == 0.0), np.nan, np.arctan2(-z, x))


def turn_about_y(positions: F64, yaw: float) -> F64:
    """Rotate positions about the Y axis by the angle yaw, from +Z towards +X.

    Parameters
    ----------
    positions : float64 array (…, 3)
        Positions or directions.
    yaw : float
        The angle in radians.
    """
    cosine, sine = math.cos(yaw), math.sin(yaw)
    x, y, z = np.moveaxis(positions, -1, 0)
    return np.stack([cosine * x + sine * z, y, cosine * z - sine * x], axis=-1)


def start_at_origin(positions: F64, placement: Placement) -> F64:
    """Move and rotate positions so that a body with a placement stands at the origin, facing +Z; keep heights.

    Parameters
    ----------
    positions : float64 array (…, 3)
        Positions in metres, Y up.
    placement : Placement
        The body's placement before this transformation.
    """
    return turn_about_y(positions - np.array([placement.x, 0.0, placement.z]), -placement.yaw)


def turned_quaternions(rotations: F64, yaw: float) -> F64:
    """Return quaternions (…, 4) w, x, y, z, rotated about the Y axis by yaw radians."""
    a, c = math.cos(yaw / 2.0), math.sin(yaw / 2.0)
    w, x, y, z = np.moveaxis(rotations, -1, 0)
    return np.stack([a * w - c * y, a * x + c * z, a * y + c * w, a * z - c * x], axis=-1)


def placement_of(root: F64, left: F64, right: F64) -> Placement:
    """Return the placement of a body in one frame.

    Parameters
    ----------
    root : float64 array (3,)
        The root's position.
    left, right : float64 array (P, 3)
        Positions of P pairs of joints, such as the hips and the shoulders; NaN if a joint is not known.

    Raises
    ------
    ParameterError
        The root is not known, or no pair of joints is known.
    """
    yaw = float(facing_yaw(left, right))
    if not (np.isfinite(root).all() and math.isfinite(yaw)):
        raise ParameterError("the body", "with a root and both hips or both shoulders", "unknown places")
    return Placement(float(root[0]), float(root[2]), yaw)


def mirrored_names(names: Sequence[str]) -> list[str]:
    """Return for each joint the name of its mirror image, such as lhip for rhip, or its own name if it has none.

    A name that begins with l or r has a mirror image if the name with the other letter is also in the list.
    """
    known = set(names)
    others = {name: {"l": "r", "r": "l"}.get(name[:1], "") + name[1:] for name in names}
    return [others[name] if others[name] in known and name[:1] in "lr" else name for name in names]


def mirrored_positions(positions: F64, names: Sequence[str]) -> F64:
    """Return the joint positions of a body's mirror image.

    Parameters
    ----------
    positions : float array (T, J, 3)
        Positions of joints; NaN if a joint is not known.
    names : sequence of str
        The J joints; those that begin with l and r are pairs (`mirrored_names`).

    Returns
    -------
    float array (T, J, 3)
        Positions of the joints in the order of the names. Mirroring twice restores the positions exactly.
    """
    index = {name: j for j, name in enumerate(names)}
    order = np.array([index[name] for name in mirrored_names(names)], np.int64)
    return positions[:, order] * np.array([-1, 1, 1], positions.dtype)


def mirrored_quaternions(rotations: F64) -> F64:
    """Return the orientations of mirror images, float array (…, 4) w, x, y, z.

    The axes of the mirrored body are mirrored as well, so that its left is +X, as it was before.
    """
    return rotations * np.array([1, 1, -1, -1], rotations.dtype)
