"""`python -m studies.inertial_simulated DATA`: print how well simulated sensors find errors that are put into takes.

DATA is a folder with cmu and hdm05. Five takes of CMU, pieces of HDM05's takes and takes of a synthetic archive wear
five sensors; all of them stand for 3 s at both ends, the tracker has 40 Hz and smooth noise of 1.5°, and all limbs but
the torso are broken. It takes a minute.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from kinedex.catalog.imu_grades import load_grade
from kinedex.catalog.limbs import WORN
from kinedex.catalog.skeletons.mappings import load_mappings
from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.evaluation.metrics import Counts, pooled
from kinedex.ops.evaluation.threshold_counts import threshold_counts
from kinedex.ops.inertial.limb_orientation import NONE
from kinedex.ops.inertial.noise import generator
from kinedex.ops.inertial.observability import DOUBTFUL
from kinedex.ops.inertial.orientation_filter import estimate_calibrated
from kinedex.ops.inertial.rotations import conjugate, distance_deg, exp, interpolate, log, multiply, rotate
from kinedex.ops.inertial.sensor_model import centred_acceleration
from kinedex.pipelines.evaluation.markdown import grid
from kinedex.pipelines.inertial.broken_takes import LimbLabel, break_take
from kinedex.pipelines.inertial.error_parameters import LimbErrorsParameters
from kinedex.pipelines.inertial.limb_error_curves import LimbCurve, take_errors
from kinedex.pipelines.inertial.limb_motion import LimbMotion, take_limbs
from kinedex.pipelines.inertial.limb_tables import StoredLimbs
from kinedex.pipelines.inertial.sensor_fits import FitTask, SensorFit, fit_together
from kinedex.pipelines.inertial.sensor_parameters import CalibrateParameters, SynchroniseParameters
from kinedex.pipelines.inertial.sensor_tables import calibration_row
from kinedex.pipelines.inertial.synchronisation import synchronise
from kinedex.pipelines.inertial.worn_sensors import Clock, WornSensor, WornTake, stream_of
from kinedex.pipelines.simulation.imu_pieces import LimbPiece, Piece, take_pieces
from kinedex.pipelines.simulation.imu_sensors import SampledPiece, Wearing, Worn, sample_piece, worn_sensors
from kinedex.pipelines.synth.archive import write_archive
from kinedex.storage.formats.motion.reader import MotionFile, ReadSettings
from kinedex.storage.formats.motion.segments import read_segments

F64 = npt.NDArray[np.float64]

CMU = ("01_01", "02_05", "02_10", "03_04", "86_09")
"""The takes of CMU."""
LEAST_S, MOST_S = 3.0, 60.0
"""Pieces of HDM05, whose takes are clips in a row, have so many seconds at least, all pieces so many at most."""
SYNTHETIC_MINUTES = 6.0
"""The size of the synthetic archive, whose clips wear no sensors."""

GRAVITY = np.array([0.0, 0.0, 9.81])
STAND_S, EASE_S, NOISE_DEG, SENSOR_HZ, TRACK_HZ = 3.0, 1.0, 1.5, 100.0, 40.0
LEVER_M = (0.03, 0.0, 0.02)
TAUS = (15.0, 20.0, 45.0)
SHARES = (0.2, 0.4, 0.6, 0.7)
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
    worn: Worn
    sampled: SampledPiece


@dataclass(frozen=True, eq=False)
class Judged:
    """A trial after synchronisation and calibration: its clock, its fits, and the errors of its limbs."""

    trial: Trial
    clock: Clock
    fits: list[SensorFit]
    curves: tuple[LimbCurve, ...]

    def counts(self, limbs: str, taus: Sequence[float]) -> list[Counts]:
        """Return the counts of limbs whose names end so at thresholds."""
        own = [
            limb_counts(one.error, one.valid, labels_of(self.trial, one.limb), taus)
            for one in self.curves
            if one.limb.endswith(limbs) and one.limb != "torso"
        ]
        return [pooled(some) for some in zip(*own, strict=True)]


def read_trials(takes: Sequence[Source], grade: str, seed: int = 0) -> Iterator[Trial]:
    """Yield takes that wear sensors of a grade, broken."""
    for take in takes:
        limbs = read_limbs(take.motion, take.skeleton)
        for number, kept in enumerate(pieces_of(limbs) if take.is_divided else [piece_of(limbs)], 1):
            still = standing({name: part(one, kept) for name, one in limbs.items()})
            name = f"{take.motion.stem} piece {number}" if take.is_divided else take.motion.stem
            yield make_trial(name, take.actor, still, grade, seed)


def read_limbs(motion: Path, skeleton: Path, *, turns: bool = True) -> dict[str, LimbMotion]:
    """Return the limbs of a take; without turns by its joints alone."""
    segments = read_segments(
        MotionFile(motion, skeleton), load_mappings("auto", JOINTS), tuple(JOINTS), ReadSettings(), WORN
    )
    return take_limbs(segments if turns else replace(segments, turns={}), tuple(JOINTS), WORN).limbs


def piece_of(limbs: dict[str, LimbMotion]) -> slice:
    """Return the frames between jumps where those are most, for `MOST_S` at most."""
    piece = max(take_pieces(limbs, WORN, True).pieces, key=lambda one: one.stop - one.start)
    times = next(iter(limbs.values())).times
    return slice(piece.start, min(piece.stop, piece.start + int(MOST_S / (times[1] - times[0]))))


def pieces_of(limbs: dict[str, LimbMotion]) -> list[slice]:
    """Return the frames between jumps wherever those last `LEAST_S`."""
    times = next(iter(limbs.values())).times
    least = LEAST_S / (times[1] - times[0])
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
    wearing = Wearing(seed, SENSOR_HZ, load_grade(grade), LEVER_M)
    worn = worn_sensors(wearing, name, actor, limbs)
    pieces = {limb: LimbPiece(one.times, one.position, one.orientation) for limb, one in limbs.items()}
    sampled = sample_piece(Piece(0, len(next(iter(limbs.values())).times), pieces), 0, name, worn, wearing)
    times = next(iter(limbs.values())).times
    slow = {limb: part(one, every_frame(times)) for limb, one in limbs.items()}
    broken = break_take(StoredLimbs(1, name, slow), [limb for limb in WORN if limb != "torso"], NOISE_DEG, 0, seed)
    estimated = {
        limb: estimate_calibrated(SENSOR_HZ, own.acc, own.gyr, own.mag)[0] for limb, own in sampled.readings.items()
    }
    sensors = tuple(
        WornSensor(RECORDING, limb, limb, sampled.times, own.gyr, estimated[limb], True)
        for limb, own in sampled.readings.items()
    )
    return Trial(slow, WornTake(1, name, broken.limbs, sensors, {}), broken.truth, worn, sampled)


def judge_together(trials: Sequence[Trial]) -> list[Judged]:
    """Calibrate trials of one actor together, each with the clock that was found from itself."""
    clocks: dict[tuple[int, str], Clock] = {}
    takes = list[WornTake]()
    for number, trial in enumerate(trials, 1):
        clocks[number, RECORDING] = clock_of(trial)
        takes.append(replace(trial.take, take_id=number))
    fits = fit_together(FitTask(tuple(takes), clocks, CalibrateParameters.model_validate({"from": "actor"})))
    return [
        Judged(trial, clocks[number, RECORDING], own, _curves(trial.take, clocks[number, RECORDING], own))
        for number, trial in enumerate(trials, 1)
        for own in [[one for one in fits if one.take_id == number]]
    ]


def judge(trial: Trial) -> Judged:
    """Find clock and mounts of a trial from itself, errors and all, and compare its limbs with the sensors."""
    clock = clock_of(trial)
    fits = fit_together(FitTask((trial.take,), {(1, RECORDING): clock}, CalibrateParameters.model_validate({})))
    return Judged(trial, clock, fits, _curves(trial.take, clock, fits))


def clock_of(trial: Trial) -> Clock:
    """Find the clock of a trial from itself."""
    found = synchronise(trial.take, RECORDING, SynchroniseParameters.model_validate({}))
    assert found.clock is not None, found.left_out
    return found.clock


def _curves(take: WornTake, clock: Clock, fits: Sequence[SensorFit]) -> tuple[LimbCurve, ...]:
    rows: dict[tuple[int, str, str], Any] = {
        (1, RECORDING, one.sensor): {"drift": (), **calibration_row(one)} for one in fits if not one.left_out
    }
    return take_errors(take, {(1, RECORDING): clock}, rows, LimbErrorsParameters.model_validate({})).curves


def labels_of(trial: Trial, limb: str) -> list[tuple[int, int]]:
    """Return the frames of a limb that are wrong."""
    return [(one.start, one.stop) for one in trial.labels if one.limb == limb]


def limb_counts(
    error: F64, valid: npt.NDArray[np.bool_], labels: Sequence[tuple[int, int]], taus: Sequence[float]
) -> list[Counts]:
    """Return the counts of a limb; frames that do not count are taken out of both sides."""
    place = np.concatenate([[0], np.cumsum(valid)])
    bounds = place[np.asarray(labels, np.int64).reshape(-1, 2)]
    return threshold_counts(error[valid], bounds[bounds[:, 0] < bounds[:, 1]], taus)


def calibration_errors(judged: Sequence[Judged]) -> list[str]:
    """Return a row's figures: offsets in ms, and q_G and q_L off by degrees."""
    offsets = [1000 * abs(one.clock.offset_s - one.trial.worn.clock.offset_s) for one in judged]
    worlds, mounts = list[float](), list[float]()
    for one in judged:
        for fit in one.fits:
            if fit.fit is not None and not fit.left_out:
                worlds.append(float(distance_deg(fit.fit.q_global, one.trial.worn.q_global)))
                mounts.append(float(distance_deg(fit.fit.q_mount, one.trial.worn.mounts[fit.limb])))
    return [
        f"{max(offsets):.2f}",
        f"{np.median(worlds):.2f}, {max(worlds):.2f}",
        f"{np.median(mounts):.2f}, {np.percentile(mounts, 95):.2f}, {max(mounts):.2f}",
    ]


