"""This module predicts the pose of the next frame by extrapolating the last movement, as the start of a fit."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64, I64
from kinedex.ops.body.joint_tree import PARENTS

SHARE = 0.7
"""Share of the last movement that is extrapolated, chosen on clips of two actors with two cameras."""


def predicted_pose(pose: F64, before: F64, share: float = SHARE) -> F64:
    """Return the extrapolated pose of the next frame; its bones keep their lengths.

    The root continues by a fraction of its last movement, and each bone's direction by that share of its last change.

    Parameters
    ----------
    pose, before : float64 array (24, 3)
        The last pose and the one before it, on the same bones, in metres.
    share : float, optional
        The fraction.
    """
    predicted = np.empty_like(pose)
    _predict(pose, before, share, PARENTS, predicted)
    return predicted


@njit(cache=True, nogil=True)
def _predict(pose: F64, before: F64, share: float, parents: I64, predicted: F64) -> None:
    for j in range(len(parents)):
        parent = parents[j]
        if parent < 0:
            for axis in range(3):
                predicted[j, axis] = pose[j, axis] + share * (pose[j, axis] - before[j, axis])
            continue
        square, turned = 0.0, 0.0
        for axis in range(3):
            bone = pose[j, axis] - pose[parent, axis]
            moved = bone + share * (bone - before[j, axis] + before[parent, axis])
            predicted[j, axis] = moved
            square += bone * bone
            turned += moved * moved
        scale = math.sqrt(square / turned) if turned > 0.0 else 0.0
        for axis in range(3):
            predicted[j, axis] = predicted[parent, axis] + scale * predicted[j, axis]
