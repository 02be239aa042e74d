"""This module finds the frames that cause the frame-wise measures of `ops.body.motion_faults`."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from kinedex.ops.arrays import F64, Bool
from kinedex.ops.body.motion_faults import (
    CONTACT_M,
    CONTACT_M_S,
    FLOOR_SHARE,
    LOCKED,
    MOVES_M_S,
    SIDEWAYS,
)

SPIKE = math.radians(40.0)
"""Angle in radians; a limb that turns away by more than this in one frame and back in the next is marked."""

SKATE_M_S = 1.2
"""Speed in m/s; a foot in contact with the ground that slides faster is marked."""

SUNK_M = 0.1
"""Depth in metres; a foot farther below the usual height of the lowest joint is marked."""

STUCK_S = 0.2
"""Time in seconds; a joint whose position stays identical for so long, while its limb moves, is marked."""

_FEET = (("ltoes", "lankle"), ("rtoes", "rankle"))
_LEGS = (("lhip", "lknee", "lankle"), ("rhip", "rknee", "rankle"))
_ARMS = (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"))


@dataclass(frozen=True)
class FaultMarks:
    """The frames of a motion that show one kind of fault.

    Attributes
    ----------
    figure : str
        The measure of a take that these frames affect, as in `ops.body.motion_faults.MotionFaults`.
    name, meaning : str
        A title, and what is marked.
    frames : bool array (T,)
        The frames.
    """

    figure: str
    name: str
    meaning: str
    frames: Bool


def fault_marks(
    positions: npt.NDArray[np.floating], joints: tuple[str, ...], rate_hz: float, valid: Bool
) -> list[FaultMarks]:
    """Find the frames of a motion that show its faults.

    Parameters
    ----------
    positions : float array (T, J, 3)
        Joint positions in metres, Y up; NaN for an unknown joint.
    joints : tuple of str
        The names of the J joints.
    rate_hz : float
        Frames per second.
    valid : bool array (T,)
        The frames that count.

    Returns
    -------
    list of FaultMarks
        Spikes, knees that bend forwards, feet that slide and feet that sink, and joints that stop, in this order.
    """
    places = np.where(valid[:, None, None], np.asarray(positions, np.float64), np.nan)
    at = {joint: places[:, number] for number, joint in enumerate(joints)}
    none = np.zeros(len(places), np.bool_)
    spikes, stuck, knees, slides, sunk = (none.copy() for _ in range(5))
    if len(places) >= 4 and valid.any():
        with np.errstate(invalid="ignore", divide="ignore"):
            for side in "lr":
                for begin, end in (*_ARMS, ("knee", "ankle")):
                    if side + begin in at and side + end in at:
                        spikes |= _spikes(at[side + end] - at[side + begin])
                        if end != "ankle":  # an ankle may rest while its limb moves
                            stuck |= _stuck(at[side + begin], at[side + end], rate_hz)
            knees = _knees(at, none)
            slides, sunk = _ground(at, none, rate_hz)
    return [
        FaultMarks("spike_deg", "Spikes", "a limb turns by more than 40° in one frame and back in the next", spikes),
        FaultMarks("knee_forwards_share", "Knees forwards", "a knee bends forwards by more than 12°", knees),
        FaultMarks("foot_skate_m_s", "Sliding feet", "a foot in contact slides faster than 1.2 m/s", slides),
        FaultMarks("penetration_m", "Sunk feet", "a foot is 10 cm below the usual height of the lowest joint", sunk),
        FaultMarks("stuck_share", "Stuck joints", "a joint keeps its place while its limb moves", stuck),
    ]  # fmt: skip


def _angles(one: F64, other: F64) -> F64:
    """Return the angles between vectors (…, 3) in radians."""
    across = np.linalg.norm(np.cross(one, other), axis=-1)
    found: F64 = np.arctan2(across, (one * other).sum(axis=-1))
    return found


def _spikes(bone: F64) -> Bool:
    """Return the frames in which a bone (T, 3) points elsewhere than in the frames before and after."""
    step, over = _angles(bone[:-1], bone[1:]), _angles(bone[:-2], bone[2:])
    found = np.zeros(len(bone), np.bool_)
    found[1:-1] = 0.5 * (step[:-1] + step[1:] - over) > SPIKE
    return found


def _stuck(begin: F64, end: F64, rate_hz: float) -> Bool:
    """Return the frames in which one end of a limb keeps its position for `STUCK_S` while its other end moves."""
    still = (end[1:] == end[:-1]).all(axis=1) & (np.linalg.norm(np.diff(begin, axis=0), axis=1) * rate_hz > MOVES_M_S)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], still, [False])).astype(np.int8))).reshape(-1, 2)
    found = np.zeros(len(end), np.bool_)
    for start, stop in edges.tolist():
        if stop - start >= STUCK_S * rate_hz:
            found[start : stop + 1] = True
    return found


def _knees(at: dict[str, F64], none: Bool) -> Bool:
    """Return the frames in which a knee bends forwards, by the axis of its bend and the line through the hips."""
    if not all(joint in at for leg in _LEGS for joint in leg):
        return none
    left = at["lhip"] - at["rhip"]
    found = none.copy()
    for hip, knee, ankle in _LEGS:
        thigh, shank = at[knee] - at[hip], at[ankle] - at[knee]
        turn = np.cross(thigh, shank)
        size = np.linalg.norm(turn, axis=1)
        bent = np.arctan2(size, (thigh * shank).sum(axis=1)) > LOCKED
        found |= bent & ((turn * left).sum(axis=1) < -SIDEWAYS * size * np.linalg.norm(left, axis=1))
    return found


def _ground(at: dict[str, F64], none: Bool, rate_hz: float) -> tuple[Bool, Bool]:
    """Return the frames in which a foot slides, and the frames in which a foot is below the floor."""
    lowest = np.fmin.reduce([place[:, 1] for place in at.values()])
    if not np.isfinite(lowest).any():
        return none, none
    floor = _quantile(lowest)
    slides, sunk = none.copy(), none.copy()
    for names in _FEET:
        foot = next((at[name] for name in names if name in at and np.isfinite(at[name]).any()), None)
        if foot is None:
            continue
        height = foot[:, 1]
        sunk |= height < floor - SUNK_M
        steps = np.diff(foot, axis=0) * rate_hz
        contact = np.maximum(height[1:], height[:-1]) <= _quantile(height) + CONTACT_M
        contact &= np.abs(steps[:, 1]) <= CONTACT_M_S
        slides[1:] |= contact & (np.hypot(steps[:, 0], steps[:, 2]) > SKATE_M_S)
    return slides, sunk


def _quantile(values: F64) -> float:
    """Return the `FLOOR_SHARE` quantile of the finite values."""
    known = np.sort(values[np.isfinite(values)])
    return float(known[int(FLOOR_SHARE * (len(known) - 1))])
