"""This module smooths poses over time by a low-pass filter that preserves bone lengths.

It also joins a forward and a backward track into a single track before smoothing, choosing one of them in every frame.
"""

from __future__ import annotations

import numpy as np

from kinedex.ops.arrays import F64, I64
from kinedex.ops.body.joint_tree import JOINTS, PARENTS
from kinedex.ops.errors import ParameterError

_REACH = 4.0  # standard deviations at which the Gaussian is truncated

CHANGE = 0.5
"""The cost of a change between the tracks, per metre of their mean distance in the frame after the change."""

_NO_POSE = 1e6  # the cost of a track in a frame in which it has no pose


def low_pass(poses: F64, rate_hz: float, cutoff_hz: float) -> F64:
    """Smooth poses by a Gaussian over time, with zero phase; each bone keeps its length in every frame.

    A motion of the frequency `cutoff_hz` keeps 1/√2 of its amplitude. Frames without a pose remain without a pose, and
    no smoothing takes place across such gaps.

    Parameters
    ----------
    poses : float64 array (T, 24, 3)
        Joints in metres; NaN in frames without a pose.
    rate_hz : float
        Frames per second.
    cutoff_hz : float
        The frequency in Hz that is damped to 1/√2.

    Returns
    -------
    float64 array (T, 24, 3)
        The smoothed poses.

    Raises
    ------
    ParameterError
        The frequency is not positive.
    """
    if not cutoff_hz > 0:
        raise ParameterError("cutoff_hz", "positive", cutoff_hz)
    sigma = np.sqrt(np.log(2.0)) / (2.0 * np.pi * cutoff_hz) * rate_hz
    reach = int(np.ceil(_REACH * sigma))
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    smooth = poses.copy()
    seen = np.isfinite(poses).all(axis=(1, 2))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], seen, [False]]).astype(np.int8)))
    for start, stop in edges.reshape(-1, 2).tolist():
        smooth[start:stop] = _smoothed(poses[start:stop], weights, reach)
    return _with_lengths(smooth, poses)


def _smoothed(poses: F64, weights: F64, reach: int) -> F64:
    """Return the weighted means over the neighbouring frames that have a pose."""
    total, mass = np.zeros_like(poses), np.zeros(len(poses))
    for shift, weight in zip(range(-reach, reach + 1), weights.tolist(), strict=True):
        low, high = max(0, -shift), min(len(poses), len(poses) - shift)
        if low < high:
            total[low:high] += weight * poses[low + shift : high + shift]
            mass[low:high] += weight
    means: F64 = total / mass[:, None, None]
    return means


def _with_lengths(smooth: F64, poses: F64) -> F64:
    """Return poses with the directions of the smoothed bones and the lengths of the original ones."""
    found = smooth.copy()
    for joint in range(len(JOINTS)):
        parent = int(PARENTS[joint])
        if parent < 0:
            continue
        along, own = smooth[:, joint] - smooth[:, parent], poses[:, joint] - poses[:, parent]
        lengths, wanted = np.linalg.norm(along, axis=1), np.linalg.norm(own, axis=1)
        scale = np.where(lengths > 1e-9, wanted / np.where(lengths > 1e-9, lengths, 1.0), 0.0)
        found[:, joint] = found[:, parent] + np.where(np.isnan(wanted), np.nan, scale)[:, None] * along
    return found


def choose_directions(forward: F64, backward: F64, costs: F64, change: float = CHANGE) -> I64:
    """Choose one of two tracks in every frame so that the sum of frame costs and change costs is minimal.

    Parameters
    ----------
    forward, backward : float64 array (T, 24, 3)
        The two tracks in metres, both in order of time; NaN where a track has no pose.
    costs : float64 array (T, 2)
        The cost of each track in the vote (`FrameResult`); ignored in frames in which the track has no pose.
    change : float, optional
        The cost of a change per metre of the mean distance of the joints.

    Returns
    -------
    int64 array (T,)
        0 for the forward track, which is preferred at equal sums, and 1 for the backward track.

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
