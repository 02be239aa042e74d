"""This module joins a forward and a backward track into one, choosing one of them per frame by dynamic programming."""

from __future__ import annotations

import numpy as np

from kinedex.ops.arrays import F64, I64
from kinedex.ops.errors import ParameterError

CHANGE = 0.5
"""The cost of a change between the tracks, per metre of their mean distance in the frame after it."""

_NO_POSE = 1e6  # the cost of a track in a frame in which it has no pose


def choose_directions(forward: F64, backward: F64, costs: F64, change: float = CHANGE) -> I64:
    """Choose one of two tracks in every frame so that the sum of frame costs and change costs is minimal.

    Parameters
    ----------
    forward, backward : float64 array (T, 24, 3)
        The two tracks in metres, both in order of time; NaN where a track has no pose.
    costs : float64 array (T, 2)
        The cost of each in the vote (`FrameResult`); not used where it has no pose.
    change : float, optional
        The cost of a change per metre of the mean distance of the joints.

    Returns
    -------
    int64 array (T,)
        0 for forward, 1 for backward; the former at equal sums.

    Raises
    ------
    ParameterError
        The arrays have different lengths.
    """
    if forward.shape != backward.shape or costs.shape != (len(forward), 2):
        raise ParameterError("costs", f"an array ({len(forward)}, 2) beside two tracks of one length", costs.shape)
    frames = len(forward)
    apart = np.linalg.norm(forward - backward, axis=2).mean(axis=1) if frames else np.empty(0)
    steps = change * np.where(np.isfinite(apart), apart, 0.0)
    poses = np.stack([np.isfinite(track).all(axis=(1, 2)) for track in (forward, backward)], axis=1)
    own = np.where(poses & np.isfinite(costs), costs, _NO_POSE)
    came = np.zeros((frames, 2), np.int64)
    sums = np.zeros(2)
    for t in range(frames):
        if t:
            changed = sums[::-1] + steps[t]
            # at equal sums the current track is kept; at the last frame, forward is taken
            came[t] = np.where(changed < sums, [1, 0], [0, 1])
            sums = np.minimum(sums, changed)
        sums = sums + own[t]
    chosen: I64 = np.zeros(frames, np.int64)
    if frames:
        chosen[-1] = int(sums[1] < sums[0])
    for t in range(frames - 1, 0, -1):
        chosen[t - 1] = came[t, chosen[t]]
    return chosen
