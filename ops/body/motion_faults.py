"""This module measures faults of a motion, such as feet that slide or sink, limbs that jump and joints that stop.

These measures, which animators and biomechanists use, assume that a take was read correctly; `ops.body.plausibility`
has measures that reveal a file that was read wrongly. All frames are measured, except pairs and triples that contain an
invalid frame. `fault_marks` finds the frames that cause high values.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from numba import njit

from kinedex.ops.arrays import F64, I64, Bool
from kinedex.ops.order_statistics import order_statistic

UNKNOWN = float("nan")

CONTACT_M = 0.03
"""Height in metres above a foot's usual lowest height (its 5th percentile) up to which the foot is in contact."""

CONTACT_M_S = 0.25
"""Vertical speed in m/s below which a foot can be in contact with the ground."""

GROUND_M = 0.1
"""Height in metres above the floor up to which a joint touches the ground."""

FLOOR_SHARE = 0.05
"""Quantile of heights that is used as the usual lowest height, so that a few outliers do not affect it."""

LOCKED = math.radians(12.0)
"""Angle in radians; a knee bends forwards if its shank points forwards of the thigh by more than this."""

SIDEWAYS = 0.7
"""Cosine between a knee's axis and the line through the hips; at or below it, a bend is sideways and not counted.
"""

LAG_S = 1.0 / 30.0
"""Time step in seconds of the jitter measure, long enough to exclude noise between successive frames of fast cameras.
"""

MOVES_M_S = 0.03
"""Speed in m/s above which a joint moves."""

SAMPLED = 200
"""Minimum number of frames, spread over the take, in which knees are measured."""

_FEET = (("ltoes", "lankle"), ("rtoes", "rankle"))
_LEGS = (("lhip", "lknee", "lankle"), ("rhip", "rknee", "rankle"))
_LIMBS = tuple((s + a, s + b) for s in "lr" for a, b in (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"),
               ("elbow", "wrist")))  # fmt: skip

SPIKE = math.radians(40.0)
"""Angle in radians; a limb that rotates by more than this in one frame and back in the next is marked."""

SKATE_M_S = 1.2
"""Speed in m/s; a foot in contact with the ground that slides faster is marked."""

SUNK_M = 0.1
"""Depth in metres; a foot farther below the usual height of the lowest joint is marked."""

STUCK_S = 0.2
"""Time in seconds; a joint whose position stays identical for so long, while its limb moves, is marked."""

