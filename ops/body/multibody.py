"""This module does forward kinematics of multibody models, whose joints are functions of generalised coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.ops.body import axisangle
from kinedex.ops.errors import ParameterError


class Function(Protocol):
    """A function of one or several coordinates (K, T) with values (T,)."""

    def __call__(self, values: F64) -> F64:
        """Return the values of the function in every frame."""
        ...


@dataclass(frozen=True)
class Linear:
    """A linear function: the sum of coordinates times `slopes`, plus a constant; without slopes it is constant."""

    slopes: tuple[float, ...]
    constant: float

    def __call__(self, values: F64) -> F64:
        """Return the values (T,) at coordinates (K, T)."""
        return np.asarray(self.slopes) @ values[: len(self.slopes)] + self.constant


@dataclass(frozen=True)
class Polynomial:
    """A polynomial of one coordinate, with the coefficient of the highest power first."""

    coefficients: tuple[float, ...]

    def __call__(self, values: F64) -> F64:
        """Return the values (T,) at coordinates (1, T)."""
        found: F64 = np.polyval(np.asarray(self.coefficients), values[0])
        return found


@dataclass(frozen=True)
class Multiple:
    """A function multiplied by a constant."""

    function: Function
    factor: float

    def __call__(self, values: F64) -> F64:
        """Return the values (T,) at coordinates (K, T)."""
        return self.factor * self.function(values)


@dataclass(frozen=True)
class Spline:
    """A piecewise cubic polynomial of one coordinate, linear beyond its ends.

    Attributes
    ----------
    x : float64 array (N,)
        The knots, ascending.
    y, slope : float64 array (N,)
        Value and first derivative at each knot.
    """

    x: F64
    y: F64
    slope: F64

    def __call__(self, values: F64) -> F64:
        """Return the values (T,) at coordinates (1, T)."""
        at = values[0]
        i = np.clip(np.searchsorted(self.x, at, side="right") - 1, 0, len(self.x) - 2)
        step = self.x[i + 1] - self.x[i]
        u = (at - self.x[i]) / step
        inside = (
            self.y[i] * (1 + 2 * u) * (1 - u) ** 2
            + self.y[i + 1] * u**2 * (3 - 2 * u)
            + step * (self.slope[i] * u * (1 - u) ** 2 - self.slope[i + 1] * u**2 * (1 - u))
        )  # Hermite's form
        before = self.y[0] + (at - self.x[0]) * self.slope[0]
        after = self.y[-1] + (at - self.x[-1]) * self.slope[-1]
        found: F64 = np.where(at < self.x[0], before, np.where(at > self.x[-1], after, inside))
        return found


def spline(x: F64, y: F64) -> Spline:
    """Return a cubic spline through points, with the third derivatives at its ends from the four outermost points.

    The spline is that of SIMM and OpenSim (Forsythe, Malcolm and Moler, Computer Methods for Mathematical Computations,
    1977, Section 4.4). With two points it is a line, with three a parabola.

    Parameters
    ----------
    x : float64 array (N,)
        The knots, ascending.
    y : float64 array (N,)
        The values.

    Raises
    ------
    ParameterError
        There are fewer than two knots, or they do not ascend.
    """
    n = len(x)
    if n < 2 or len(y) != n or not (np.diff(x) > 0).all():
        raise ParameterError("x", "at least two knots that ascend, one for each value", x.tolist())
    h, rise = np.diff(x), np.diff(y) / np.diff(x)
    if n == 2:
        return Spline(x, y, np.repeat(rise, 2))
    system, right = np.zeros((n, n)), np.zeros(n)
    inner = np.arange(1, n - 1)
    system[inner, inner - 1], system[inner, inner + 1] = h[:-1], h[1:]
    system[inner, inner] = 2 * (h[:-1] + h[1:])
    right[1:-1] = np.diff(rise)
    system[0, :2], system[-1, -2:] = (-h[0], h[0]), (h[-1], -h[-1])
    if n > 3:
        second = np.diff(rise) / (x[2:] - x[:-2])
        third = np.diff(second) / (x[3:] - x[:-3])
        right[0], right[-1] = h[0] ** 2 * third[0], -(h[-1] ** 2) * third[-1]
    sixth = np.linalg.solve(system, right)  # the second derivatives at the knots, divided by six
    slope = np.append(rise - h * (2 * sixth[:-1] + sixth[1:]), rise[-1] + h[-1] * (sixth[-2] + 2 * sixth[-1]))
    return Spline(x, y, slope)


@dataclass(frozen=True)
class AxisMotion:
    """A rotation about an axis, or a translation along an axis, as a function of one or several coordinates.

    Attributes
    ----------
    axis : float64 array (3,)
        The axis in the joint's frame in the parent.
    coordinates : tuple of int
        Indices of the coordinates.
    function : Function
        The angle in radians, or the displacement in metres.
    """

    axis: F64
    coordinates: tuple[int, ...]
    function: Function


@dataclass(frozen=True)
class Placed:
    """The rotation (3, 3) and the origin (3,), in metres, of a frame in another frame."""

    rotation: F64
    origin: F64


@dataclass(frozen=True)
class Joint:
    """A joint between two bodies: its frame in the parent and in the child, and the motion between these frames.

    Attributes
    ----------
    parent : int
        Index of the joint whose child body is the parent body of this joint, smaller than this joint's index; −1 for
        the ground.
    in_parent, in_child : Placed
        The joint's frame in the parent body and in the child body.
    turns : tuple of AxisMotion
        Rotations in order; each is about an axis that the previous rotations have rotated.
    shifts : tuple of AxisMotion
        Translations along axes of the frame in the parent.
    """

    parent: int
    in_parent: Placed
    in_child: Placed
    turns: tuple[AxisMotion, ...]
    shifts: tuple[AxisMotion, ...]


def euler_xyz(angles: F64) -> F64:
    """Return the rotation (3, 3) by angles (3,) in radians about x, then the rotated y, then the rotated z axis."""
    about = axisangle.matrices(np.diag(angles))
    found: F64 = about[0] @ about[1] @ about[2]
    return found


def forward(joints: Sequence[Joint], coordinates: F64) -> tuple[list[F64], list[F64]]:
    """Compute the rotations and origins of the child bodies of joints.

    Parameters
    ----------
    joints : sequence of Joint
        The J joints, each after the joint of its parent body.
    coordinates : float64 array (Q, T)
        Generalised coordinates, in radians and metres.

    Returns
    -------
    rotations : list of float64 array (T, 3, 3)
        The rotation of each joint's child body relative to the ground.
    origins : list of float64 array (T, 3)
        The origin of each child body, in metres.

    Raises
    ------
    ParameterError
        A parent does not come before its child.
    """
    if any(not -1 <= joint.parent < i for i, joint in enumerate(joints)):
        raise ParameterError("joints", "each after the one of its parent", [joint.parent for joint in joints])
    frames = coordinates.shape[1]
    rotations: list[F64] = []
    origins: list[F64] = []
    for joint in joints:
        turned, at = np.broadcast_to(np.eye(3), (frames, 3, 3)), np.zeros((frames, 3))
        if joint.parent >= 0:
            turned, at = rotations[joint.parent], origins[joint.parent]
        at = at + turned @ joint.in_parent.origin
        turned = turned @ joint.in_parent.rotation
        shift = np.zeros((frames, 3))
        for motion in joint.shifts:
            shift += motion.function(coordinates[list(motion.coordinates)])[:, None] * motion.axis
        at = at + np.einsum("tab,tb->ta", turned, shift)
        for motion in joint.turns:
            angle = motion.function(coordinates[list(motion.coordinates)])
            turned = turned @ axisangle.matrices(angle[:, None] * motion.axis / np.linalg.norm(motion.axis))
        turned = turned @ joint.in_child.rotation.T
        rotations.append(turned)
        origins.append(at - turned @ joint.in_child.origin)
    return rotations, origins
