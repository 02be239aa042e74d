"""`python -m studies.inertial_sensors DATA`: print how far simulated sensors are from real ones, and hinges from limbs.

DATA is a folder with imu/broad and cmu, and any of imu/apdm, imu/xio and imu/xsens. It takes half a minute.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.catalog.configs import config_names
from kinedex.catalog.features import load_feature_set
from kinedex.catalog.imu_grades import load_grade
from kinedex.catalog.limbs import LIMBS
from kinedex.catalog.skeletons.mappings import load_mappings
from kinedex.ops.errors import KinedexError
from kinedex.ops.inertial.limb_orientation import HINGE
from kinedex.ops.inertial.orientation_filter import TO_NORTH_WEST_UP
from kinedex.ops.inertial.rotations import conjugate, distance_deg, interpolate, multiply, rotate
from kinedex.ops.inertial.sensor_model import (
    SensorMotion,
    field_in_sensor,
    gyroscope_rates,
    magnetic_field,
    measured,
    seeded_generator,
    sensor_motion,
    smooth,
    specific_force,
)
from kinedex.pipelines.inertial.limb_motion import take_limbs
from kinedex.reports.markdown import grid
from kinedex.storage.formats.imu.recording import read_recording
from kinedex.storage.formats.motion.body_limbs import BodyLimbs, read_body_limbs
from kinedex.storage.formats.motion.reader import DEFAULT_SETTINGS, MotionFile

F64 = npt.NDArray[np.float64]

CUTOFF_HZ = 8.0
"""Real and simulated readings are compared below this frequency."""

SENSOR_HZ = 100.0
"""The rate of the simulated sensors: half an interval is near the 4 ms by which the readings of BROAD lag."""

SHORT_GAP_S, MIN_S = 0.1, 2.0
STILL_DEG_S, STILL_S = 1.0, 0.5
ALLAN_S = 60.0
"""A rest of so many seconds has an Allan deviation; a shorter one has a noise density alone."""

HINGES = ("thigh", "shank", "upperarm", "forearm")
BANDS_HZ = ((1.0, 5.0), (5.0, 20.0), (20.0, 50.0))
ONE = np.array([1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True, eq=False)
class Trial:
    """A trial of BROAD: a rigid body with a sensor and optical markers, in F_GI.

    Attributes
    ----------
    name : str
        Number of the trial.
    rate_hz : float
        Samples per second of both.
    acc, gyr, mag : float64 array (N, 3)
        Readings.
    position, orientation : float64 array (N, 3) and (N, 4)
        The optical stream; NaN where it was lost.
    movement : bool array (N,)
        The samples that count.
    """

    name: str
    rate_hz: float
    acc: F64
    gyr: F64
    mag: F64
    position: F64
    orientation: F64
    movement: npt.NDArray[np.bool_]


def read_trial(path: Path) -> Trial:
    """Read a trial of BROAD."""
    import h5py

    with h5py.File(path) as file:
        acc, gyr, mag, place, turn, movement = (
            np.asarray(file[name]) for name in ("imu_acc", "imu_gyr", "imu_mag", "opt_pos", "opt_quat", "movement")
        )
        rate = float(file.attrs["sampling_rate"])
    north = TO_NORTH_WEST_UP
    return Trial(
        path.stem.partition("_")[0], rate, acc, gyr, mag, rotate(north, place), multiply(north, turn),
        movement.astype(bool),
    )  # fmt: skip


@dataclass(frozen=True)
class Agreement:
    """Root mean square differences of an axis, and correlations, of simulated and real readings."""

    gyr_deg_s: float
    gyr: float
    acc_m_s2: float
    acc: float
    mag_ut: float


def agreement(trial: Trial) -> Agreement:
    """Compare readings that are made of a trial's optical stream with what its sensor read, both below 8 Hz."""
    made: dict[str, list[F64]] = {"acc": [], "gyr": [], "mag": []}
    real: dict[str, list[F64]] = {"acc": [], "gyr": [], "mag": []}
    seen = np.isfinite(trial.orientation).all(axis=1) & np.isfinite(trial.position).all(axis=1)
    counted = seen & trial.movement
    field = np.median(rotate(trial.orientation[counted], trial.mag[counted]), axis=0)
    for start, stop in _pieces(trial, seen):
        times = np.arange(start, stop) / trial.rate_hz
        at = np.arange(times[0], times[-1], 1.0 / SENSOR_HZ)
        own = seen[start:stop]
        turn, _ = interpolate(times[own], trial.orientation[start:stop][own], times, SHORT_GAP_S)
        place = np.stack([np.interp(times, times[own], trial.position[start:stop][own, i]) for i in range(3)], axis=1)
        motion = sensor_motion(times, place, turn, at, ONE, ONE, cutoff_hz=CUTOFF_HZ)
        inner = counted[np.minimum(np.round(at * trial.rate_hz).astype(int), len(counted) - 1)]
        inner[: int(SENSOR_HZ / 2)] = inner[-int(SENSOR_HZ / 2) :] = False
        for name, values in (
            ("acc", specific_force(motion.orientation, motion.acceleration)),
            ("gyr", gyroscope_rates(motion.orientation, SENSOR_HZ)),
            ("mag", field_in_sensor(motion.orientation, field)),
        ):
            made[name].append(values[inner])
            slow = smooth(getattr(trial, name)[start:stop], trial.rate_hz, CUTOFF_HZ)
            read = np.stack([np.interp(at, times, slow[:, i]) for i in range(3)], axis=1)
            real[name].append(read[inner])
    whole = {name: (np.concatenate(made[name]), np.concatenate(real[name])) for name in made}
    off = {name: float(np.sqrt(np.mean(np.square(a - b)))) for name, (a, b) in whole.items()}
    like = {name: float(np.corrcoef(a.ravel(), b.ravel())[0, 1]) for name, (a, b) in whole.items()}
    return Agreement(np.degrees(off["gyr"]), like["gyr"], off["acc"], like["acc"], off["mag"])