_ARMS = (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"))


@dataclass(frozen=True)
class MotionFaults:
    """The measures of one take; a measure whose joints are missing is NaN.

    Attributes
    ----------
    foot_skate_m_s : float
        The distance in metres that feet slide over the ground per second of contact.
    penetration_m : float
        The depth of the lowest foot joint below the floor of the take, in metres.
    flight_s : float
        The longest time in which no joint touches the ground, in seconds.
    knee_forwards_share : float
        The fraction of frames in which a knee bends forwards.
    spike_deg : float
        The largest angle by which a limb turns from one frame to the next and back in the frame after that.
    jitter_m_s3 : float
        The median magnitude of the third derivative of joint positions, over time steps of `LAG_S`.
    stuck_share : float
        The largest fraction of steps in which a knee, elbow or wrist keeps exactly the same position, while the other
        end of its limb moves faster than `MOVES_M_S`.
    invalid_share : float
        The fraction of invalid frames.
    """

    foot_skate_m_s: float = UNKNOWN
    penetration_m: float = UNKNOWN
    flight_s: float = UNKNOWN
    knee_forwards_share: float = UNKNOWN
    spike_deg: float = UNKNOWN
    jitter_m_s3: float = UNKNOWN
    stuck_share: float = UNKNOWN
    invalid_share: float = UNKNOWN


def motion_faults(positions: F64, joints: tuple[str, ...], rate_hz: float, valid: Bool) -> MotionFaults:
    """Measure the faults of a motion.

    Parameters
    ----------
    positions : float64 array (J, 3, T)
        Joint positions in metres, Y up; NaN for an unknown joint.
    joints : tuple of str
        The names of the J joints.
    rate_hz : float
        Frames per second.
    valid : bool array (T,)
        The frames that count.
    """
    positions, rate_hz = np.ascontiguousarray(positions), float(rate_hz)
    lost = 1.0 - float(valid.mean()) if len(valid) else UNKNOWN
    if not valid.any() or positions.shape[2] < 4:
        return MotionFaults(invalid_share=lost)
    known = np.all(np.isfinite(positions[:, :, valid.argmax()]), axis=1)
    soles, limbs, above, legs = _parts(tuple(joints), tuple(known.tolist()))
    lag = max(1, round(rate_hz * LAG_S))
    slide, contact, penetration, flight = _ground(positions, valid, soles, rate_hz)
    return MotionFaults(
        foot_skate_m_s=slide / contact if contact >= LAG_S else UNKNOWN,
        penetration_m=penetration,
        flight_s=flight,
        knee_forwards_share=_knees_forwards(positions, valid, legs),
        spike_deg=math.degrees(_spike(positions, valid, limbs)),
        jitter_m_s3=_jitter(positions, valid, lag) * (rate_hz / lag) ** 3,
        stuck_share=_stuck(positions, valid, above, rate_hz),
        invalid_share=lost,
    )


@lru_cache(maxsize=16)  # The takes of an archive share a few skeletons.
def _parts(joints: tuple[str, ...], known: tuple[bool, ...]) -> tuple[I64, I64, I64, I64]:
    """Return indices of foot joints, of limbs, of limbs that do not end in an ankle, and of whole legs."""
    at = {joint: i for i, joint in enumerate(joints) if known[i]}
    feet = [[at[joint] for joint in foot if joint in at][:1] for foot in _FEET]
    limbs = [(a, b) for a, b in _LIMBS if a in at and b in at]
    legs = [[at[joint] for joint in leg] for leg in _LEGS if all(joint in at for joint in leg)]
    ends = [(at[a], at[b]) for a, b in limbs]
    above = [(at[a], at[b]) for a, b in limbs if not b.endswith("ankle")]  # an ankle may rest while its limb moves
    return (
        np.array([joint for foot in feet for joint in foot], np.int64),
        np.array(ends, np.int64).reshape(-1, 2),
        np.array(above, np.int64).reshape(-1, 2),
        np.array(legs, np.int64).reshape(-1, 3),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _quantile(values: F64, share: float) -> float:
    """Return a quantile of values, NaN if there are none; the values are reordered."""
    return order_statistic(values, int(share * (len(values) - 1))) if len(values) else np.nan


@njit(cache=True, nogil=True, error_model="numpy")
def _ground(positions: F64, valid: Bool, soles: I64, rate_hz: float) -> tuple[float, float, float, float]:
    """Return the metres that feet slide, the seconds of contact, the depth below the floor, and the longest flight (s).

    Feet slide in the frames in which they are in contact with the ground. In flight no joint touches the ground.
    """
    joints, _, frames = positions.shape
    lowest = np.full(frames, np.inf)
    for j in range(joints):
        for t in range(frames):
            lowest[t] = min(lowest[t], positions[j, 1, t])  # a comparison with NaN is false
    used = valid & (lowest < np.inf)
    floor = _quantile(lowest[used], FLOOR_SHARE)
    run, longest = 0, 0
    for t in range(frames):
        run = run + 1 if used[t] and lowest[t] > floor + GROUND_M else 0
        longest = max(longest, run)
    slide, contact, deepest = 0.0, 0.0, np.inf
    for i in range(len(soles)):
        foot = positions[soles[i]]
        level = _quantile(foot[1][valid], FLOOR_SHARE)
        deepest = min(deepest, foot[1][valid].min())
        for t in range(frames - 1):
            if not (valid[t] and valid[t + 1]) or max(foot[1, t], foot[1, t + 1]) > level + CONTACT_M:
                continue
            if abs(foot[1, t + 1] - foot[1, t]) * rate_hz > CONTACT_M_S:
                continue
            slide += math.hypot(foot[0, t + 1] - foot[0, t], foot[2, t + 1] - foot[2, t])
            contact += 1.0 / rate_hz
    sunk = max(floor - deepest, 0.0) if len(soles) else np.nan
    return slide, contact, sunk, longest / rate_hz if used.any() else np.nan


@njit(inline="always")
def _between(positions, a, b, t):  # type: ignore[no-untyped-def]
    # The components are returned as numbers, since an array of three would be allocated on the heap.
    return (
        positions[a, 0, t] - positions[b, 0, t],
        positions[a, 1, t] - positions[b, 1, t],
        positions[a, 2, t] - positions[b, 2, t],
    )


@njit(inline="always")
def _dot(a, b):  # type: ignore[no-untyped-def]
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True, nogil=True, error_model="numpy")
def _knees_forwards(positions: F64, valid: Bool, legs: I64) -> float:
    """Return the share of sampled frames in which a knee bends forwards; NaN if not both legs are known.

    The direction of the bend is judged by the line through the hips.
    """
    if len(legs) < 2:
        return np.nan
    counted, bent = 0, 0
    for t in range(0, positions.shape[2], max(1, positions.shape[2] // SAMPLED)):
        if not valid[t]:
            continue
        counted += 1
        left = _between(positions, legs[0, 0], legs[1, 0], t)
        for i in range(2):
            thigh = _between(positions, legs[i, 1], legs[i, 0], t)
            shank = _between(positions, legs[i, 2], legs[i, 1], t)
            turn = (
                thigh[1] * shank[2] - thigh[2] * shank[1],
                thigh[2] * shank[0] - thigh[0] * shank[2],
                thigh[0] * shank[1] - thigh[1] * shank[0],
            )
            size = math.sqrt(_dot(turn, turn))
            angle = math.atan2(size, _dot(thigh, shank))
            if angle > LOCKED and _dot(turn, left) < -SIDEWAYS * size * math.sqrt(_dot(left, left)):
                bent += 1
                break
    return bent / counted if counted else np.nan


@njit(cache=True, nogil=True, error_model="numpy")
def _spike(positions: F64, valid: Bool, limbs: I64) -> float:
    """Return the largest angle (radians) by which a limb turns away in one frame and back in the next."""
    frames = positions.shape[2]
    if not len(limbs) or frames < 3:
        return np.nan
    most = 0.0
    bone, step = np.empty((3, frames)), np.zeros(frames)
    x, y, z = bone[0], bone[1], bone[2]
    for i in range(len(limbs)):
        begin, end = positions[limbs[i, 0]], positions[limbs[i, 1]]
        for t in range(frames):
            dx, dy, dz = end[0, t] - begin[0, t], end[1, t] - begin[1, t], end[2, t] - begin[2, t]
            length = math.sqrt(dx**2 + dy**2 + dz**2)
            x[t], y[t], z[t] = dx / length, dy / length, dz / length
        for t in range(1, frames):
            dx, dy, dz = x[t - 1] - x[t], y[t - 1] - y[t], z[t - 1] - z[t]
            step[t] = math.sqrt(dx * dx + dy * dy + dz * dz)
        for t in range(1, frames - 1):
            # the result is at most the smaller of the two angles, and an angle at most π/2 times its chord
            if 1.6 * min(step[t], step[t + 1]) > most and valid[t - 1] and valid[t] and valid[t + 1]:
                around = _angle(step[t]) + _angle(step[t + 1]) - _angle(_chord(bone, t - 1, t + 1))
                most = max(most, 0.5 * around)
    return most


@njit(cache=True, nogil=True, error_model="numpy")
def _chord(bone: F64, one: int, other: int) -> float:
    """Return the distance between the tips of a unit vector in two frames."""
    dx, dy, dz = bone[0, one] - bone[0, other], bone[1, one] - bone[1, other], bone[2, one] - bone[2, other]
    return math.sqrt(dx * dx + dy * dy + dz * dz)


@njit(cache=True, nogil=True, error_model="numpy")
def _angle(chord: float) -> float:
    """Return the angle between two unit vectors whose tips are a chord apart."""
    return 2.0 * math.asin(min(1.0, 0.5 * chord))


@njit(cache=True, nogil=True, error_model="numpy")
def _jitter(positions: F64, valid: Bool, lag: int) -> float:
    """Return the median norm of the positions' third differences over a lag, from about 3,000 samples at most."""
    joints, _, frames = positions.shape
    stride = max(1, (frames - 3 * lag) * joints // 2000)
    found = np.empty(max((frames - 3 * lag) * joints // stride + 1, 1))
    count, place = 0, 0
    while place < (frames - 3 * lag) * joints:
        j, t = place % joints, place // joints
        place += stride
        if not (valid[t] and valid[t + lag] and valid[t + 2 * lag] and valid[t + 3 * lag]):
            continue
        square = 0.0
        for k in range(3):
            x = positions[j, k]
            square += (x[t + 3 * lag] - 3.0 * x[t + 2 * lag] + 3.0 * x[t + lag] - x[t]) ** 2
        if square == square:
            found[count] = math.sqrt(square)
            count += 1
    return _quantile(found[:count], 0.5)


@njit(cache=True, nogil=True, error_model="numpy")
def _stuck(positions: F64, valid: Bool, limbs: I64, rate_hz: float) -> float:
    """Return the largest fraction of steps in which a limb's end keeps its position while its start moves."""
    frames = positions.shape[2]
    steps = (valid[1:] & valid[:-1]).sum()
    if not len(limbs) or not steps:
        return np.nan
    most, least = 0, (MOVES_M_S / rate_hz) ** 2
    for i in range(len(limbs)):
        begin, end = positions[limbs[i, 0]], positions[limbs[i, 1]]
        stuck = 0
        for t in range(frames - 1):
            if not (valid[t] and valid[t + 1]):
                continue
            moved = 0.0
            for k in range(3):
                moved += (begin[k, t + 1] - begin[k, t]) ** 2
            still = end[0, t] == end[0, t + 1] and end[1, t] == end[1, t + 1] and end[2, t] == end[2, t + 1]
            stuck += still and moved > least
        most = max(most, stuck)
    return most / steps


@dataclass(frozen=True)
class FaultMarks:
    """The frames of a motion that show one kind of fault.

    Attributes
    ----------
    figure : str
        The measure of a take that these frames affect, as in `ops.body.motion_faults.MotionFaults`.
    name, meaning : str
        A title, and a description of the fault that is marked.
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
                            stuck |= _stuck_frames(at[side + begin], at[side + end], rate_hz)
            knees = _knees(at, none)
            slides, sunk = _ground_frames(at, none, rate_hz)
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
    """Return the frames in which a bone (T, 3) turns away by more than `SPIKE` and turns back in the next frame."""
    step, over = _angles(bone[:-1], bone[1:]), _angles(bone[:-2], bone[2:])
    found = np.zeros(len(bone), np.bool_)
    found[1:-1] = 0.5 * (step[:-1] + step[1:] - over) > SPIKE
    return found


def _stuck_frames(begin: F64, end: F64, rate_hz: float) -> Bool:
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


def _ground_frames(at: dict[str, F64], none: Bool, rate_hz: float) -> tuple[Bool, Bool]:
    """Return the frames in which a foot slides, and the frames in which a foot is below the floor."""
    lowest = np.fmin.reduce([place[:, 1] for place in at.values()])
    if not np.isfinite(lowest).any():
        return none, none
    floor = _floor_height(lowest)
    slides, sunk = none.copy(), none.copy()
    for names in _FEET:
        foot = next((at[name] for name in names if name in at and np.isfinite(at[name]).any()), None)
        if foot is None:
            continue
        height = foot[:, 1]
        sunk |= height < floor - SUNK_M
        steps = np.diff(foot, axis=0) * rate_hz
        contact = np.maximum(height[1:], height[:-1]) <= _floor_height(height) + CONTACT_M
        contact &= np.abs(steps[:, 1]) <= CONTACT_M_S
        slides[1:] |= contact & (np.hypot(steps[:, 0], steps[:, 2]) > SKATE_M_S)
    return slides, sunk


def _floor_height(values: F64) -> float:
    """Return the `FLOOR_SHARE` quantile of the finite values."""
    known = np.sort(values[np.isfinite(values)])
    return float(known[int(FLOOR_SHARE * (len(known) - 1))])