def detection(judged: Sequence[Judged], limbs: str) -> list[str]:
    """Return precision, recall and F (frames) at each τ."""
    counts = [pooled(some) for some in zip(*(one.counts(limbs, TAUS) for one in judged), strict=True)]
    return [f"{one.p1:.2f} / {one.r1:.2f} / {one.f1:.3f}" for one in counts]


def quantities(judged: Sequence[Judged]) -> list[list[str]]:
    """Return F (frames) of orientation, angular velocity and acceleration at their best thresholds (7.6.4)."""
    scales = {"orientation, °": 1.0, "angular velocity, °/s": 5.0, "acceleration, m/s²": 0.1}
    rows = []
    for place, (name, step) in enumerate(scales.items()):
        taus = [step * k for k in range(1, 181)]
        counts = []
        for one in judged:
            for curve in one.curves:
                if curve.limb != "torso":
                    error = _differences(one, curve)[place]
                    valid = curve.valid & np.isfinite(error)
                    counts.append(limb_counts(error, valid, labels_of(one.trial, curve.limb), taus))
        found = [pooled(some) for some in zip(*counts, strict=True)]
        best = max(range(len(found)), key=lambda k: found[k].f1)
        figures = (found[best].p1, found[best].r1, found[best].f1)
        rows.append([name, f"{taus[best]:g}", *(f"{value:.2f}" for value in figures)])
    return rows