def _pieces(trial: Trial, seen: npt.NDArray[np.bool_]) -> Iterator[tuple[int, int]]:
    """Yield intervals [start, stop) without a gap above a tenth of a second."""
    positions = np.flatnonzero(seen)
    breaks = np.flatnonzero(np.diff(positions) > SHORT_GAP_S * trial.rate_hz)
    for part in np.split(positions, breaks + 1):
        if len(part) and part[-1] - part[0] >= MIN_S * trial.rate_hz:
            yield int(part[0]), int(part[-1]) + 1


@dataclass(frozen=True, eq=False)
class Rest:
    """The longest rest of a sensor: its readings, in m/s² and rad/s."""

    name: str
    rate_hz: float
    acc: F64
    gyr: F64

    @property
    def seconds(self) -> float:
        """The length in seconds."""
        return len(self.acc) / self.rate_hz


def longest_rest(name: str, rate_hz: float, acc: F64, gyr: F64) -> Rest | None:
    """Return the longest interval in which a sensor turns by less than a degree a second; None below 4 s."""
    width = max(1, round(STILL_S * rate_hz))
    window = np.ones(width) / width
    mean = np.stack([np.convolve(gyr[:, i], window, "same") for i in range(3)], axis=1)
    power = np.convolve(np.square(gyr - mean).sum(axis=1), window, "same")
    still = (power < np.radians(STILL_DEG_S) ** 2) & (np.linalg.norm(mean, axis=1) < np.radians(3 * STILL_DEG_S))
    edges = np.flatnonzero(np.diff(still, prepend=False, append=False)).reshape(-1, 2)
    if not len(edges):
        return None
    start, stop = edges[int(np.argmax(edges[:, 1] - edges[:, 0]))].tolist()
    start, stop = start + width, stop - width
    return Rest(name, rate_hz, acc[start:stop], gyr[start:stop]) if stop - start >= 4 * rate_hz else None


def densities(values: F64, rate_hz: float) -> list[float]:
    """Return the noise density of readings (N, 3) in each band, in units per √Hz; NaN beyond half of the rate."""
    from scipy.signal import welch

    frequency, power = welch(values, rate_hz, nperseg=min(len(values), round(2 * rate_hz)), axis=0)
    found = []
    for low, high in BANDS_HZ:
        inside = (frequency >= low) & (frequency < high)
        inside &= frequency < 0.48 * rate_hz
        found.append(float(np.sqrt(np.median(power[inside]))) if inside.any() else float("nan"))
    return found


def allan(rest: Rest) -> str:
    """Return the least Allan deviation of a gyroscope in degrees per hour, or the reason for which there is none."""
    if rest.seconds < ALLAN_S:
        return f"rest of {rest.seconds:.0f} s: density only"
    try:
        import allantools
    except ModuleNotFoundError:
        return "needs the package allantools"
    found = [allantools.oadev(axis, rest.rate_hz, "freq", "octave")[1].min() for axis in rest.gyr.T]
    return f"{np.degrees(np.median(found)) * 3600:.1f}°/h"


def simulated_rest(grade: str, rate_hz: float, seconds: float) -> Rest:
    """Return a rest of a simulated sensor."""
    count = round(rate_hz * seconds)
    motion = SensorMotion(rate_hz, np.tile(ONE, (count, 1)), np.zeros((count, 3)))
    own = load_grade(grade)
    still = type(own)(own.acc, own.gyr, own.mag)
    read = measured(motion, still, magnetic_field(), seeded_generator(1, grade))
    return Rest(f"{grade} (simulated)", rate_hz, read.acc, read.gyr)


