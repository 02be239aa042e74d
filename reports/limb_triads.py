"""Embed the axes of limbs in a page for its player: those of the take, and those that sensors measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
import numpy.typing as npt

from kinedex.ops.inertial.hand_eye import HeadingDrift
from kinedex.ops.inertial.rotations import conjugate, interpolate, multiply, rotate
from kinedex.pipelines.inertial.limb_motion import LimbMotion
from kinedex.pipelines.inertial.worn_sensors import Clock, WornSensor, WornTake
from kinedex.reports.motions import pack

F64 = npt.NDArray[np.float64]

LENGTH_M = 0.18
"""Length of an axis."""

MOST_BYTES = 6_000_000
"""The largest size of all axes of a page."""

POINTS = 7
"""Points of a limb: its middle, the tips of the take's axes x y z, and those of the sensor's."""


def packed_triads(
    take: WornTake,
    clocks: Mapping[tuple[int, str], Clock],
    calibrations: Sequence[Mapping[str, Any]],
    frames: int,
    rate_hz: float,
) -> dict[str, Any] | None:
    """Return the axes of the limbs of a take in every frame, as the player draws them.

    Parameters
    ----------
    take : WornTake
        The take with its limbs and sensors.
    clocks : dict of (int, str) to Clock
        Take id and recording → the clock.
    calibrations : sequence of dict
        The take's rows of `sensor_calibration`.
    frames : int
        The length of the take in analysis frames.
    rate_hz : float
        Analysis frames per second.

    Returns
    -------
    dict or None
        What the player reads; None where no sensor of the take is calibrated.
    """
    rows = {(row["recording"], row["sensor"]): row for row in calibrations if not row["left_out"]}
    points: dict[str, F64] = {}
    for sensor in take.sensors:
        row, clock = rows.get((sensor.recording, sensor.sensor)), clocks.get((take.take_id, sensor.recording))
        if row is not None and clock is not None:
            own = _points(take.limbs[sensor.limb], sensor, row, clock, frames, rate_hz)
            before = points.get(sensor.limb, own)  # a take of several recordings: each has frames of its own
            points[sensor.limb] = np.where(np.isfinite(before), before, own)
    if not points:
        return None
    packed = pack(take.take, np.concatenate(list(points.values())), rate_hz)
    return {**asdict(packed), "count": POINTS * len(points), "limbs": list(points)}


def _points(
    limb: LimbMotion, sensor: WornSensor, row: Mapping[str, Any], clock: Clock, frames: int, rate_hz: float
) -> F64:
    """Return the points (7, 3, T) of a limb at the analysis frames of its take."""
    times = np.arange(frames) / rate_hz
    nearest = np.searchsorted(limb.times, times).clip(0, len(limb.times) - 1)
    before = (nearest - 1).clip(0)
    nearest = np.where(times - limb.times[before] < limb.times[nearest] - times, before, nearest)
    at = limb.times[nearest]
    reported, known = interpolate(sensor.times, sensor.orientation, clock.sensor_time(at))
    knots = row["drift"] or []
    drift = HeadingDrift(np.array([one["t"] for one in knots]), np.array([one["degrees"] for one in knots]))
    reported = drift.corrected(at, reported)
    reported[~known] = np.nan
    world = np.array([row["q_global"][axis] for axis in "wxyz"])
    middle = limb.position[nearest]
    points = np.full((POINTS, 3, frames), np.nan)
    points[0] = middle.T
    axes = LENGTH_M * np.eye(3)
    if row["q_mount"] is None:
        direction = np.array([row["direction"][axis] for axis in "xyz"])
        points[1] = (middle + LENGTH_M * limb.direction[nearest]).T
        points[4] = (middle + LENGTH_M * rotate(multiply(world, reported), direction)).T
        return points
    mount = np.array([row["q_mount"][axis] for axis in "wxyz"])
    predicted = multiply(multiply(world, reported), conjugate(mount))
    for i in range(3):
        points[1 + i] = (middle + rotate(limb.orientation[nearest], axes[i])).T
        points[4 + i] = (middle + rotate(predicted, axes[i])).T
    points[1:4][:, :, ~limb.valid[nearest]] = np.nan
    return points
