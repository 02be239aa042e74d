"""Read the content of the page about limb errors from the results of stages that compare takes with sensors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from kinedex.catalog.limbs import LIMB_NAMES
from kinedex.ops.arrays import F64
from kinedex.ops.inertial.disagreement import TAU_DEG
from kinedex.ops.inertial.hand_eye import HeadingDrift
from kinedex.ops.inertial.limb_motion import LimbMotion
from kinedex.ops.inertial.rotations import conjugate, interpolate, multiply, rotate
from kinedex.ops.intervals import in_seconds
from kinedex.pipelines.inertial.worn_sensors import Clock, WornSensor, WornTake
from kinedex.pipelines.tracking.recording_runs import earlier_rows
from kinedex.reports.embedded_motions import pack
from kinedex.storage.snapshot.row_groups import RowGroups
from kinedex.storage.store.store import Store


@dataclass(frozen=True)
class StageKeys:
    """The stages whose results a page shows, each "<pipeline>/<stage>".

    Attributes
    ----------
    errors, clocks, calibration, sensors, limbs : str
        The stages of the kinds limb_errors, synchronise, calibrate_sensors, read_imu, and limb_orientations or
        break_track.
    evaluation : str or None
        The stage of the kind evaluate_limb_errors.
    """

    errors: str
    clocks: str
    calibration: str
    sensors: str
    limbs: str
    evaluation: str | None = None


@dataclass(frozen=True)
class MarkedRun:
    """An interval in which a limb is wrong, as detected or as marked by an annotator.

    Attributes
    ----------
    start_s, stop_s : float
        Start and end in seconds of the take.
    peak_deg, mean_deg : float or None
        The largest and the mean error; None for manual intervals, and if no frame of the interval counts.
    jump : bool
        True if the tracked limb jumps in this interval.
    """

    start_s: float
    stop_s: float
    peak_deg: float | None = None
    mean_deg: float | None = None
    jump: bool = False


@dataclass(frozen=True, eq=False)
class LimbErrors:
    """The errors of a limb in a take.

    Attributes
    ----------
    limb : str
        Its name.
    basis : str
        The basis of the limb's orientation.
    times : float64 array (T,)
        Times of the source frames in seconds.
    degrees, swing, twist : float64 array (T,)
        The error in degrees, and its parts swing and twist; NaN where a frame does not count.
    tau_deg : float
        The threshold τ.
    automatic : tuple of MarkedRun
        The runs of frames above the threshold.
    manual : dict of str to tuple of MarkedRun
        Annotator → the intervals that this person marked.
    """

    limb: str
    basis: str
    times: F64
    degrees: F64
    swing: F64
    twist: F64
    tau_deg: float
    automatic: tuple[MarkedRun, ...] = ()
    manual: Mapping[str, tuple[MarkedRun, ...]] = field(default_factory=dict)

    @property
    def known(self) -> F64:
        """The errors of the frames for which an error is known (not NaN)."""
        return self.degrees[np.isfinite(self.degrees)]

    @property
    def runs(self) -> int:
        """The number of intervals that were found wrong."""
        return sum(not one.jump for one in self.automatic)

    @property
    def wrong(self) -> float:
        """The fraction of the frames with a known error whose error is above τ; 0 if there are none."""
        known = self.known
        return float((known > self.tau_deg).mean()) if len(known) else 0.0


@dataclass(frozen=True, eq=False)
class TakeErrors:
    """A take that was compared with sensors.

    Attributes
    ----------
    take_id : int
        Its id.
    take : str
        Its name.
    frames : int
        The length of the take in analysis frames.
    seconds : float
        The length of the take in seconds.
    limbs : tuple of LimbErrors
        The limbs with a sensor.
    clocks, calibrations : tuple of dict
        The rows of the take in `sensor_sync` and `sensor_calibration`.
    """

    take_id: int
    take: str
    frames: int
    seconds: float
    limbs: tuple[LimbErrors, ...]
    clocks: tuple[Mapping[str, Any], ...] = ()
    calibrations: tuple[Mapping[str, Any], ...] = ()

    @property
    def wrong(self) -> float:
        """The fraction of frames above τ, over all limbs."""
        known = sum(len(one.known) for one in self.limbs)
        return sum(one.wrong * len(one.known) for one in self.limbs) / known if known else 0.0

    @property
    def worst(self) -> LimbErrors | None:
        """The limb with the largest fraction of wrong frames; of several, the one with the largest error.

        None if no error is known.
        """
        known = [one for one in self.limbs if len(one.known)]
        return max(known, key=lambda one: (one.wrong, float(one.known.max())), default=None)


@dataclass(frozen=True)
class Refusal:
    """A take, recording or sensor that was excluded, with the reason."""

    take: str
    what: str
    reason: str


def refusals(
    clocks: Sequence[Mapping[str, Any]],
    calibrations: Sequence[Mapping[str, Any]],
    log: Sequence[Mapping[str, Any]],
) -> list[Refusal]:
    """Return the takes, recordings and sensors that were excluded, with reasons.

    The sensors of an excluded recording are not listed.

    Parameters
    ----------
    clocks, calibrations, log : sequence of dict
        Rows of `sensor_sync`, `sensor_calibration` and `ingest_log`.
    """
    found = [Refusal("", str(row["source"]), str(row["message"])) for row in log]
    without = set()
    for row in clocks:
        if row["left_out"]:
            without.add((row["take_id"], row["recording"]))
            found.append(Refusal(str(row["take"]), f"recording {row['recording']}", str(row["left_out"])))
    for row in calibrations:
        if row["left_out"] and (row["take_id"], row["recording"]) not in without:
            what = f"{row['limb']}, sensor {row['sensor']}"
            found.append(Refusal(str(row["take"]), what, str(row["left_out"])))
    return found


class StoredErrors:
    """The errors of takes that stages have stored; the frames of a take are read when they are requested.

    Parameters
    ----------
    store : Store
        The store.
    keys : StageKeys
        The stages.
    """

    def __init__(self, store: Store, keys: StageKeys) -> None:
        self._store, self._names = store, {take_id: name for name, take_id in store.take_ids.items()}
        live = set(store.manifest.live_takes)
        self._rows = RowGroups(store, "limb_errors", keys.errors, "take_id")
        self.clocks = [row for row in earlier_rows(store, "sensor_sync", keys.clocks) if row["take_id"] in live]
        self.calibrations = [
            row for row in earlier_rows(store, "sensor_calibration", keys.calibration) if row["take_id"] in live
        ]
        self.log = earlier_rows(store, "ingest_log", keys.sensors)
        self.metrics = earlier_rows(store, "limb_error_metrics", keys.evaluation) if keys.evaluation else []
        self._runs = earlier_rows(store, "limb_error_runs", keys.errors)
        self._labels = earlier_rows(store, "limb_labels", keys.evaluation) if keys.evaluation else []
        self._annotators = sorted({str(row["annotator"] or UNNAMED) for row in self._labels})
        self.take_ids = [take_id for take_id in self._rows.values if take_id in live]
        self._taus: dict[int, float] = {}

    def tau_of(self, take_id: int) -> float:
        """Return the τ of a take in degrees."""
        if take_id not in self._taus:
            rows = self._rows.rows(take_id)
            self._taus[take_id] = float(rows.column("tau_deg")[0].as_py()) if rows.num_rows else TAU_DEG
        return self._taus[take_id]

    def take(self, take_id: int) -> TakeErrors:
        """Return a take with the errors of its limbs."""
        frames = self._store.take_frames[take_id]
        rows = self._rows.rows(take_id)
        calibrations = tuple(row for row in self.calibrations if row["take_id"] == take_id)
        bases = {str(row["limb"]): str(row["basis"] or "") for row in calibrations if not row["left_out"]}
        present = set(pc.unique(rows.column("limb")).to_pylist())
        limbs = tuple(self._limb(take_id, limb, bases.get(limb, ""), rows) for limb in LIMB_NAMES if limb in present)
        last = max((float(one.times[-1]) for one in limbs if len(one.times)), default=0.0)
        return TakeErrors(
            take_id, self._names[take_id], frames, max(in_seconds(frames, self._store.rate_hz), last), limbs,
            tuple(row for row in self.clocks if row["take_id"] == take_id), calibrations,
        )  # fmt: skip

    def _limb(self, take_id: int, limb: str, basis: str, rows: pa.Table) -> LimbErrors:
        """Return the errors of a limb; of several recordings that cover a frame, one in which it counts is used."""
        own = rows.filter(pc.equal(rows.column("limb"), limb))
        frame, valid = own.column("source_frame").to_numpy(), _floats(own, "valid") > 0.0
        order = np.lexsort((~valid, frame))
        order = order[np.concatenate([[True], np.diff(frame[order]) > 0])] if len(order) else order
        whole, swing, twist = (_floats(own, name) for name in ("degrees", "swing_deg", "twist_deg"))
        degrees = np.where(np.isfinite(whole), whole, swing)
        counted = [np.where(valid, values, np.nan)[order] for values in (degrees, swing, twist)]
        return LimbErrors(
            limb, basis, _floats(own, "t")[order], counted[0], counted[1], counted[2], self.tau_of(take_id),
            tuple(_run(row) for row in self._runs if (row["take_id"], row["limb"]) == (take_id, limb)),
            self._manual(take_id, limb),
        )  # fmt: skip

    def _manual(self, take_id: int, limb: str) -> dict[str, tuple[MarkedRun, ...]]:
        """Return a dict from annotator to the intervals that this annotator has marked as wrong for a limb."""
        found: dict[str, list[MarkedRun]] = {who: [] for who in self._annotators}
        for row in self._labels:
            if (row["take_id"], row["limb"]) == (take_id, limb):
                marked = MarkedRun(float(str(row["start_seconds"])), float(str(row["stop_seconds"])))
                found[str(row["annotator"] or UNNAMED)].append(marked)
        return {who: tuple(runs) for who, runs in found.items()}


UNNAMED = "manual"
"""The name that is shown for an annotator whom the label file does not name."""


def _floats(rows: pa.Table, column: str) -> F64:
    values: F64 = pc.cast(rows.column(column), pa.float64()).to_numpy(zero_copy_only=False)
    return values


def _run(row: Mapping[str, Any]) -> MarkedRun:
    return MarkedRun(
        row["start_seconds"], row["stop_seconds"], row["peak_deg"], row["mean_deg"], jump=row["kind"] == "jump"
    )


LENGTH_M = 0.18
"""Length of a drawn axis in metres."""

MAX_BYTES = 6_000_000
"""The largest size of all axes of a page."""

POINTS = 7
"""Points of a limb: its middle, and the tips of the axes x, y and z of the take and of the sensor."""


def packed_triads(
    take: WornTake,
    clocks: Mapping[tuple[int, str], Clock],
    calibrations: Sequence[Mapping[str, Any]],
    frames: int,
    rate_hz: float,
) -> dict[str, Any] | None:
    """Return the axes of the limbs of a take in every frame, in the form that the player draws.

    Parameters
    ----------
    take : WornTake
        The take with its limbs and sensors.
    clocks : dict of (int, str) to Clock
        Take id and recording → the clock.
    calibrations : sequence of dict
        The take's rows of `sensor_calibration`.
    frames : int
        The length of the take in analysis frames.
    rate_hz : float
        Analysis frames per second.

    Returns
    -------
    dict or None
        The object that the player reads; None if no sensor of the take is calibrated.
    """
    rows = {(row["recording"], row["sensor"]): row for row in calibrations if not row["left_out"]}
    points: dict[str, F64] = {}
    for sensor in take.sensors:
        row, clock = rows.get((sensor.recording, sensor.sensor)), clocks.get((take.take_id, sensor.recording))
        if row is not None and clock is not None:
            own = _points(take.limbs[sensor.limb], sensor, row, clock, frames, rate_hz)
            before = points.get(sensor.limb, own)  # several recordings of a take: each covers other frames
            points[sensor.limb] = np.where(np.isfinite(before), before, own)
    if not points:
        return None
    packed = pack(take.take, np.concatenate(list(points.values())), rate_hz)
    return {**asdict(packed), "count": POINTS * len(points), "limbs": list(points)}


def _points(
    limb: LimbMotion, sensor: WornSensor, row: Mapping[str, Any], clock: Clock, frames: int, rate_hz: float
) -> F64:
    """Return the centre of a limb, and the ends of its axes by the take and by the sensor, as points (7, 3, T)."""
    times = np.arange(frames) / rate_hz
    nearest = np.searchsorted(limb.times, times).clip(0, len(limb.times) - 1)
    before = (nearest - 1).clip(0)
    nearest = np.where(times - limb.times[before] < limb.times[nearest] - times, before, nearest)
    at = limb.times[nearest]
    reported, known = interpolate(sensor.times, sensor.orientation, clock.sensor_time(at))
    knots = row["drift"] or []
    drift = HeadingDrift(np.array([one["t"] for one in knots]), np.array([one["degrees"] for one in knots]))
    reported = drift.corrected(at, reported)
    reported[~known] = np.nan
    world = np.array([row["q_global"][axis] for axis in "wxyz"])
    middle = limb.position[nearest]
    points = np.full((POINTS, 3, frames), np.nan)
    points[0] = middle.T
    axes = LENGTH_M * np.eye(3)
    if row["q_mount"] is None:
        direction = np.array([row["direction"][axis] for axis in "xyz"])
        points[1] = (middle + LENGTH_M * limb.direction[nearest]).T
        points[4] = (middle + LENGTH_M * rotate(multiply(world, reported), direction)).T
        return points
    mount = np.array([row["q_mount"][axis] for axis in "wxyz"])
    predicted = multiply(multiply(world, reported), conjugate(mount))
    for i in range(3):
        points[1 + i] = (middle + rotate(limb.orientation[nearest], axes[i])).T
        points[4 + i] = (middle + rotate(predicted, axes[i])).T
    points[1:4][:, :, ~limb.valid[nearest]] = np.nan
    return points
