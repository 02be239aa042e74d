"""This module injects simulated tracking errors into limb orientations, and simulates annotators who mark them.

Five kinds are equally likely: `drift` (a rotation that grows linearly to 60 to 140 degrees about a random axis),
`subtle` (to 25 to 60 degrees), `twist` (60 to 180 degrees about the long axis, in and out within 0.1 s), `swap` (the
limb of the other side) and `freeze` (the orientation of the first frame).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.ops.errors import ParameterError
from kinedex.ops.inertial.rotations import distance_deg, exp, multiply

KINDS = ("drift", "subtle", "twist", "swap", "freeze")

DRIFT_DEG, SUBTLE_DEG, TWIST_DEG = (60.0, 140.0), (25.0, 60.0), (60.0, 180.0)
TWIST_S = 0.1
FIRST_S, LENGTH_S, BETWEEN_S = (0.5, 2.5), (0.5, 3.0), (2.0, 6.0)
"""Ranges in seconds of the time before the first error, of the length of an error, and of the time between errors."""

LABEL_DEG = 20.0
"""Error in degrees from which frames are labelled as wrong."""

THRESHOLD_DEG, ONSET_S, MISSES = (15.0, 30.0), 0.2, 0.05
"""Range of the simulated annotators' thresholds in degrees, standard deviation of their onsets and ends in seconds, and
the fraction of errors that they miss.
"""


@dataclass(frozen=True)
class InjectedError:
    """An injected error in the frames [start, stop) of a limb.

    Attributes
    ----------
    kind : str
        One of `KINDS`.
    start, stop : int
        The half-open range of frames.
    degrees : float
        The largest angle of the error; NaN if the angle follows from the motion (swap, freeze).
    """

    kind: str
    start: int
    stop: int
    degrees: float


def error_times(frames: int, rate_hz: float, random: np.random.Generator) -> list[tuple[int, int]]:
    """Draw the frames [start, stop) of the errors of a limb.

    Parameters
    ----------
    frames : int
        Frames of the take.
    rate_hz : float
        Frames per second.
    random : Generator
        Random numbers.
    """
    if rate_hz <= 0:
        raise ParameterError("rate_hz", "positive", rate_hz)
    found = []
    start = random.uniform(*FIRST_S)
    while round(start * rate_hz) < frames:
        stop = start + random.uniform(*LENGTH_S)
        edges = round(start * rate_hz), min(round(stop * rate_hz), frames)
        if edges[1] > edges[0]:
            found.append(edges)
        start = stop + random.uniform(*BETWEEN_S)
    return found


def inject(
    orientation: F64, rate_hz: float, axis: F64, random: np.random.Generator, other_side: F64 | None = None
) -> tuple[F64, list[InjectedError]]:
    """Inject errors into the orientations of a limb.

    Parameters
    ----------
    orientation : float64 array (T, 4)
        Unit quaternions w x y z, segment → world; unknown quaternions are NaN, and remain NaN.
    rate_hz : float
        Frames per second.
    axis : float64 array (3,)
        The limb's long axis in its own frame, a unit vector.
    random : Generator
        Random numbers; the same state gives the same errors.
    other_side : float64 array (T, 4), optional
        Orientations of the limb on the other side in this limb's frame, see `as_other_side`; without them, no `swap`
        errors are injected.

    Returns
    -------
    broken : float64 array (T, 4)
        The orientations with errors.
    errors : list of InjectedError
        The errors in order of time.
    """
    if orientation.ndim != 2 or orientation.shape[1] != 4:
        raise ParameterError("orientation", "of shape (frames, 4)", orientation.shape)
    broken = orientation.copy()
    kinds = [kind for kind in KINDS if kind != "swap" or other_side is not None]
    errors = []
    for start, stop in error_times(len(orientation), rate_hz, random):
        kind = kinds[int(random.integers(len(kinds)))]
        part = orientation[start:stop]
        degrees = float("nan")
        if kind == "swap":
            assert other_side is not None
            broken[start:stop] = np.where(np.isfinite(part), other_side[start:stop], np.nan)
        elif kind == "freeze":
            known = np.flatnonzero(np.isfinite(part).all(axis=1))
            if len(known):
                broken[start:stop] = np.where(np.isfinite(part), part[known[0]], np.nan)
        else:
            limits = {"drift": DRIFT_DEG, "subtle": SUBTLE_DEG, "twist": TWIST_DEG}[kind]
            degrees = float(random.uniform(*limits))
            about = axis if kind == "twist" else _random_axis(random)
            share = _plateau(stop - start, rate_hz) if kind == "twist" else np.linspace(0.0, 1.0, stop - start)
            broken[start:stop] = multiply(part, exp(np.radians(degrees) * share[:, None] * about))
        errors.append(InjectedError(kind, start, stop, degrees))
    return broken, errors


def as_other_side(other: F64, other_axis: F64, axis: F64) -> F64:
    """Return the orientations (T, 4) of the other side's limb in the frame of this one.

    The frames of two limbs may differ; they are aligned by the shortest rotation from this limb's long axis to the
    other's.

    Parameters
    ----------
    other : float64 array (T, 4)
        Orientations of the limb on the other side.
    other_axis, axis : float64 array (3,)
        The long axes of the other limb and of this limb, each in the frame of the limb.
    """
    cross, cosine = np.cross(axis, other_axis), float(axis @ other_axis)
    sine = float(np.linalg.norm(cross))
    if sine < 1e-9:
        away = np.eye(3)[int(np.argmin(np.abs(axis)))]
        about = np.cross(axis, away) / np.linalg.norm(np.cross(axis, away))
    else:
        about = cross / sine
    return multiply(other, exp(about * np.arctan2(sine, cosine)))


def labelled_runs(truth: F64, broken: F64, threshold_deg: float = LABEL_DEG) -> list[tuple[int, int]]:
    """Return the runs [start, stop) of frames whose orientation error is at least a threshold.

    Parameters
    ----------
    truth, broken : float64 array (T, 4)
        Orientations without and with errors.
    threshold_deg : float, optional
        The threshold in degrees.
    """
    known = np.isfinite(truth).all(axis=1) & np.isfinite(broken).all(axis=1)
    wrong = np.zeros(len(truth), np.bool_)
    wrong[known] = distance_deg(truth[known], broken[known]) >= threshold_deg
    edges = np.flatnonzero(np.diff(wrong, prepend=False, append=False)).reshape(-1, 2)
    return [(int(start), int(stop)) for start, stop in edges]


def annotate(
    truth: F64, broken: F64, rate_hz: float, threshold_deg: float, random: np.random.Generator
) -> list[tuple[int, int]]:
    """Return the runs [start, stop) that a simulated annotator marks.

    Parameters
    ----------
    truth, broken : float64 array (T, 4)
        Orientations without and with errors.
    rate_hz : float
        Frames per second.
    threshold_deg : float
        The smallest error that this annotator sees, in degrees.
    random : Generator
        Random numbers.
    """
    marked = []
    for start, stop in labelled_runs(truth, broken, threshold_deg):
        early, late = np.round(ONSET_S * rate_hz * random.standard_normal(2)).astype(int).tolist()
        missed = random.uniform() < MISSES
        start, stop = max(0, start + early), min(len(truth), stop + late)
        if not missed and stop > start:
            marked.append((start, stop))
    return _joined(marked)


def own_threshold(random: np.random.Generator) -> float:
    """Draw the threshold of an annotator in degrees."""
    return float(random.uniform(*THRESHOLD_DEG))


def _joined(runs: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return runs in order, with those that touch or overlap merged."""
    found: list[tuple[int, int]] = []
    for start, stop in sorted(runs):
        if found and start <= found[-1][1]:
            found[-1] = found[-1][0], max(stop, found[-1][1])
        else:
            found.append((start, stop))
    return found


def _random_axis(random: np.random.Generator) -> F64:
    vector = random.standard_normal(3)
    axis: F64 = vector / np.linalg.norm(vector)
    return axis


def _plateau(frames: int, rate_hz: float) -> F64:
    """Return weights (T,) that rise from 0 to 1 and fall back, each within 0.1 s."""
    ramp = np.arange(1, frames + 1) / max(1.0, TWIST_S * rate_hz)
    return np.minimum(np.minimum(ramp, ramp[::-1]), 1.0)
