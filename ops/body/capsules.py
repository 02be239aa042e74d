"""This module models the surface of a body by capsules between the joints of a kinematic chain."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from kinedex.ops.arrays import F64, I64
from kinedex.ops.body.kinematic_chain import ChainBody, Poses, forward
from kinedex.ops.errors import ParameterError


@dataclass(frozen=True)
class Capsule:
    """All points within a radius of the line segment between two joints.

    Attributes
    ----------
    start, end : int
        The joints of the chain at the ends of its axis.
    radius : float
        Radius in metres for a body of the surface's reference height.
    """

    start: int
    end: int
    radius: float


@dataclass(frozen=True)
class Surface:
    """The capsules of a kinematic chain, with radii for a body of a reference height.

    Attributes
    ----------
    capsules : tuple of Capsule
        The capsules.
    low : tuple of int
        Joints whose mean height at rest is the lower end of the body's height, usually the ankles.
    high : int
        Joint at the upper end of the body's height, usually the top of the head.
    height_m : float
        Reference height in metres, at which the radii hold.

    Raises
    ------
    ParameterError
        A radius or the height is not positive and finite.
    """

    capsules: tuple[Capsule, ...]
    low: tuple[int, ...]
    high: int
    height_m: float

    def __post_init__(self) -> None:
        sizes = [("height_m", self.height_m), *(("radius", capsule.radius) for capsule in self.capsules)]
        for name, size in sizes:
            if not (np.isfinite(size) and size > 0):
                raise ParameterError(name, "positive and finite", size)


class Capsules(NamedTuple):
    """The capsules of one body.

    Attributes
    ----------
    starts, ends : int64 array (N,)
        Joints at the ends of each capsule's axis.
    radii : float64 array (N,)
        Radii in metres.
    """

    starts: I64
    ends: I64
    radii: F64


def body_capsules(body: ChainBody, surface: Surface, thickness: float = 1.0) -> Capsules:
    """Return the capsules of a body, with radii scaled by its height.

    Parameters
    ----------
    body : ChainBody
        The body.
    surface : Surface
        The capsules of its chain.
    thickness : float, optional
        A factor by which all radii are multiplied: 1.04 gives a surface that is 4 % too thick.

    Returns
    -------
    Capsules
        The joints and radii of the capsules.

    Raises
    ------
    ParameterError
        The factor is not positive and finite, or the body has no height.
    """
    if not (np.isfinite(thickness) and thickness > 0):
        raise ParameterError("thickness", "positive and finite", thickness)
    height = body_height(body, surface.low, surface.high)
    if height <= 0:
        raise ParameterError("offsets", "those of a body whose head is above its ankles at rest", height)
    radii = np.array([capsule.radius for capsule in surface.capsules]) * (thickness * height / surface.height_m)
    starts = np.array([capsule.start for capsule in surface.capsules], np.int64)
    ends = np.array([capsule.end for capsule in surface.capsules], np.int64)
    return Capsules(starts, ends, radii)


def body_height(body: ChainBody, low: tuple[int, ...], high: int) -> float:
    """Return the height of a body at rest in metres, from the mean of the joints `low` to the joint `high`."""
    joints = rest_joints(body)
    return float(joints[high, 1] - joints[list(low), 1].mean())


def rest_joints(body: ChainBody) -> F64:
    """Return the joints (J, 3) of a body at rest in metres, with the first node at the origin."""
    rotations = np.broadcast_to(np.eye(3), (1, len(body.chain.nodes), 3, 3)).copy()
    return np.ascontiguousarray(forward(body, Poses(np.zeros((1, 3)), rotations))[0][:, :, 0])