def real_rests(data: Path, trials: Sequence[Trial]) -> list[Rest]:
    """Return the rests of all given sensors that rest for 4 s."""
    found = [longest_rest(f"BROAD {one.name}", one.rate_hz, one.acc, one.gyr) for one in trials]
    for path in sorted([*data.glob("imu/apdm/*.csv"), *data.glob("imu/xio/*.csv"), *data.glob("imu/xsens/*.txt")]):
        try:
            sensors = read_recording(path).sensors
        except KinedexError:
            continue  # a file that needs a rate, or a part of a recording
        for sensor in sensors:
            if sensor.acc is not None and sensor.gyr is not None:
                known = np.isfinite(sensor.acc).all(axis=1) & np.isfinite(sensor.gyr).all(axis=1)
                if np.count_nonzero(known) > 4 * sensor.rate_hz:
                    name = f"{path.parent.name} {sensor.name}"
                    found.append(longest_rest(name, sensor.rate_hz, sensor.acc[known], sensor.gyr[known]))
    return [one for one in found if one is not None]


def hinge_errors(data: Path) -> list[list[str]]:
    """Return by how much orientations of hinges differ from those of nodes, limb by limb, on the takes of CMU.

    The frames of both may differ by a turn that does not change, the mean one, which is taken off.
    """
    joints = load_feature_set().joints
    mappings = load_mappings("auto", joints)
    found: dict[str, list[F64]] = {limb: [] for limb in HINGES}
    for path in sorted(data.glob("cmu/[0-9]*/*.amc")):
        skeleton = path.with_name(f"{path.stem.partition('_')[0]}.asf")
        read = read_body_limbs(MotionFile(path, skeleton), mappings, joints, DEFAULT_SETTINGS, LIMBS)
        full = take_limbs(read, joints, LIMBS).limbs
        hinge = take_limbs(BodyLimbs(read.body), joints, LIMBS).limbs
        for limb, errors in found.items():
            for side in "lr":
                one, other = full[side + limb], hinge[side + limb]
                if other.basis == HINGE:
                    good = one.valid & ~one.jump & other.valid
                    errors.append(_apart(one.orientation[good], other.orientation[good]))
    rows = []
    for limb, errors in found.items():
        whole = np.concatenate(errors)
        low, middle, high = np.percentile(whole, [50, 90, 95])
        rows.append([limb, str(len(errors)), f"{low:.1f}", f"{middle:.1f}", f"{high:.1f}"])
    return rows


def _apart(first: F64, second: F64) -> F64:
    """Return angles in degrees between streams (T, 4), after the turn between their frames that fits best."""
    between = multiply(conjugate(first), second)
    _, vectors = np.linalg.eigh(between.T @ between)
    return distance_deg(between, vectors[:, -1])


def report(data: Path) -> str:
    """Return the tables as Markdown."""
    trials = [read_trial(path) for path in sorted((data / "imu" / "broad").glob("*.hdf5"))]
    moving = [
        [
            f"BROAD {one.name}",
            f"{a.gyr_deg_s:.2f}",
            f"{a.gyr:.4f}",
            f"{a.acc_m_s2:.2f}",
            f"{a.acc:.4f}",
            f"{a.mag_ut:.1f}",
        ]
        for one in trials
        for a in (agreement(one),)
    ]
    rests = real_rests(data, trials)
    rests += [simulated_rest(grade, 100.0, 30.0) for grade in config_names("imu_grades") if grade != "perfect"]
    still = []
    for one in rests:
        gyr, acc = densities(np.degrees(one.gyr), one.rate_hz), densities(one.acc, one.rate_hz)
        cells = [_number(value) for pair in zip(gyr, acc, strict=True) for value in pair]
        still.append([one.name, f"{one.rate_hz:.0f}", *cells, allan(one)])
    bands = [f"{quantity} {low:g}–{high:g} Hz" for low, high in BANDS_HZ for quantity in ("gyr", "acc")]
    return "\n".join(
        [
            "## In motion: readings made of optical truth, against the sensor's, below 8 Hz",
            "",
            *grid(["trial", "gyr RMS °/s", "correlation", "acc RMS m/s²", "correlation", "field RMS µT"], moving),
            "",
            "## At rest: noise densities, °/s/√Hz and m/s²/√Hz, by band",
            "",
            *grid(["sensor", "Hz", *bands, "Allan deviation of gyr, least"], still),
            "## Limbs of takes by hinges, against the rotations of their nodes, degrees",
            "",
            *grid(["limb", "limbs of takes", "median", "90 %", "95 %"], hinge_errors(data)),
        ]
    )


def _number(value: float) -> str:
    return "–" if not np.isfinite(value) else f"{value:.2g}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path, help="folder with imu/broad")
    print(report(parser.parse_args(arguments).data))
    return 0


if __name__ == "__main__":
    sys.exit(main())