def _differences(one: Judged, curve: LimbCurve) -> tuple[F64, F64, F64]:
    """Return the differences between sensor and prediction: of orientations, turn rates and specific forces."""
    fit = next(fit for fit in one.fits if fit.limb == curve.limb).fit
    assert fit is not None
    sensor = next(sensor for sensor in one.trial.take.sensors if sensor.limb == curve.limb)
    stream = stream_of(one.trial.take, sensor, one.clock)
    predicted = multiply(multiply(conjugate(fit.q_global), stream.track), fit.q_mount)
    rates = [_rates(q) for q in (predicted, stream.sensor)]
    turning = np.degrees(np.linalg.norm(rates[0] - rates[1], axis=1))
    at = one.clock.sensor_time(curve.times)
    acc = one.trial.sampled.readings[curve.limb].acc
    read = np.stack([np.interp(at, sensor.times, acc[:, k]) for k in range(3)], axis=1)
    moving = centred_acceleration(one.trial.take.limbs[curve.limb].position, TRACK_HZ)
    force = rotate(conjugate(predicted), rotate(conjugate(fit.q_global), moving) + GRAVITY)
    return curve.error, np.concatenate([turning[:1], turning]), np.linalg.norm(force - read, axis=1)


def _rates(orientation: F64) -> F64:
    return np.asarray(log(multiply(conjugate(orientation[:-1]), orientation[1:])) * TRACK_HZ)


