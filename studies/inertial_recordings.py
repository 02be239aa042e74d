"""Real recordings of inertial sensors beside optical truth: BROAD (a rigid body), and the feet of one who walks."""

from __future__ import annotations

import csv
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.ops.inertial.limb_orientation import segment_orientation
from kinedex.ops.inertial.orientation_filter import TO_NORTH_WEST_UP, estimate, estimate_calibrated
from kinedex.ops.inertial.rotations import Z_TO_Y, multiply

F64 = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

FEET_RATE_HZ, MARKER_RATE_HZ = 204.8, 100.0
MARKERS = ("FCC", "TOE", "FM5")


@dataclass(frozen=True)
class Worn:
    """A sensor beside the true orientation of what it is fixed to.

    Attributes
    ----------
    name : str
        The trial, or the limb.
    sensor_times : float64 array (N,)
        Seconds, from 0.
    rate_hz : float
        Samples per second.
    acc, gyr : float64 array (N, 3)
        m/s² and rad/s.
    mag : float64 array (N, 3) or None
        Micro-tesla.
    times : float64 array (T,)
        Seconds of the optical stream.
    track : float64 array (T, 4)
        Its orientations, segment → a world with Y up; NaN where it was not seen.
    counted : bool array (T,)
        The frames that count.
    """

    name: str
    sensor_times: F64
    rate_hz: float
    acc: F64
    gyr: F64
    mag: F64 | None
    times: F64
    track: F64
    counted: Flags

    def orientation(self, magnetometer: bool) -> F64:
        """Return the sensor's orientations (N, 4) in F_GI, computed with or without its magnetometer."""
        return estimate(self.rate_hz, self.acc, self.gyr, self.mag if magnetometer else None)

    def calibrated(self) -> Worn:
        """Return the sensor with the offset of its magnetometer taken out."""
        assert self.mag is not None
        return replace(self, mag=self.mag - estimate_calibrated(self.rate_hz, self.acc, self.gyr, self.mag)[1])


def read_broad(path: Path) -> Worn:
    """Read a trial of BROAD; its optical stream is in the sensor's axes and in east-north-up."""
    import h5py

    with h5py.File(path) as file:
        acc, gyr, mag, optical, movement = (
            np.asarray(file[name]) for name in ("imu_acc", "imu_gyr", "imu_mag", "opt_quat", "movement")
        )
        rate = float(file.attrs["sampling_rate"])
    times = np.arange(len(acc)) / rate
    track = multiply(Z_TO_Y, multiply(TO_NORTH_WEST_UP, optical))
    counted = movement.astype(bool) & np.isfinite(optical).all(axis=1)
    return Worn(path.stem.partition("_")[0], times, rate, acc, gyr, mag, times, track, counted)


def broad_trials(folder: Path) -> list[Worn]:
    """Read all trials of BROAD in a folder."""
    return [read_broad(path) for path in sorted(folder.glob("*.hdf5"))]


def read_feet(folder: Path) -> list[Worn]:
    """Read both feet: sensors without a magnetometer, and three markers of each foot in millimetres, Z up."""
    readings = _columns(folder / "imu.csv")
    markers = _columns(folder / "markers.csv")
    feet = []
    for side, letter in (("left", "L"), ("right", "R")):
        acc, gyr = (
            np.stack([readings[f"{side}_sensor", f"{quantity}_{axis}"] for axis in "xyz"], axis=1)
            for quantity in ("acc", "gyr")
        )
        positions = np.stack(
            [np.stack([markers[f"{letter}_{name}", axis] for axis in "xyz"], axis=1) for name in MARKERS], axis=1
        )
        fit = segment_orientation(positions / 1000.0)
        feet.append(
            Worn(
                f"{side} foot",
                np.arange(len(acc)) / FEET_RATE_HZ,
                FEET_RATE_HZ,
                acc,
                np.radians(gyr),
                None,
                np.arange(len(positions)) / MARKER_RATE_HZ,
                multiply(Z_TO_Y, fit.orientation),
                fit.valid,
            )
        )
    return feet


def _columns(path: Path) -> dict[tuple[str, str], F64]:
    """Read a table with two header rows and a column of row numbers; empty cells are NaN."""
    with path.open(encoding="utf-8", newline="") as file:
        first, second, *rows = csv.reader(file)
    table = np.array([[float(cell) if cell else np.nan for cell in row] for row in rows])
    return {key: table[:, k] for k, key in enumerate(zip(first, second, strict=True)) if k > 0}
