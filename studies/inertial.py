"""`python -m studies.inertial DATA`: print errors of orientations, offsets and calibrations on real sensors.

DATA is a folder with imu/broad and imu/feet. All of it takes some seconds.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from kinedex.ops.inertial.disagreement import frame_errors
from kinedex.ops.inertial.hand_eye import Options, Stream, StreamFit, calibrate
from kinedex.ops.inertial.rotations import Z_TO_Y, angular_speed, conjugate, distance_deg, interpolate, multiply
from kinedex.ops.inertial.time_offset import FineSearch, Speeds, TimeOffset, find_offset, refine_offset, sensor_speed
from kinedex.ops.inertial.whitened_offset import whitened_offset
from kinedex.reports.markdown import grid
from studies.inertial_recordings import Worn, broad_trials, read_feet

F64 = npt.NDArray[np.float64]

SETTINGS = {
    "9D, vertical free": (True, Options(vertical_known=False)),
    "9D, vertical known": (True, Options()),
    "6D, vertical known": (False, Options(shared=False)),
    "6D, vertical known, heading: drift": (False, Options(shared=False, drift=True)),
}
"""The settings of calibrations: with a magnetometer or not, and the options."""

TAKEN_OUT = "the same, magnetometer's offset taken out"

EVERY = 7
"""Every so many samples of BROAD are calibrated: its tracker is as fast as its sensor."""

AXIS = np.array([1.0, 0.0, 0.0])


def orientation_errors(trial: Worn, magnetometer: bool) -> tuple[float, float]:
    """Return RMS error and RMS inclination error, in degrees, of a trial's estimated orientations, nothing aligned."""
    north = multiply(conjugate(Z_TO_Y), trial.track)
    turn = multiply(trial.orientation(magnetometer), conjugate(north))[trial.counted]
    total = 2.0 * np.arctan2(np.linalg.norm(turn[:, 1:], axis=1), np.abs(turn[:, 0]))
    inclination = 2.0 * np.arccos(np.clip(np.hypot(turn[:, 0], turn[:, 3]), 0.0, 1.0))
    return _rms(np.degrees(total)), _rms(np.degrees(inclination))


def _rms(values: F64) -> float:
    return float(np.sqrt(np.mean(values * values)))


def lag(recordings: Sequence[Worn], longest_s: float | None = None) -> TimeOffset:
    """Return the offset of sensors by correlation of angular speeds."""
    return find_offset(
        [
            Speeds(*angular_speed(one.times, one.track), *sensor_speed(one.sensor_times, one.gyr, None))
            for one in recordings
        ],
        longest_s,
    )


def trial_calibration(trial: Worn, magnetometer: bool, options: Options) -> tuple[float, float]:
    """Return by how much a trial's mount is off the true one, which is none, and the RMS of e, both in degrees."""
    frames = np.flatnonzero(trial.counted)[::EVERY]
    sensor, track = trial.orientation(magnetometer)[frames], trial.track[frames]
    stream = Stream("body", trial.name, trial.times[frames], sensor, track, np.ones(len(frames), bool))
    (fit,) = calibrate([stream], options)
    e = frame_errors(fit.drift.corrected(stream.times, sensor), track, fit.q_global, fit.q_mount, AXIS).degrees
    return float(distance_deg(fit.q_mount, np.array([1.0, 0.0, 0.0, 0.0]))), _rms(e)


class Foot(NamedTuple):
    """The errors of one foot in degrees: mean, standard deviation and the 95th percentile; and the tilt of q_G."""

    mean: float
    deviation: float
    percentile: float
    tilt: float


def feet_offset(feet: Sequence[Worn], whitened: bool = False) -> float:
    """Return the offset of the feet by correlation, a first calibration, the fine search, and whitened errors."""
    offset = lag(feet).offset_s
    streams = feet_streams(feet, offset)
    limbs = []
    for foot, stream, fit in zip(feet, streams, calibrate(streams, Options(shared=False)), strict=True):
        predicted = multiply(multiply(conjugate(fit.q_global), stream.track), fit.q_mount)
        limbs.append(
            FineSearch(stream.times[stream.valid], predicted[stream.valid], foot.sensor_times, foot.orientation(False))
        )
    offset = refine_offset(limbs, offset)
    return whitened_offset(limbs, offset)[0] if whitened else offset


def trial_offset(trial: Worn) -> float:
    """Return the offset of a trial by a calibration, the fine search and whitened errors."""
    frames = np.flatnonzero(trial.counted)
    orientation = trial.orientation(True)
    stream = Stream(
        "body", trial.name, trial.times[frames], orientation[frames], trial.track[frames], np.ones(len(frames), bool)
    )
    (fit,) = calibrate([stream], Options())
    predicted = multiply(multiply(conjugate(fit.q_global), stream.track), fit.q_mount)
    limb = FineSearch(stream.times, predicted, trial.sensor_times, orientation)
    return whitened_offset([limb], refine_offset([limb], 0.0))[0]


