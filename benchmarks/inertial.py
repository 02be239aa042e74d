"""Time the numbers of inertial sensors on one core, beside scipy on the same work.

scipy has no calibration against wrong frames: its column is `Rotation.align_vectors` of turns between pairs of frames,
which gives the mount as the thesis's method does. A lag search without the rules for overlaps is its column, too.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import signal
from scipy.spatial.transform import Rotation

from benchmarks.harness import Figure, seconds, sized
from kinedex.ops.inertial.disagreement import frame_errors
from kinedex.ops.inertial.hand_eye import Stream, calibrate
from kinedex.ops.inertial.rotations import Z_TO_Y, angular_speed, conjugate, exp, multiply
from kinedex.ops.inertial.time_offset import CUTOFF_HZ, RATE_HZ, Speeds, find_offset
from kinedex.storage.store.store import Store

F64 = npt.NDArray[np.float64]

FRAMES, PAIRS, ERRORS, LAG_S = sized((15_000, 5_000, 1_000_000, 180.0), (1_500, 500, 20_000, 30.0))
MOUNT = exp(np.array([0.2, -0.4, 0.7]))


def figures(_: Store) -> list[Figure]:
    """Time a calibration, a million errors, and a lag search."""
    return [calibration_figure(), error_figure(), lag_figure()]


def movement(times: F64) -> F64:
    """Return orientations (T, 4) of a movement about all axes."""
    rng = np.random.default_rng(7)
    waves = [
        rng.normal(0, 0.5, 3) * np.sin(rng.uniform(1, 9) * times[:, None] + rng.uniform(0, 6, 3)) for _ in range(8)
    ]
    return exp(np.sum(waves, axis=0))


def worn(times: F64, wrong: float) -> tuple[F64, F64]:
    """Return the orientations of a sensor, and those of a limb of which a part is wrong."""
    track = movement(times)
    sensor = multiply(multiply(conjugate(Z_TO_Y), track), MOUNT)
    count = int(wrong * len(track))
    track[100 : 100 + count] = multiply(track[100 : 100 + count], exp(np.array([0.0, 1.5, 0.5])))
    return sensor, track


def calibration_figure() -> Figure:
    """Time the calibration of one limb."""
    times = np.arange(FRAMES) / 40.0
    sensor, track = worn(times, 0.25)
    stream = Stream("limb", "take", times, sensor, track, np.ones(FRAMES, bool))
    first, second = np.random.default_rng(0).integers(0, FRAMES, (2, PAIRS))

    def pairs() -> None:
        own, other = (Rotation.from_quat(stream[:, [1, 2, 3, 0]]) for stream in (sensor, track))
        rotations = [(one[first].inv() * one[second]).as_rotvec() for one in (other, own)]
        Rotation.align_vectors(*rotations)

    took = seconds(lambda: calibrate([stream]))
    return Figure(
        "calibrate a limb, a quarter of the frames wrong",
        FRAMES,
        "frames",
        took,
        "scipy align_vectors of 5,000 pairs",
        seconds(pairs),
    )


def error_figure() -> Figure:
    """Time errors, swings and twists."""
    sensor, track = worn(np.arange(ERRORS) / 40.0, 0.25)
    axis = np.array([1.0, 0.0, 0.0])

    def by_scipy() -> F64:
        own, other = (Rotation.from_quat(stream[:, [1, 2, 3, 0]]) for stream in (sensor, track))
        world, mount = (Rotation.from_quat(q[[1, 2, 3, 0]]) for q in (Z_TO_Y, MOUNT))
        return np.asarray((other.inv() * (world * own * mount.inv())).magnitude())

    took = seconds(lambda: frame_errors(sensor, track, Z_TO_Y, MOUNT, axis))
    other = "scipy Rotation, without swing and twist"
    return Figure("errors, swings and twists", ERRORS / 1e6, "M frames", took, other, seconds(by_scipy))


def lag_figure() -> Figure:
    """Time the search of a lag between a take and a sensor, both at 200 Hz."""
    times = np.arange(round(LAG_S * RATE_HZ)) / RATE_HZ
    middle, speed = angular_speed(times, movement(times))
    limb = Speeds(middle, speed, middle + 0.5, speed)

    def by_scipy() -> None:
        sections = signal.butter(2, CUTOFF_HZ, fs=RATE_HZ, output="sos")
        smooth = signal.sosfiltfilt(sections, speed - speed.mean())
        np.argmax(signal.correlate(smooth, smooth, method="fft"))

    took = seconds(lambda: find_offset([limb]))
    other = "scipy correlate, overlaps not weighed"
    return Figure("lag of a sensor over 3 min", LAG_S, "s of recording", took, other, seconds(by_scipy))
