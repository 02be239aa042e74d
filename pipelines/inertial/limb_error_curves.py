"""Compute the errors of limbs against sensors and the runs of wrong frames; write and read their tables."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from kinedex.ops.arrays import F64, Bool
from kinedex.ops.inertial.disagreement import (
    Run,
    RunRules,
    auto_tau,
    direction_errors,
    frame_errors,
    jump_runs,
    wrong_runs,
)
from kinedex.ops.inertial.hand_eye import HeadingDrift
from kinedex.ops.inertial.limb_motion import LimbMotion
from kinedex.ops.inertial.limb_orientation import NONE, long_axis
from kinedex.ops.inertial.rotations import interpolate
from kinedex.ops.wording import counted
from kinedex.pipelines.inertial.parameters import LimbErrorsParameters
from kinedex.pipelines.inertial.worn_sensors import Clock, WornSensor, WornTake
from kinedex.storage.snapshot.row_groups import RowGroups
from kinedex.storage.snapshot.schemas import columns_table, result_schema
from kinedex.storage.store.store import Store

Names = npt.NDArray[np.str_]

Calibrations = Mapping[tuple[int, str, str], Mapping[str, Any]]
"""The rows of `sensor_calibration` with a mount, by take_id, recording and sensor."""

_ANY = np.array([1.0, 0.0, 0.0])  # any axis gives the same whole angle
ERRORS, RUNS = "limb_errors", "limb_error_runs"


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
        The whole error angle, its swing and its twist, in degrees; NaN if unknown. Only the swing is known if only the
        axis of the limb is.
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
    valid: Bool
    jump: Bool

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


def take_errors(
    take: WornTake, clocks: Mapping[tuple[int, str], Clock], calibrations: Calibrations, params: LimbErrorsParameters
) -> TakeErrors:
    """Compare the limbs of a take with the sensors that were worn on them.

    If a limb has several sensors, their curves are merged one after the other: the curve with more valid frames is
    kept, and its other frames are filled in from the next, because each recording may cover only a part of the take.

    Parameters
    ----------
    take : WornTake
        The take.
    clocks : mapping of (int, str) to Clock
        The clocks of recordings, by take_id and recording.
    calibrations : mapping of (int, str, str) to mapping
        The calibrations of sensors, by take_id, recording and sensor.
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
    for recording, names in lacking.items():
        which = names[0] if len(names) == 1 else counted(len(names), "sensor")
        left_out.append(f"{which} of {recording}: no clock or no mount")
    curves = tuple(found.values())
    tau = auto_tau((one.error, one.valid) for one in curves) if params.tau == "auto" else params.tau
    rules = RunRules(tau, params.low, params.gap_s, params.min_s)
    limb_runs = {
        one.limb: (wrong_runs(one.error, one.valid, one.rate_hz, rules), jump_runs(one.error, one.jump))
        for one in curves
    }
    return TakeErrors(curves, tau, limb_runs, left_out)


def _filled(one: LimbCurve, other: LimbCurve) -> LimbCurve:
    """Return a curve with frames of another curve filled in where its own frames are not valid."""
    lacks = other.valid & ~one.valid
    names = ("recording", "sensor", "degrees", "swing", "twist", "valid")
    return replace(one, **{name: np.where(lacks, getattr(other, name), getattr(one, name)) for name in names})


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
        found = frame_errors(orientation, limb.orientation, q_global, _values(row["q_mount"]), axis if swings else _ANY)
        degrees = found.degrees
        swing, twist = (found.swing, found.twist) if swings else (gap, gap)
    judged = np.isfinite(degrees) | np.isfinite(swing)
    valid = known & limb.valid & ~limb.jump & judged
    recording, name = (np.full(len(limb.times), text) for text in (sensor.recording, sensor.sensor))
    return LimbCurve(
        limb.limb, recording, name, limb.times, degrees, swing, twist, valid, limb.jump
    )  # fmt: skip


def _values(row: Mapping[str, float]) -> F64:
    return np.array(list(row.values()))


def error_table(take_id: int, take: str, found: TakeErrors, run: str, fingerprint: str | None) -> pa.Table:
    """Return the rows of a take's errors: limb by limb in the order of the curves, each with its frames in order."""
    shared = {"run": run, "take_id": take_id, "take": take, "tau_deg": found.tau_deg, "fingerprint": fingerprint}
    tables = [columns_table(ERRORS, _curve_columns(one), limb=one.limb, **shared) for one in found.curves]
    return pa.concat_tables(tables) if tables else result_schema(ERRORS).empty_table()


def _curve_columns(one: LimbCurve) -> dict[str, pa.Array]:
    columns = {
        "recording": pa.array(one.recording.tolist()),
        "sensor": pa.array(one.sensor.tolist()),
        "source_frame": pa.array(np.arange(len(one.times), dtype=np.int32)),
        "t": pa.array(one.times),
        "valid": pa.array(one.valid),
    }
    for name, values in (("degrees", one.degrees), ("swing_deg", one.swing), ("twist_deg", one.twist)):
        columns[name] = pa.array(values, mask=~np.isfinite(values))
    return columns