def bases(judged: Sequence[Judged], joints: dict[str, dict[str, LimbMotion]]) -> list[list[str]]:
    """Return F (frames) of shanks at each τ with orientations of nodes, of hinges, and with long axes alone."""
    rows = []
    for basis in ("full", "hinge", NONE):
        counts = []
        for one in judged:
            limbs = dict(one.trial.take.limbs)
            for name in ("lshank", "rshank"):
                limbs[name] = _of_basis(basis, limbs[name], one.trial.true[name], joints[one.trial.take.take][name])
            take = replace(one.trial.take, limbs=limbs)
            fits = fit_together(FitTask((take,), {(1, RECORDING): one.clock}, CalibrateParameters.model_validate({})))
            counts.append(replace(one, fits=fits, curves=_curves(take, one.clock, fits)).counts("shank", TAUS))
        figures = [pooled(some) for some in zip(*counts, strict=True)]
        rows.append([basis, *(f"{one.p1:.2f} / {one.r1:.2f} / {one.f1:.3f}" for one in figures)])
    return rows


def _of_basis(basis: str, broken: LimbMotion, true: LimbMotion, joints: LimbMotion) -> LimbMotion:
    """Return a limb as another basis knows it, with the same errors in the world."""
    if basis == "full":
        return broken
    turn = multiply(broken.orientation, conjugate(true.orientation))
    direction = rotate(turn, true.direction)
    if basis == NONE:
        lost = np.full_like(broken.orientation, np.nan)
        return replace(broken, basis=NONE, orientation=lost, direction=direction)
    return replace(broken, basis=basis, orientation=multiply(turn, joints.orientation), direction=direction)


def known_by_joints(motion: Path, skeleton: Path) -> dict[str, LimbMotion]:
    """Return the shanks of a take at 40 Hz as hinges, in the frames of its trial."""
    kept = piece_of(read_limbs(motion, skeleton))
    limbs = read_limbs(motion, skeleton, turns=False)
    found = standing({name: part(limbs[name], kept) for name in ("lshank", "rshank")})
    return {name: part(one, every_frame(one.times)) for name, one in found.items()}


def robustness(judged: Sequence[Judged]) -> list[list[str]]:
    """Return the worst q_L of a shank when a part of it drifts to 120°: alone, by its right frames, and beside others.

    The second row counts the takes whose right frames turn enough to determine a mount, beside the worst of them.
    """
    rows = [
        ["this limb alone"],
        ["of these, right frames turn enough"],
        ["its right frames alone"],
        ["with four others"],
    ]
    for share in SHARES:
        alone, enough, right, beside = list[float](), list[float](), list[float](), list[float]()
        for one in judged:
            limbs = {**one.trial.true, "lshank": drifting(one.trial.true["lshank"], share, one.trial.take.take)}
            frames = right_frames(len(limbs["lshank"].times), share)
            kept = replace(limbs["lshank"], valid=limbs["lshank"].valid & frames)
            by_right, observability = _shank_off(one, {"lshank": kept})
            right.append(by_right)
            alone.append(_shank_off(one, {"lshank": limbs["lshank"]})[0])
            beside.append(_shank_off(one, limbs)[0])
            if observability >= DOUBTFUL:
                enough.append(alone[-1])
        cells = [f"{max(alone):.1f}", f"{max(enough):.1f} ({len(enough)})" if enough else "–"]
        for row, cell in zip(rows, [*cells, f"{max(right):.1f}", f"{max(beside):.1f}"], strict=True):
            row.append(cell)
    return rows


