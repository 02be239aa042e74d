"""Estimate the clock of a recording relative to a take: correlation, a first calibration, and a fine search."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kinedex.ops.inertial.hand_eye import Options, Stream, StreamFit, calibrate
from kinedex.ops.inertial.limb_motion import LimbMotion
from kinedex.ops.inertial.rotations import angular_speed, conjugate, multiply
from kinedex.ops.inertial.time_offset import FineSearch, Speeds, find_drift, find_offset, refine_offset, sensor_speed
from kinedex.ops.inertial.whitened_offset import whitened_offset
from kinedex.pipelines.inertial.parameters import SynchroniseParameters
from kinedex.pipelines.inertial.worn_sensors import Clock, WornSensor, WornTake, stream_of

MIN_DRIFT_S = 300.0
"""The shortest recording, in seconds, from which clock drift is estimated."""

MAX_FRAMES = 15_000
"""The largest number of frames of each limb that the first calibration uses, spread evenly."""


MAX_ROUNDS, STILL_S = 4, 1e-4
"""The largest number of repetitions of calibration and fine search, and the change in seconds that ends them."""


@dataclass(frozen=True)
class RecordingClock:
    """The clock of a recording, and how it was estimated.

    Attributes
    ----------
    clock : Clock or None
        The clock; None if it could not be estimated.
    correlation, next_best : float or None
        See `ops.inertial.time_offset.TimeOffset`; None for a given offset.
    limbs : int
        The number of limbs that were correlated.
    refined : bool
        True if the offset was refined to the smallest orientation errors.
    left_out : str
        The reason why there is no clock; empty if there is one.
    """

    clock: Clock | None
    correlation: float | None = None
    next_best: float | None = None
    limbs: int = 0
    refined: bool = False
    left_out: str = ""


def synchronise(take: WornTake, recording: str, params: SynchroniseParameters) -> RecordingClock:
    """Estimate the clock of one recording of a take."""
    sensors = [sensor for sensor in take.sensors if sensor.recording == recording]
    if params.offset_s != "auto":
        return RecordingClock(Clock(float(params.offset_s)))
    speeds = [
        Speeds(*_limb_speed(take.limbs[sensor.limb]), *sensor_speed(sensor.times, sensor.gyr, sensor.orientation))
        for sensor in sensors
        if np.isfinite(take.limbs[sensor.limb].orientation).any()
    ]
    if not speeds:
        reason = "no limb with a sensor has an orientation; `offset_s: <seconds>` sets the offset"
        return RecordingClock(None, left_out=reason)
    found = find_offset(speeds, params.longest_s)
    if found.refused:
        correlation, next_best = (None if np.isnan(one) else one for one in (found.correlation, found.next_best))
        return RecordingClock(None, correlation, next_best, len(speeds), left_out=found.refused)
    clock, refined = _refined(take, sensors, Clock(found.offset_s), params)
    next_best = None if np.isnan(found.next_best) else found.next_best
    return RecordingClock(clock, found.correlation, next_best, len(speeds), refined)


def _limb_speed(limb: LimbMotion) -> tuple[np.ndarray, np.ndarray]:
    """Return the times and angular speeds of a limb; the speeds are NaN where the limb is not valid."""
    orientation = np.where(limb.valid[:, None], limb.orientation, np.nan)
    return angular_speed(limb.times, orientation)


def _refined(
    take: WornTake, sensors: list[WornSensor], clock: Clock, params: SynchroniseParameters
) -> tuple[Clock, bool]:
    """Return the clock with the smallest orientation errors, and whether the given clock could be refined at all.

    The sensors are calibrated with the given clock. A search on a grid finds a better clock, and least squares on
    whitened errors refine it. Since a wrong clock impairs the calibration, calibration and refinement are repeated
    until the clock hardly changes.
    """
    for number in range(MAX_ROUNDS):
        before = clock
        limbs = _fine_limbs(take, sensors, clock)
        if not limbs:
            return clock, number > 0
        seconds = max(float(limb.take_times[-1] - limb.take_times[0]) for limb in limbs)
        drifts = params.clock == "drift" and seconds >= MIN_DRIFT_S
        if number == 0:
            clock = Clock(*find_drift(limbs, clock.offset_s)) if drifts else Clock(refine_offset(limbs, clock.offset_s))
        clock = Clock(*whitened_offset(limbs, clock.offset_s, clock.ppm, drifts))
        if abs(clock.offset_s - before.offset_s) < STILL_S and abs(clock.ppm - before.ppm) * seconds < 1e6 * STILL_S:
            break
    return clock, True


def _fine_limbs(take: WornTake, sensors: list[WornSensor], clock: Clock) -> list[FineSearch]:
    """Calibrate sensors with a clock, and return the orientations predicted for each sensor beside its readings."""
    pairs = [(sensor, stream_of(take, sensor, clock)) for sensor in sensors]
    pairs = [(sensor, stream) for sensor, stream in pairs if stream.valid.any()]
    if not pairs:
        return []
    fits = _first_fits([stream for _, stream in pairs], all(sensor.magnetometer for sensor, _ in pairs))
    return [_fine(sensor, stream, fit) for (sensor, stream), fit in zip(pairs, fits, strict=True) if not fit.refused]


def _first_fits(streams: list[Stream], magnetometers: bool) -> list[StreamFit]:
    """Calibrate with at most `MAX_FRAMES` frames of each stream.

    The take's Y axis is taken as vertical unless a calibration that estimates the vertical has more than 1.2 times as
    many inliers.
    """
    some = []
    for stream in streams:
        valid = np.flatnonzero(stream.valid)
        keep = np.zeros(len(stream.valid), np.bool_)
        keep[valid[np.linspace(0, len(valid) - 1, min(len(valid), MAX_FRAMES)).astype(np.int64)]] = True
        some.append(replace(stream, valid=keep))
    level = Options(shared=magnetometers, drift=not magnetometers)
    fits = calibrate(some, level)
    free = calibrate(some, replace(level, vertical_known=False))
    return free if _fitted(free) > 1.2 * _fitted(fits) else fits


def _fitted(fits: list[StreamFit]) -> float:
    """Return the number of inlier frames of all accepted fits."""
    return sum(fit.inliers * fit.frames for fit in fits if not fit.refused)


def _fine(sensor: WornSensor, stream: Stream, fit: StreamFit) -> FineSearch:
    """Return the orientations that a sensor should have at the frames of a take, beside its readings."""
    times = stream.times[stream.valid]
    predicted = multiply(multiply(conjugate(fit.q_global), stream.track[stream.valid]), fit.q_mount)
    known = np.isfinite(sensor.orientation).all(axis=1)
    return FineSearch(times, fit.drift.uncorrected(times, predicted), sensor.times[known], sensor.orientation[known])


def sync_row(take_id: int, take: str, recording: str, found: RecordingClock) -> dict[str, Any]:
    """Return a row with the clock offset and drift of one recording of a take."""
    clock = found.clock
    return {
        "take_id": take_id,
        "take": take,
        "recording": recording,
        "offset_s": None if clock is None else clock.offset_s,
        "ppm": None if clock is None else clock.ppm,
        "correlation": found.correlation,
        "next_best": found.next_best,
        "limbs": found.limbs,
        "refined": found.refined,
        "left_out": found.left_out or None,
    }