def run_rows(take_id: int, take: str, found: TakeErrors) -> Iterator[dict[str, Any]]:
    """Yield the rows of a take's runs, limb by limb: first runs of wrong frames, then jumps."""
    for curve in found.curves:
        for kind, own in zip(("distance", "jump"), found.runs[curve.limb], strict=True):
            for one in own:
                yield {
                    "take_id": take_id,
                    "take": take,
                    "limb": curve.limb,
                    "kind": kind,
                    "tau_deg": found.tau_deg,
                    **_range(one, curve),
                }


def _range(one: Run, curve: LimbCurve) -> dict[str, Any]:
    step = 1.0 / curve.rate_hz
    first = float(curve.times[one.start])
    known = not math.isnan(one.peak_deg)
    return {
        "start": one.start,
        "stop": one.stop,
        "start_seconds": first,
        "stop_seconds": first + (one.stop - one.start) * step,
        "seconds": (one.stop - one.start) * step,
        "peak_deg": one.peak_deg if known else None,
        "mean_deg": one.mean_deg if known else None,
    }


@dataclass
class ErrorStatistics:
    """Sums over the evaluated frames of a limb.

    Attributes
    ----------
    frames, wrong : int
        The numbers of all frames, and of frames above τ.
    total, squares : float
        The sums of errors (degrees) and of their squares.
    """

    frames: int = 0
    wrong: int = 0
    total: float = 0.0
    squares: float = 0.0

    def add(self, error: F64, tau_deg: F64) -> None:
        """Add frames by their errors in degrees, with the τ of each frame."""
        self.frames += len(error)
        self.wrong += int(np.count_nonzero(error > tau_deg))
        self.total += float(error.sum())
        self.squares += float(error @ error)

    def texts(self) -> tuple[str, str, str]:
        """Return mean, standard deviation, and the fraction of wrong frames, as text."""
        if not self.frames:
            return "–", "–", "–"
        mean = self.total / self.frames
        deviation = math.sqrt(max(self.squares / self.frames - mean**2, 0.0))
        return f"{mean:.1f}°", f"{deviation:.1f}°", f"{self.wrong / self.frames:.1%}"


@dataclass(frozen=True)
class StoredStatistics:
    """The error statistics that a stage has stored: those of each limb, and the τ of each take."""

    limbs: dict[str, ErrorStatistics]
    taus: dict[int, float]


def error_statistics(store: Store, stage: str) -> StoredStatistics:
    """Return the error statistics of all takes that a stage has stored."""
    found = StoredStatistics({}, {})
    parts = store.stage_parts(ERRORS, stage)
    for rows in store.result_pieces(ERRORS, parts, ["take_id", "limb", "degrees", "swing_deg", "valid", "tau_deg"]):
        for limb in pc.unique(rows.column("limb")).to_pylist():
            own = rows.filter(pc.equal(rows.column("limb"), limb))
            valid = own.filter(own.column("valid"))
            error = pc.coalesce(valid.column("degrees"), valid.column("swing_deg")).to_numpy()
            found.limbs.setdefault(limb, ErrorStatistics()).add(error, valid.column("tau_deg").to_numpy())
        taus = rows.group_by(["take_id"]).aggregate([("tau_deg", "min")])
        found.taus.update(zip(*(taus.column(name).to_pylist() for name in ("take_id", "tau_deg_min")), strict=True))
    return found


@dataclass(frozen=True, eq=False)
class JudgedLimb:
    """The stored errors of a limb of a take.

    Attributes
    ----------
    take_id : int
        Id of the take.
    take, limb : str
        Names.
    error : float64 array (T,)
        The whole error angle in degrees, or the swing if only that is known; NaN if neither is.
    valid : bool array (T,)
        The frames that are evaluated.
    rate_hz : float
        Frames per second.
    """

    take_id: int
    take: str
    limb: str
    error: F64
    valid: Bool
    rate_hz: float


def judged_limbs(store: Store, stage: str) -> Iterator[list[JudgedLimb]]:
    """Yield the limbs of each take whose errors a stage has stored, one take at a time."""
    groups = RowGroups(store, ERRORS, stage, "take_id")
    for take_id in groups.values:
        rows = groups.rows(take_id)
        limbs = pc.unique(rows.column("limb")).to_pylist()
        yield [_judged(rows.filter(pc.equal(rows.column("limb"), limb))) for limb in limbs]


def _judged(rows: pa.Table) -> JudgedLimb:
    error = pc.coalesce(rows.column("degrees"), rows.column("swing_deg"))
    times = rows.column("t").to_numpy()
    seconds = float(times[-1] - times[0])
    return JudgedLimb(
        rows.column("take_id")[0].as_py(),
        rows.column("take")[0].as_py(),
        rows.column("limb")[0].as_py(),
        error.to_numpy(),
        rows.column("valid").to_numpy().astype(np.bool_),
        (len(times) - 1) / seconds if seconds > 0 else 1.0,
    )
