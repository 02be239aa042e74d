"""The example of the thesis's Figure 7.14: a wrong mapping between sensor and limb hides errors of a track."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from kinedex.ops.inertial.rotations import distance_deg, exp, multiply
from kinedex.reports.plots import line_path

F64 = npt.NDArray[np.float64]

FRAMES, HIDDEN = 640, 485
"""The number of frames, and the frame of the thesis whose error a wrong mapping hides."""

ERRORS = (((1.0, 2.0, 0.0), 50, 200, 70.0), ((0.0, -1.0, 1.0), 400, 600, 100.0))
"""Two errors of the track: axis, first and last frame, degrees at the last."""

MOUNT = np.radians(100.0 / math.hypot(0.69, 1.0, 0.69)) * np.array([-0.69, 1.0, 0.69])
"""A wrong mount, 100 degrees off, as a rotation vector; the thesis does not print its own."""

WORLD = np.radians([0.0, 50.0, 70.0])
"""A wrong rotation between the worlds of sensor and track, as a rotation vector."""

TOP_DEG = 180.0
"""The end of the axis of errors; y is 0 there."""


@dataclass(frozen=True)
class MappingCurve:
    """The errors of the frames by one mapping.

    Attributes
    ----------
    name : str
        The mapping.
    path : str
        SVG path over frames and degrees.
    correct : tuple of (float, float)
        The smallest and the largest error of correctly tracked frames.
    peak : float
        The error of frame 200, in which the track is off by 70 degrees.
    hidden : float
        The error of frame 485, in which the track is off by 42.5 degrees.
    """

    name: str
    path: str
    correct: tuple[float, float]
    peak: float
    hidden: float


def streams() -> tuple[F64, F64]:
    """Return orientations of a sensor and of a track with two errors, quaternions (640, 4)."""
    t = np.arange(float(FRAMES))
    sensor = exp(np.stack([0.9 * np.sin(t / 60), 0.7 * np.sin(t / 43 + 1), 1.1 * np.sin(t / 77 + 2)], axis=1))
    track = sensor.copy()
    for axis, start, last, degrees in ERRORS:
        frames = np.arange(start, last + 1)
        angle = math.radians(degrees) * (frames - start) / (last - start)
        track[frames] = multiply(sensor[frames], exp(angle[:, None] * np.array(axis) / np.linalg.norm(axis)))
    return sensor, track


def mapping_curves() -> list[MappingCurve]:
    """Return the errors by the right mapping, with one rotation wrong, and with both (thesis, Figure 7.14 a to c)."""
    sensor, track = streams()
    correct = np.ones(FRAMES, np.bool_)
    for _, start, last, _ in ERRORS:
        correct[start : last + 1] = False
    found = []
    for name, world, mount in (
        ("right mapping", 0.0 * WORLD, 0.0 * MOUNT),
        ("wrong mount", 0.0 * WORLD, MOUNT),
        ("wrong mount and world", WORLD, MOUNT),
    ):
        error = distance_deg(sensor, multiply(multiply(exp(world), track), exp(mount)))
        path = line_path([(float(frame), TOP_DEG - float(value)) for frame, value in enumerate(error)])
        own = error[correct]
        found.append(
            MappingCurve(name, path, (float(own.min()), float(own.max())), float(error[200]), float(error[HIDDEN]))
        )
    return found
