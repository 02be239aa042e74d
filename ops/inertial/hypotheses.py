"""This module finds robust initial values of a calibration, as the best of many hypotheses from few frames each.

A *unit* consists of all frames of a limb with the same mount and the same inertial world: those of one recording, or of
several recordings that share an inertial world. Hypotheses are compared on at most `MAX_FRAMES` frames of each unit,
spread evenly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64, I64
from kinedex.ops.copies import copy_row
from kinedex.ops.inertial.rotations import (
    Z_TO_Y,
    conjugate,
    exp,
    from_matrix,
    inverse_product,
    log,
    multiply,
    product,
    row,
)

MAX_FRAMES, TRIPLES = 300, 300
MIN_CROSS = 0.02
"""Length of the cross product of two rotation vectors above which their axes count as different."""

BEST = 5
"""The number of hypotheses of each unit that are compared over all units with the same inertial world."""

EVERY = 6
"""Interval of frames: every sixth of the compared frames gives a hypothesis of the mount."""

CLIP_DEG = 15.0
"""Error in degrees at which errors are clipped, so that all wrong frames have the same cost."""

UPRIGHT = np.stack([Z_TO_Y, multiply(Z_TO_Y, np.array([0.0, 0.0, 0.0, 1.0]))])
"""Basis (2, 4) of the quaternions that map Z to Y, which q_G is one of if the vertical is known."""


class Unit(NamedTuple):
    """The frames of a limb whose sensor has one mount and one inertial world.

    Attributes
    ----------
    sensor, track : float64 array (n, 4)
        Orientations of the sensor and of the limb, all of them known.
    mount, world : int
        The indices of its q_L and its q_G among those of the calibration.
    """

    sensor: F64
    track: F64
    mount: int
    world: int

    def spread(self) -> Unit:
        """Return the unit with at most `MAX_FRAMES` frames, spread evenly."""
        count = len(self.sensor)
        if count <= MAX_FRAMES:
            return self
        frames = np.linspace(0, count - 1, MAX_FRAMES).astype(np.int64)
        return self._replace(sensor=self.sensor[frames], track=self.track[frames])


def upright(q: F64) -> F64:
    """Return the nearest rotations (..., 4) that map Z to Y; if all are equally near, an arbitrary one of them."""
    shares = q @ UPRIGHT.T
    length = np.sqrt(np.einsum("...a,...a->...", shares, shares))[..., None]
    lost = length < 1e-9
    shares = np.where(lost, [1.0, 0.0], shares / np.where(lost, 1.0, length))
    return shares @ UPRIGHT


def world_guesses(unit: Unit, vertical_known: bool, seed: int) -> F64:
    """Return hypotheses of q_G from a unit: the best from triples of frames, and rotations about a known vertical.

    Parameters
    ----------
    unit : Unit
        Spread frames.
    vertical_known : bool
        True if Z of the inertial world is Y of the take's.
    seed : int
        The seed of the random triples.

    Returns
    -------
    float64 array (C, 4)
        The hypotheses; C is 0 if the vertical is unknown and no triple has rotations about two axes.
    """
    s, t, u = np.random.default_rng(seed).integers(0, len(unit.sensor), (3, TRIPLES))
    own, other = _turns(unit.sensor, s, t, u), _turns(unit.track, s, t, u)
    apart = np.linalg.norm(np.cross(other[0], other[1]), axis=1) >= MIN_CROSS
    guesses = np.empty((0, 4))
    if apart.any():
        s = s[apart]
        mounts = _alignment(own[:, apart], other[:, apart])
        worlds = multiply(multiply(unit.track[s], mounts), conjugate(unit.sensor[s]))
        if vertical_known:
            worlds = upright(worlds)
            mounts = multiply(conjugate(unit.track[s]), multiply(worlds, unit.sensor[s]))
        costs = np.empty(len(worlds))
        _pair_costs(unit.sensor, unit.track, worlds, mounts, costs)
        guesses = worlds[np.argsort(costs, kind="stable")[:BEST]]
    if vertical_known:
        rotations = exp(np.arange(72)[:, None] * np.array([0.0, 0.0, math.radians(5.0)]))
        guesses = np.concatenate([guesses, multiply(Z_TO_Y, rotations)])
    return guesses


def _turns(stream: F64, s: I64, t: I64, u: I64) -> F64:
    """Return the rotation vectors (2, H, 3) from frames s to frames t and u, in local axes."""
    start = conjugate(stream[s])
    return np.stack([log(multiply(start, stream[t])), log(multiply(start, stream[u]))])


def _alignment(own: F64, other: F64) -> F64:
    """Return the proper rotations (H, 4) that best align pairs of vectors (2, H, 3) with others."""
    left, _, right = np.linalg.svd(np.einsum("pha,phb->hab", other, own))
    left[:, :, 2] *= np.sign(np.linalg.det(left @ right))[:, None]
    return from_matrix(left @ right)


def best_world(
    units: Sequence[Unit], frames: Sequence[int], guesses: F64, held: Sequence[F64 | None]
) -> tuple[F64, F64, float]:
    """Choose the best of several hypotheses of q_G over all units that share it.

    Parameters
    ----------
    units : sequence of Unit
        Spread frames.
    frames : sequence of int
        The number of all frames of each unit, by which its cost is multiplied.
    guesses : float64 array (C, 4)
        Hypotheses of q_G.
    held : sequence of (float64 array (4,) or None)
        The mount of each unit; None if it is not known.

    Returns
    -------
    tuple[float64 array (4,), float64 array (U, 4), float]
        The best q_G, the mount of each unit for this q_G, and the cost.
    """
    total = np.zeros(len(guesses))
    mounts = np.empty((len(units), len(guesses), 4))
    for i, unit in enumerate(units):
        costs = np.empty(len(guesses))
        own = held[i]
        if own is None:
            _mount_costs(unit.sensor, unit.track, guesses, mounts[i], costs)
        else:
            mounts[i] = own
            _pair_costs(unit.sensor, unit.track, guesses, mounts[i], costs)
        total += frames[i] * costs
    best = int(total.argmin())
    return guesses[best], mounts[:, best], float(total[best])


def worlds_of_mount(unit: Unit, mount: F64, vertical_known: bool) -> F64:
    """Return hypotheses (C, 4) of q_G from single frames of a unit whose mount is known."""
    some = slice(None, None, EVERY)
    worlds = multiply(multiply(unit.track[some], mount), conjugate(unit.sensor[some]))
    return upright(worlds) if vertical_known else worlds


@njit(cache=True, nogil=True, error_model="numpy")
def _pair_costs(sensor: F64, track: F64, worlds: F64, mounts: F64, costs: F64) -> None:
    """Compute the mean clipped error of each pair of q_G and q_L over all frames, in degrees."""
    degrees = 2.0 * 180.0 / math.pi
    near = math.cos(0.5 * CLIP_DEG * math.pi / 180.0)
    for h in range(len(worlds)):
        total = 0.0
        for k in range(len(sensor)):
            a = product(row(worlds, h), row(sensor, k))
            b = product(row(track, k), row(mounts, h))
            cosine = abs(a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3])
            total += CLIP_DEG if cosine <= near else degrees * math.acos(min(cosine, 1.0))
        costs[h] = total / len(sensor)


@njit(cache=True, nogil=True, error_model="numpy")
def _mount_costs(sensor: F64, track: F64, worlds: F64, mounts: F64, costs: F64) -> None:
    """Find for each q_G the single-frame mount that has the smallest mean clipped distance to those of all frames."""
    degrees = 2.0 * 180.0 / math.pi
    near = math.cos(0.5 * CLIP_DEG * math.pi / 180.0)
    count = len(sensor)
    local = np.empty((count, 4))
    for h in range(len(worlds)):
        for k in range(count):
            v = inverse_product(row(track, k), product(row(worlds, h), row(sensor, k)))
            local[k, 0], local[k, 1], local[k, 2], local[k, 3] = v
        least = np.inf
        for i in range(0, count, EVERY):
            total = 0.0
            for k in range(count):
                cosine = abs(
                    local[i, 0] * local[k, 0]
                    + local[i, 1] * local[k, 1]
                    + local[i, 2] * local[k, 2]
                    + local[i, 3] * local[k, 3]
                )
                total += CLIP_DEG if cosine <= near else degrees * math.acos(min(cosine, 1.0))
                if total >= least:
                    break
            if total < least:
                least = total
                copy_row(mounts[h], local[i])
        costs[h] = least / count
