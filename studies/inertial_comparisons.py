"""Comparisons of the study of simulated sensors: quantities, bases of limbs, and shares of wrong frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.ops.evaluation.metrics import pooled
from kinedex.ops.inertial.hand_eye import DOUBTFUL
from kinedex.ops.inertial.limb_motion import LimbMotion
from kinedex.ops.inertial.limb_orientation import NONE
from kinedex.ops.inertial.rotations import conjugate, distance_deg, exp, log, multiply, rotate
from kinedex.ops.inertial.sensor_model import centred_acceleration, seeded_generator
from kinedex.pipelines.inertial.limb_error_curves import LimbCurve
from kinedex.pipelines.inertial.parameters import CalibrateParameters
from kinedex.pipelines.inertial.sensor_fits import FitTask, fit_together
from kinedex.pipelines.inertial.worn_sensors import Clock, stream_of
from studies.inertial_judged import Judged, curves_of, labels_of, limb_counts
from studies.inertial_trials import RECORDING, TRACK_HZ, every_frame, part, piece_of, read_limbs, standing

F64 = npt.NDArray[np.float64]

GRAVITY = np.array([0.0, 0.0, 9.81])
TAUS = (15.0, 20.0, 45.0)
SHARES = (0.2, 0.4, 0.6, 0.7)


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
            counts.append(replace(one, fits=fits, curves=curves_of(take, one.clock, fits)).counts("shank", TAUS))
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
    limbs = read_limbs(motion, skeleton, rotations=False)
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
    axis = seeded_generator(0, "robustness", name).normal(size=3)
    turn = exp(angle[:, None] * axis / np.linalg.norm(axis))
    return replace(limb, orientation=multiply(limb.orientation, turn))