def feet_streams(feet: Sequence[Worn], offset_s: float) -> list[Stream]:
    """Return the streams of both feet at the markers' frames."""
    streams = []
    for foot in feet:
        sensor, known = interpolate(foot.sensor_times, foot.orientation(False), foot.times + offset_s)
        streams.append(Stream(foot.name, "feet", foot.times, sensor, foot.track, foot.counted & known))
    return streams


def feet_errors(streams: Sequence[Stream], options: Options) -> list[Foot]:
    """Calibrate both feet and return their errors."""
    return [_foot(stream, fit) for stream, fit in zip(streams, calibrate(streams, options), strict=True)]


def _foot(stream: Stream, fit: StreamFit) -> Foot:
    sensor = fit.drift.corrected(stream.times, stream.sensor)
    e = frame_errors(sensor, stream.track, fit.q_global, fit.q_mount, AXIS).degrees[stream.valid]
    return Foot(float(e.mean()), float(e.std()), float(np.percentile(e, 95)), fit.tilt_deg)


def broad_tables(trials: Sequence[Worn]) -> list[str]:
    """Return the tables of BROAD: orientations, offsets, calibrations."""
    taken_out = [one.calibrated() for one in trials]
    rows = [
        [name, *(f"{total:.2f} / {level:.2f}" for total, level in (orientation_errors(one, nine) for one in some))]
        for name, some, nine in (
            ("offline, 9D", trials, True),
            (TAKEN_OUT, taken_out, True),
            ("offline, 6D", trials, False),
        )
    ]
    lags = [f"{1000 * lag([one], 5.0).offset_s:.1f}" for one in trials]
    lines = ["Orientations, total / inclination, RMS in degrees; and the lag of the readings:", ""]
    orientations = [f"{1000 * trial_offset(one):.1f}" for one in trials]
    lag_rows = [["lag of the gyroscope, ms", *lags], ["lag of orientations, ms", *orientations]]
    lines += grid(["trial", *(one.name for one in trials)], [*rows, *lag_rows])
    lines += ["Calibration: q_L off by / e, RMS, degrees:", ""]
    calibrated = []
    settings = [(name, trials, *how) for name, how in SETTINGS.items()]
    settings.insert(2, (TAKEN_OUT, taken_out, True, Options()))
    for name, some, magnetometer, options in settings:
        cells = [trial_calibration(one, magnetometer, options) for one in some]
        calibrated.append([name, *(f"{off:.2f} / {e:.2f}" for off, e in cells)])
    return [*lines, *grid(["", *(one.name for one in trials)], calibrated)]


def feet_tables(feet: Sequence[Worn]) -> list[str]:
    """Return the tables of the feet: offsets, and errors by setting."""
    both = lag(feet)
    offset = feet_offset(feet)
    each = ", ".join(f"{1000 * lag([foot]).offset_s:.1f} ({foot.name})" for foot in feet)
    lines = [
        f"Offsets in ms: {1000 * both.offset_s:.1f} by correlation (peak {both.correlation:.2f}, next "
        f"{both.next_best:.2f}), {each}; {1000 * offset:.1f} by the fine search, "
        f"{1000 * feet_offset(feet, whitened=True):.1f} by whitened errors.",
        "",
    ]
    streams = feet_streams(feet, offset)
    settings = {
        "per sensor, vertical known": Options(shared=False),
        "the same, heading: drift": Options(shared=False, drift=True),
        "per sensor, vertical free": Options(shared=False, vertical_known=False),
        "shared, vertical known": Options(),
    }
    rows = []
    for name, options in settings.items():
        found = feet_errors(streams, options)
        cells = [f"{foot.mean:.1f} ± {foot.deviation:.1f}, {foot.percentile:.1f}" for foot in found]
        rows.append([name, *cells, ", ".join(f"{foot.tilt:.1f}" for foot in found)])
    header = ["e: mean ± deviation, 95th percentile, degrees", *(foot.name for foot in feet), "tilt of q_G"]
    return [*lines, *grid(header, rows)]


def main(arguments: Sequence[str] | None = None) -> int:
    """Print all tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path, help="a folder with imu/broad and imu/feet")
    folder = parser.parse_args(arguments).data / "imu"
    for part in ("broad", "feet"):
        if not (folder / part).is_dir():
            print(f"{folder / part}: no such folder; DATA is a folder with imu/broad and imu/feet", file=sys.stderr)
            return 2
    print("\n".join(["## BROAD", "", *broad_tables(broad_trials(folder / "broad"))]))
    print("\n".join(["## Feet", "", *feet_tables(read_feet(folder / "feet"))]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
