"""Pivots are joints about which all joints below them rotate, so that bones keep their lengths without joint angles."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from kinedex.ops.arrays import F64, I64, Bool
from kinedex.ops.body.joint_tree import PARENTS


class Pivots(NamedTuple):
    """The pivots of a body, as arrays for kernels.

    Attributes
    ----------
    joints : int64 array (P,)
        The joint of each pivot; the root first, parents before children.
    parents : int64 array (P,)
        The parent pivot of each; −1 for the root.
    starts : int64 array (P + 1,)
        The range of each pivot in `moved`.
    moved : int64 array
        The joints below each pivot.
    """

    joints: I64
    parents: I64
    starts: I64
    moved: I64


def pivots_of(joints: I64) -> Pivots:
    """Return the pivots at the given joints, as arrays for kernels.

    Parameters
    ----------
    joints : int64 array (P,)
        The joints: the root first, parents before children.
    """
    moved = moved_joints(joints)
    numbers = {int(joint): k for k, joint in enumerate(joints)}
    parents = np.array([numbers.get(int(PARENTS[joint]), -1) for joint in joints], np.int64)
    starts = np.concatenate([[0], np.cumsum(moved.sum(axis=1))]).astype(np.int64)
    return Pivots(joints, parents, starts, np.nonzero(moved)[1].astype(np.int64))


def moved_joints(joints: I64) -> Bool:
    """Return a mask (P, 24), True where a pivot moves a joint: for all joints below it, not for itself."""
    moved = np.zeros((len(joints), len(PARENTS)), np.bool_)
    for k, pivot in enumerate(joints):
        for joint in range(len(PARENTS)):
            above = PARENTS[joint]
            while above >= 0 and above != pivot:
                above = PARENTS[above]
            moved[k, joint] = above == pivot
    return moved


def turned_pose(joints: I64, pose: F64, turns: F64, shift: npt.ArrayLike = (0.0, 0.0, 0.0)) -> F64:
    """Return a pose after rotating every pivot, the deepest ones first, and then translating the whole body.

    Parameters
    ----------
    joints : int64 array (P,)
        The joints of the pivots.
    pose : float64 array (24, 3)
        Joints in metres.
    turns : float64 array (P, 3)
        Rotation vectors in radians.
    shift : float64 array (3,), optional
        Translation in metres.

    Returns
    -------
    float64 array (24, 3)
        The joints after the turns; bones keep their lengths.
    """
    turned = np.array(pose, np.float64)
    turn_pose(pivots_of(joints), turned, np.ascontiguousarray(turns, np.float64), np.asarray(shift, np.float64))
    return turned


@njit(cache=True, nogil=True, error_model="numpy")
def turn_pose(pivots: Pivots, pose: F64, turns: F64, shift: F64) -> None:
    """Rotate every pivot of a pose in place, the deepest ones first, and then translate it; see `turned_pose`."""
    for k in range(len(pivots.joints) - 1, -1, -1):
        a, b, c = turns[k, 0], turns[k, 1], turns[k, 2]
        angle = math.sqrt(a * a + b * b + c * c)
        if angle == 0.0:
            continue
        half = math.sin(0.5 * angle)
        one, two = math.sin(angle) / angle, 2.0 * half * half / (angle * angle)
        centre = pose[pivots.joints[k]]
        for i in range(pivots.starts[k], pivots.starts[k + 1]):
            place = pose[pivots.moved[i]]
            x, y, z = place[0] - centre[0], place[1] - centre[1], place[2] - centre[2]
            u, v, w = b * z - c * y, c * x - a * z, a * y - b * x
            place[0] += one * u + two * (b * w - c * v)
            place[1] += one * v + two * (c * u - a * w)
            place[2] += one * w + two * (a * v - b * u)
    for j in range(len(pose)):
        pose[j, 0] += shift[0]
        pose[j, 1] += shift[1]
        pose[j, 2] += shift[2]
