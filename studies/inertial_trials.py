"""Takes that wear simulated sensors, with limbs that are broken on purpose, for the study of simulated sensors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.catalog.imu_grades import load_grade
from kinedex.catalog.limbs import WORN
from kinedex.catalog.skeletons.mappings import load_mappings
from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.inertial.limb_motion import LimbMotion
from kinedex.ops.inertial.orientation_filter import estimate_calibrated
from kinedex.ops.inertial.rotations import interpolate
from kinedex.ops.simulation.imu_sensors import (
    LimbPiece,
    Piece,
    SampledPiece,
    TakeSensors,
    WearOptions,
    sample_piece,
    take_pieces,
    worn_sensors,
)
from kinedex.pipelines.inertial.limb_motion import StoredLimbs, take_limbs
from kinedex.pipelines.inertial.simulated_errors import LimbLabel, inject_errors
from kinedex.pipelines.inertial.worn_sensors import WornSensor, WornTake
from kinedex.pipelines.simulation.synthetic_archive import write_archive
from kinedex.storage.formats.motion.body_limbs import read_body_limbs
from kinedex.storage.formats.motion.reader import MotionFile, ReadSettings

F64 = npt.NDArray[np.float64]

CMU = ("01_01", "02_05", "02_10", "03_04", "86_09")
"""The takes of CMU."""
MIN_S, MAX_S = 3.0, 60.0
"""Pieces of HDM05, whose takes are clips in a row, have so many seconds at least, all pieces so many at most."""
SYNTHETIC_MINUTES = 6.0
"""The size of the synthetic archive, whose clips wear no sensors."""

STAND_S, EASE_S, NOISE_DEG, SENSOR_HZ, TRACK_HZ = 3.0, 1.0, 1.5, 100.0, 40.0
LEVER_M = (0.03, 0.0, 0.02)
RECORDING = "imu"


@dataclass(frozen=True)
class Source:
    """A take's files and actor, and whether it is divided into pieces at jumps."""

    motion: Path
    skeleton: Path
    actor: str
    is_divided: bool = False


@dataclass(frozen=True, eq=False)
class Trial:
    """A take that wears sensors, with the limbs that were broken, and what is true.

    Attributes
    ----------
    true : dict of str to LimbMotion
        The limbs at 40 Hz as they were.
    take : WornTake
        The broken limbs and the sensors.
    labels : list of LimbLabel
        The frames that are wrong by 20° and more.
    worn : Worn
        Heading, mounts and clock.
    sampled : SampledPiece
        The readings.
    """

    true: dict[str, LimbMotion]
    take: WornTake
    labels: list[LimbLabel]
    worn: TakeSensors
    sampled: SampledPiece


def read_trials(takes: Sequence[Source], grade: str, seed: int = 0) -> Iterator[Trial]:
    """Yield takes that wear sensors of a grade, broken."""
    for take in takes:
        limbs = read_limbs(take.motion, take.skeleton)
        for number, kept in enumerate(pieces_of(limbs) if take.is_divided else [piece_of(limbs)], 1):
            still = standing({name: part(one, kept) for name, one in limbs.items()})
            name = f"{take.motion.stem} piece {number}" if take.is_divided else take.motion.stem
            yield make_trial(name, take.actor, still, grade, seed)


def read_limbs(motion: Path, skeleton: Path, *, rotations: bool = True) -> dict[str, LimbMotion]:
    """Return the limbs of a take; without turns by its joints alone."""
    segments = read_body_limbs(
        MotionFile(motion, skeleton), load_mappings("auto", JOINTS), tuple(JOINTS), ReadSettings(), WORN
    )
    return take_limbs(segments if rotations else replace(segments, rotations={}), tuple(JOINTS), WORN).limbs


def piece_of(limbs: dict[str, LimbMotion]) -> slice:
    """Return the frames between jumps where those are most, for `MAX_S` at most."""
    piece = max(take_pieces(limbs, WORN, True).pieces, key=lambda one: one.stop - one.start)
    times = next(iter(limbs.values())).times
    return slice(piece.start, min(piece.stop, piece.start + int(MAX_S / (times[1] - times[0]))))


def pieces_of(limbs: dict[str, LimbMotion]) -> list[slice]:
    """Return the frames between jumps wherever those last `MIN_S`."""
    times = next(iter(limbs.values())).times
    least = MIN_S / (times[1] - times[0])
    found = take_pieces(limbs, WORN, True).pieces
    return [slice(one.start, one.stop) for one in found if one.stop - one.start >= least]