def _shank_off(one: Judged, limbs: dict[str, LimbMotion]) -> tuple[float, float]:
    """Return by how much the left shank's mount is off, and its observability, calibrated from some limbs."""
    clocks = {(1, RECORDING): Clock(one.trial.worn.clock.offset_s, one.trial.worn.clock.ppm)}
    sensors = tuple(sensor for sensor in one.trial.take.sensors if sensor.limb in limbs)
    take = replace(one.trial.take, limbs=limbs, sensors=sensors)
    fits = fit_together(FitTask((take,), clocks, CalibrateParameters.model_validate({})))
    fit = next(fit for fit in fits if fit.limb == "lshank").fit
    assert fit is not None
    return float(distance_deg(fit.q_mount, one.trial.worn.mounts["lshank"])), fit.observability


def right_frames(count: int, share: float) -> npt.NDArray[np.bool_]:
    """Return the frames (T,) beside so large a part in the middle."""
    first = round(0.5 * (1.0 - share) * count)
    frames = np.ones(count, np.bool_)
    frames[first : first + round(share * count)] = False
    return frames


def drifting(limb: LimbMotion, share: float, name: str) -> LimbMotion:
    """Return a limb of which so large a part, in the middle, drifts linearly to 120° about a random axis."""
    wrong = ~right_frames(len(limb.times), share)
    angle = np.zeros(len(limb.times))
    angle[wrong] = np.linspace(0.0, np.radians(120.0), int(wrong.sum()))
    axis = generator(0, "robustness", name).normal(size=3)
    turn = exp(angle[:, None] * axis / np.linalg.norm(axis))
    return replace(limb, orientation=multiply(limb.orientation, turn))


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


def lines(archives: Mapping[str, Sequence[Source]]) -> Iterator[str]:
    """Yield the tables as Markdown."""
    calibrated, found = list[list[str]](), list[list[str]]()
    good = list[Judged]()
    for archive, takes in archives.items():
        for grade in ("good", "cheap") if takes else ():
            trials = list(read_trials(takes, grade))
            judged = [judge(trial) for trial in trials]
            good = judged if (archive, grade) == ("CMU", "good") else good
            rows = {f"{archive}, {grade}": judged}
            if takes[0].is_divided:
                rows[f"{archive}, {grade}, pieces together"] = judge_together(trials)
            for name, some in rows.items():
                calibrated.append([name, str(len(some)), *calibration_errors(some)])
                found += [[f"{name}, {limbs}s", *detection(some, limbs)] for limbs in ("shank", "hand")]
    header = ["takes, sensors", "number", "offset, worst, ms", "q_G median, worst, °", "q_L median, 95 %, worst, °"]
    yield from grid(header, calibrated)
    at = [f"P / R / F (frames), τ = {tau:g}°" for tau in TAUS]
    yield from grid(["takes, sensors", *at], found)
    if good:
        yield from grid(["CMU, good, best threshold", "τ", "P", "R", "F (frames)"], quantities(good))
        joints = {one.motion.stem: known_by_joints(one.motion, one.skeleton) for one in archives["CMU"]}
        yield from grid(["CMU, good, shanks", *at], bases(good, joints))
        yield from grid(["q_L worst, °", *(f"{share:.0%} wrong" for share in SHARES)], robustness(good))


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path, help="folder with cmu and hdm05")
    archives = sources(parser.parse_args(arguments).data)
    with tempfile.TemporaryDirectory() as folder:
        for line in lines({**archives, "synthetic": synthetic(Path(folder) / "archive")}):
            sys.stdout.write(line + "\n")


if __name__ == "__main__":
    main()
