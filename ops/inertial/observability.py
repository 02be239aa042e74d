"""This module measures how well a take's movements determine a sensor's mount, and describes poor ones in messages."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.ops.inertial.hypotheses import Unit
from kinedex.ops.inertial.rotations import conjugate, matrix, multiply

REFUSED, DOUBTFUL = 0.002, 0.02
"""Eigenvalues below which a mount is refused, and below which it is doubtful."""

TILTED_DEG, FEW = 3.0, 0.4
"""Tilt of q_G in degrees above which there is a warning, and fraction of fitting frames below which there is one."""


def least_eigenvalues(units: Sequence[Unit], worlds: F64, weights: Sequence[F64], vertical_known: bool) -> list[float]:
    """Compute the smallest eigenvalue of each mount's normal matrix, divided by the weights' sum.

    The unknowns are small rotations of q_L and of each q_G that its units have; the row of a frame is [R(q̄_T ∘ q_G),
    −1]. With one q_G it is 1 − |M|₂, M the weighted mean of R(q̄_T ∘ q_G); with the vertical known, 1 − |M z|.

    Parameters
    ----------
    units : sequence of Unit
        All frames of the calibration.
    worlds : float64 array (G, 4)
        q_G of each world.
    weights : sequence of float64 array (n,)
        The weights of each unit's frames.
    vertical_known : bool
        True if q_G can only rotate about Z.

    Returns
    -------
    list of float
        One value for each mount, 0 to 1; 0 where a direction is undetermined.
    """
    values = []
    for mount in range(1 + max(unit.mount for unit in units)):
        square, total = np.zeros((3, 3)), 0.0
        for unit, own in zip(units, weights, strict=True):
            if unit.mount != mount:
                continue
            mass = float(own.sum())
            mean = np.tensordot(own, matrix(multiply(conjugate(unit.track), worlds[unit.world])), 1)
            if vertical_known:
                mean = mean[:, 2:]
            square += mean @ mean.T / mass if mass > 0.0 else 0.0
            total += mass
        largest = float(np.linalg.eigvalsh(square)[-1]) / total if total > 0.0 else 1.0
        values.append(max(0.0, 1.0 - math.sqrt(max(largest, 0.0))))
    return values


def refusal(limb: str, value: float, level: float, vertical_known: bool, several: bool) -> str:
    """Return the reason to refuse a limb's mount, with remedies; empty if its movements suffice.

    Parameters
    ----------
    limb : str
        The limb's name.
    value : float
        The smallest eigenvalue of this mount, or a larger one of a limb that shares its q_G.
    level : float
        The smallest eigenvalue with the vertical known.
    vertical_known : bool
        True if the vertical is already known.
    several : bool
        True if several takes were already calibrated together.
    """
    if value >= REFUSED:
        return ""
    about = "the vertical only" if vertical_known or level < REFUSED else "one axis only"
    ways = ["use a take with other movements"]
    if not several:
        ways.append("`from: actor`")
    if not vertical_known and level >= REFUSED:
        ways.append("`vertical: known`")
    listed = ways[0] if len(ways) == 1 else f"{', '.join(ways[:-1])}, or {ways[-1]}"
    return f"{limb}: turns about {about}, the mount cannot be found; {listed}"


def warning(limb: str, value: float, tilt_deg: float, inliers: float) -> str:
    """Return the reasons why a limb's mount is doubtful; empty if it is not.

    Parameters
    ----------
    limb : str
        The limb's name.
    value : float
        The smallest eigenvalue of this mount, or a larger one of a limb that shares its q_G.
    tilt_deg : float
        The angle between the inertial world's vertical and the take's.
    inliers : float
        The fraction of frames with an error below 15°.
    """
    parts = []
    if value < DOUBTFUL:
        parts.append(f"hardly turns about a second axis (observability {value:.3f}), the mount is doubtful")
    if tilt_deg > TILTED_DEG:
        parts.append(f"the take's vertical is {tilt_deg:.1f}° off gravity's")
    if inliers < FEW:
        parts.append(f"only {inliers:.0%} of the frames fit: is it the sensor of this limb, and the offset right?")
    return f"{limb}: {'; '.join(parts)}" if parts else ""