def every_frame(times: F64) -> slice:
    """Return the frames of the tracker among those of the source."""
    return slice(None, None, round(1.0 / (TRACK_HZ * (times[1] - times[0]))))


def part(one: LimbMotion, frames: slice) -> LimbMotion:
    """Return some frames of a limb, whose time begins at 0."""
    times = one.times[frames]
    return replace(
        one, times=times - times[0], orientation=one.orientation[frames], position=one.position[frames],
        direction=one.direction[frames], valid=one.valid[frames], jump=one.jump[frames], fit_m=None,
    )  # fmt: skip


def standing(limbs: dict[str, LimbMotion]) -> dict[str, LimbMotion]:
    """Return limbs that stand still at both ends, and speed up and slow down within a second."""
    times = next(iter(limbs.values())).times
    step, length = times[1] - times[0], times[-1]
    grid = np.arange(0.0, length + 2 * STAND_S + EASE_S, step)
    speed = np.interp(grid, [STAND_S, STAND_S + EASE_S, grid[-1] - STAND_S - EASE_S, grid[-1] - STAND_S], [0, 1, 1, 0])
    at = np.minimum(np.cumsum(speed) * step, length)
    found = {}
    for name, one in limbs.items():
        orientation, _ = interpolate(times, one.orientation, at)
        place, axis = (
            np.stack([np.interp(at, times, values[:, k]) for k in range(3)], axis=1)
            for values in (one.position, one.direction)
        )
        axis /= np.linalg.norm(axis, axis=1)[:, None]
        known = np.logical_and.reduce(np.isfinite(orientation), axis=1)
        found[name] = LimbMotion(
            name, one.basis, grid, orientation, place, axis, known, np.zeros(len(grid), np.bool_)
        )  # fmt: skip
    return found


def make_trial(name: str, actor: str, limbs: dict[str, LimbMotion], grade: str, seed: int) -> Trial:
    """Put sensors on the limbs of a take, and break the limbs."""
    wearing = WearOptions(seed, SENSOR_HZ, load_grade(grade), LEVER_M)
    worn = worn_sensors(wearing, name, actor, limbs)
    pieces = {limb: LimbPiece(one.times, one.position, one.orientation) for limb, one in limbs.items()}
    sampled = sample_piece(Piece(0, len(next(iter(limbs.values())).times), pieces), 0, name, worn, wearing)
    times = next(iter(limbs.values())).times
    slow = {limb: part(one, every_frame(times)) for limb, one in limbs.items()}
    broken = inject_errors(StoredLimbs(1, name, slow), [limb for limb in WORN if limb != "torso"], NOISE_DEG, 0, seed)
    estimated = {
        limb: estimate_calibrated(SENSOR_HZ, own.acc, own.gyr, own.mag)[0] for limb, own in sampled.readings.items()
    }
    sensors = tuple(
        WornSensor(RECORDING, limb, limb, sampled.times, own.gyr, estimated[limb], True)
        for limb, own in sampled.readings.items()
    )
    return Trial(slow, WornTake(1, name, broken.limbs, sensors, {}), broken.truth, worn, sampled)


def sources(data: Path) -> dict[str, list[Source]]:
    """Return the takes of both archives that there are."""
    cmu = [
        Source(data / "cmu" / name[:2] / f"{name}.amc", data / "cmu" / name[:2] / f"{name[:2]}.asf", name[:2])
        for name in CMU
    ]
    hdm05 = [
        Source(motion, motion.parent / "HDM_mm.asf", "mm", is_divided=True)
        for motion in sorted((data / "hdm05/takes").glob("HDM_mm_take*.amc"))
    ]
    return {"CMU": [one for one in cmu if one.motion.is_file()], "HDM05": hdm05}


def synthetic(folder: Path) -> list[Source]:
    """Write a synthetic archive, and return its takes."""
    write_archive(folder, minutes=SYNTHETIC_MINUTES, actors=2, jobs=1)
    takes = sorted((folder / "takes").glob("*.amc"))
    return [
        Source(one, one.parent / f"{'_'.join(one.stem.split('_')[:2])}.asf", one.stem.split("_")[1]) for one in takes
    ]
