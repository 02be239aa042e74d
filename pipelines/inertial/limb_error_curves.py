"""Compute errors of a take's limbs against their sensors, and the runs of frames in which a limb is wrong or jumps."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from kinedex.ops.inertial.disagreement import (
    Run,
    RunRules,
    auto_tau,
    direction_errors,
    errors,
    jump_runs,
    runs,
)
from kinedex.ops.inertial.drift import HeadingDrift
from kinedex.ops.inertial.limb_orientation import NONE, long_axis
from kinedex.ops.inertial.rotations import interpolate
from kinedex.ops.wording import counted
from kinedex.pipelines.inertial.error_parameters import LimbErrorsParameters
from kinedex.pipelines.inertial.limb_motion import LimbMotion
from kinedex.pipelines.inertial.worn_sensors import Clock, WornSensor, WornTake

F64 = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Names = npt.NDArray[np.str_]


@dataclass(frozen=True, eq=False)
class LimbCurve:
    """The errors of a limb over time against its sensor, or against sensors of several recordings of the take.

    Attributes
    ----------
    limb : str
        Its name.
    recording, sensor : str array (T,)
        The recording and the sensor that each frame is compared with.
    times : float64 array (T,)
        Times in the take, in seconds.
    degrees, swing, twist : float64 array (T,)
        The whole error angle, its swing and its twist, in degrees; NaN if unknown. If only a limb's axis is known,
        only the swing is.
    valid : bool array (T,)
        The frames that are evaluated.
    jump : bool array (T,)
        The frames in which the limb turns faster than a person can.
    """

    limb: str
    recording: Names
    sensor: Names
    times: F64
    degrees: F64
    swing: F64
    twist: F64
    valid: Flags
    jump: Flags

    @property
    def error(self) -> F64:
        """The error in degrees, float64 (T,): the whole angle, or the swing if only that is known."""
        return np.where(np.isfinite(self.degrees), self.degrees, self.swing)

    @property
    def rate_hz(self) -> float:
        """The frames per second; 1 for a single frame."""
        return (len(self.times) - 1) / float(self.times[-1] - self.times[0]) if len(self.times) > 1 else 1.0


@dataclass(frozen=True, eq=False)
class TakeErrors:
    """The errors of a take's limbs.

    Attributes
    ----------
    curves : tuple of LimbCurve
        One for each limb.
    tau_deg : float
        The error above which a frame is wrong.
    runs : dict of str to (list of Run, list of Run)
        Limb → the runs of wrong frames, and those of jumps.
    left_out : list of str
        Sentences on sensors that were not used.
    """

    curves: tuple[LimbCurve, ...]
    tau_deg: float
    runs: Mapping[str, tuple[list[Run], list[Run]]]
    left_out: list[str] = field(default_factory=list)


Calibrations = Mapping[tuple[int, str, str], Mapping[str, Any]]
"""The rows of `sensor_calibration` with a mount, by take_id, recording and sensor."""


def take_errors(
    take: WornTake, clocks: Mapping[tuple[int, str], Clock], calibrations: Calibrations, params: LimbErrorsParameters
) -> TakeErrors:
    """Compare the limbs of a take with the sensors that were worn on them.

    If a limb has several sensors, it is compared with the one that has the most frames, and in frames that this one
    lacks with the others, because each recording may cover a part of the take.

    Parameters
    ----------
    take : WornTake
        The take.
    clocks : mapping of (int, str) to Clock
        The clocks of recordings.
    calibrations : mapping of (int, str, str) to mapping
        The calibrations of sensors.
    params : LimbErrorsParameters
        The threshold and other parameters.
    """
    found: dict[str, LimbCurve] = {}
    left_out = []
    lacking: dict[str, list[str]] = {}
    for sensor in take.sensors:
        clock = clocks.get((take.take_id, sensor.recording))
        row = calibrations.get((take.take_id, sensor.recording, sensor.sensor))
        if clock is None or row is None:
            lacking.setdefault(sensor.recording, []).append(sensor.sensor)
            continue
        curve = _curve(take.limbs[sensor.limb], sensor, clock, row)
        other = found.get(sensor.limb)
        if other is not None:
            better = curve.valid.sum() > other.valid.sum()
            kept, filler = (curve, other) if better else (other, curve)
            if (kept.valid & filler.valid).any():
                first, second = (f"{one.sensor[0]} of {one.recording[0]}" for one in (kept, filler))
                left_out.append(f"{kept.limb}: where {first} and {second} both know a frame, the former judges it")
            curve = _filled(kept, filler)
        found[sensor.limb] = curve
    left_out += [f"{_sensors(names)} of {one}: no clock or no mount" for one, names in lacking.items()]
    curves = tuple(found.values())
    tau = auto_tau((one.error, one.valid) for one in curves) if params.tau == "auto" else params.tau
    rules = RunRules(tau, params.low, params.gap_s, params.min_s)
    return TakeErrors(curves, tau, {one.limb: _runs(one, rules) for one in curves}, left_out)


def _sensors(names: list[str]) -> str:
    return names[0] if len(names) == 1 else counted(len(names), "sensor")


def _filled(one: LimbCurve, other: LimbCurve) -> LimbCurve:
    """Return a curve with frames of another curve filled in where its own frames are not valid."""
    lacks = other.valid & ~one.valid
    names = ("recording", "sensor", "degrees", "swing", "twist", "valid")
    return replace(one, **{name: np.where(lacks, getattr(other, name), getattr(one, name)) for name in names})


def _runs(curve: LimbCurve, rules: RunRules) -> tuple[list[Run], list[Run]]:
    return runs(curve.error, curve.valid, curve.rate_hz, rules), jump_runs(curve.error, curve.jump)


def _curve(limb: LimbMotion, sensor: WornSensor, clock: Clock, row: Mapping[str, Any]) -> LimbCurve:
    orientation, known = interpolate(sensor.times, sensor.orientation, clock.sensor_time(limb.times))
    knots: Iterable[Mapping[str, float]] = row["drift"] or ()
    drift = HeadingDrift(np.array([one["t"] for one in knots]), np.array([one["degrees"] for one in knots]))
    orientation = drift.corrected(limb.times, orientation)
    q_global = _values(row["q_global"])
    gap = np.full(len(limb.times), np.nan)
    if limb.basis == NONE:
        swing = direction_errors(orientation, limb.direction, q_global, _values(row["direction"]))
        degrees = twist = gap
    else:
        axis = long_axis(limb.orientation, limb.direction)
        swings = bool(np.isfinite(axis).all())
        found = errors(orientation, limb.orientation, q_global, _values(row["q_mount"]), axis if swings else _ANY)
        degrees = found.degrees
        swing, twist = (found.swing, found.twist) if swings else (gap, gap)
    judged = np.isfinite(degrees) | np.isfinite(swing)
    valid = known & limb.valid & ~limb.jump & judged
    recording, name = (np.full(len(limb.times), text) for text in (sensor.recording, sensor.sensor))
    return LimbCurve(
        limb.limb, recording, name, limb.times, degrees, swing, twist, valid, limb.jump
    )  # fmt: skip


_ANY = np.array([1.0, 0.0, 0.0])  # any axis gives the same whole angle


def _values(row: Mapping[str, float]) -> F64:
    return np.array(list(row.values()))
