"""Takes that were tracked or stabilised: bodies with their poses, tables of their results, and their evaluation."""

from __future__ import annotations

import csv
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from kinedex.catalog.features import FeatureSet
from kinedex.catalog.kinematics import load_kinematic_chain
from kinedex.ops.arrays import F64, Bool
from kinedex.ops.body.kinematic_chain import ChainBody, Poses, forward, rotation_of, vector_of
from kinedex.ops.body.kinematics import quaternions
from kinedex.ops.errors import KinedexError
from kinedex.ops.intervals import in_seconds
from kinedex.ops.priors.allocation import PriorRow
from kinedex.ops.tracking.observations import Rays
from kinedex.ops.tracking.ray_residuals import ray_residuals
from kinedex.pipelines.inertial.limb_error_curves import judged_limbs
from kinedex.pipelines.tracking.chain_tracker import ChainTracker, frame_statistics
from kinedex.pipelines.tracking.recorded_takes import Provenance, TruePositions, at_rate, read_truth
from kinedex.storage.formats.motion.reader import Body
from kinedex.storage.snapshot.schemas import TRACK_FORMAT, result_schema, result_table
from kinedex.storage.store.store import Store

TRACKED, STABILISED = "_tracked", "_stabilised"
"""The suffixes of the names of takes that were tracked from a recording, and of those that were stabilised."""

UNSEEN_S = 0.5
"""The gap, in seconds, above which frames that no camera has seen are invalid."""

TRACK_KINDS: Sequence[str] = ("tracks", "chain_poses", "track_frames", "track_cameras")
"""The kinds of results of a tracked take; a stabilised one also has `priors`."""

LIMBS = tuple(side + name for name in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist") for side in "lr")
"""The joints of arms and legs, whose errors are evaluated."""

FAILURES = "failures.csv"
"""A table beside a truth file, with columns recording, start, stop: intervals where a simulated detector fails."""

SENSORS, LIMB = "sensors", "limb"
"""The reference of evaluations by sensors (also the scope of all limbs together), and the scope of a single limb."""


@dataclass(frozen=True, eq=False)
class Track:
    """A take that was tracked or stabilised.

    Attributes
    ----------
    name : str
        Its name.
    provenance : Provenance
        Its origin.
    body : ChainBody
        The body, with its bone lengths.
    poses : Poses
        Its poses, at the rate of the recording.
    rate_hz : float
        Frames per second of the poses.
    valid : bool array (T,)
        False in frames within gaps of the observations longer than `UNSEEN_S`.
    recipe : str
        A hash of everything that determines the track, except its files.
    actor : str, optional
        The actor.
    warnings : tuple of str
        Warnings about the take.
    """

    name: str
    provenance: Provenance
    body: ChainBody
    poses: Poses
    rate_hz: float
    valid: Bool
    recipe: str
    actor: str | None = None
    warnings: tuple[str, ...] = ()

    @property
    def format(self) -> str:
        """The format of the take."""
        return TRACK_FORMAT

    def joints(self, features: FeatureSet) -> Body:
        """Return the joints as those of a motion file, in the order of a feature set."""
        chain = self.body.chain
        positions, turned = forward(self.body, self.poses)
        at = {name: positions[j] for j, name in enumerate(chain.joints)}
        unknown = tuple(joint for joint in features.joints if joint not in at)
        nowhere = np.full((3, positions.shape[2]), np.nan)
        return Body(
            positions=np.stack([at.get(joint, nowhere) for joint in features.joints]),
            orientation=quaternions(turned[:, 0].reshape(-1, 9).T),
            rate_hz=self.rate_hz,
            unit="metre",
            skeleton=chain.name,
            unknown=unknown,
            warnings=self.warnings,
            valid=None if self.valid.all() else self.valid,
        )


def observed_frames(seen: Bool, rate_hz: float) -> Bool:
    """Return the valid frames of a track: all except those in gaps of the observations longer than 0.5 s.

    Parameters
    ----------
    seen : bool array (T,)
        The frames in which something was observed.
    rate_hz : float
        Frames per second.
    """
    valid = seen.copy()
    edges = np.flatnonzero(np.diff(np.concatenate([[True], seen, [True]])))
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        if stop - start <= UNSEEN_S * rate_hz:
            valid[start:stop] = True
    return valid


def stabilised_name(take: str) -> str:
    """Return the name of a take after stabilisation; the suffix of a tracked take is replaced."""
    return take.removesuffix(TRACKED) + STABILISED


@dataclass(frozen=True, eq=False)
class TrackResult:
    """A track with everything that its results are made from.

    Attributes
    ----------
    take_id : int
        Id of the take.
    take : str
        Its name.
    tracker : ChainTracker
        The tracker with its observations.
    poses : Poses
        The poses.
    costs : float64 array (T,)
        Cost of the observations of each frame.
    fingerprint : str
        A hash of everything that determines the track.
    body_from : str
        Origin of the bone lengths.
    cameras : tuple of str
        Names of the cameras.
    recording : str, optional
        Its recording.
    track_of : str, optional
        The take that was stabilised.
    lost : bool array (T,), optional
        The frames in which the tracker had lost the body.
    moved_mm : float64 array (T, J), optional
        The distance by which priors have moved each joint, in millimetres.
    rows : tuple of PriorRow
        The priors of all rounds of stabilisation.
    rounds : int
        The number of these rounds; 0 for a take that was not stabilised.
    remarks : tuple of str
        Remarks about the track.
    """

    take_id: int
    take: str
    tracker: ChainTracker
    poses: Poses
    costs: F64
    fingerprint: str
    body_from: str
    cameras: tuple[str, ...] = ()
    recording: str | None = None
    track_of: str | None = None
    lost: Bool | None = None
    moved_mm: F64 | None = None
    rows: tuple[PriorRow, ...] = ()
    rounds: int = 0
    remarks: tuple[str, ...] = field(default=())

    @property
    def last_rows(self) -> list[PriorRow]:
        """The priors of the last round."""
        return [row for row in self.rows if row.round == self.rounds]

    def table(self, kind: str, run: str) -> pa.Table:
        """Return the results of one kind, such as "tracks" or "priors", as a table."""
        tables: dict[str, Callable[[], dict[str, Any] | list[dict[str, Any]]]] = {
            "tracks": self._track,
            "chain_poses": self._poses,
            "track_frames": self._frames,
            "track_cameras": self._cameras,
            "priors": self._priors,
        }
        rows = tables[kind]()
        own: dict[str, Any] = {"run": run, "take_id": self.take_id, "take": self.take}
        if isinstance(rows, dict):
            count = len(next(iter(rows.values())))
            return _table(kind, {name: [value] * count for name, value in own.items()} | rows)
        return result_table(kind, [own | row for row in rows], run)

    def _track(self) -> list[dict[str, Any]]:
        chain, last = self.tracker.body.chain, self.last_rows
        return [
            {
                "recording": self.recording,
                "track_of": self.track_of,
                "tracker": self.tracker.settings.tracker,
                "chain": chain.name,
                "nodes": list(chain.nodes),
                "joints": list(chain.joints),
                "body": self.tracker.body.offsets.ravel().tolist(),
                "body_from": self.body_from,
                "sigma_px": self.tracker.settings.sigma_px,
                "rate_hz": self.tracker.rate_hz,
                "source_frames": len(self.poses.positions),
                "rounds": self.rounds,
                "hits": len({row.hit for row in last if row.kept}),
                "withdrawn": len({(row.round, row.hit) for row in self.rows if not row.kept}),
                "remarks": list(self.remarks),
                "fingerprint": self.fingerprint,
            }
        ]

    def _poses(self) -> dict[str, Any]:
        frames, nodes = self.poses.rotations.shape[:2]
        rotations = np.stack([vector_of(one) for one in self.poses.rotations.reshape(-1, 3, 3)]).reshape(
            frames, 3 * nodes
        )
        return {"source_frame": np.arange(frames), "place": _lists(self.poses.positions), "turns": _lists(rotations)}

    def _frames(self) -> dict[str, Any]:
        frames, statistics = len(self.poses.positions), frame_statistics(self.tracker, self.poses)
        unknown = [None] * frames
        return {
            "source_frame": np.arange(frames),
            "cost": self.costs,
            "cameras": unknown if statistics.cameras is None else statistics.cameras,
            "agreeing": unknown if statistics.agreeing is None else statistics.agreeing,
            "trusted": statistics.trusted,
            "contested": statistics.contested,
            "lost": np.zeros(frames, np.bool_) if self.lost is None else self.lost,
            "moved_mm": unknown if self.moved_mm is None else _lists(self.moved_mm),
        }

    def _cameras(self) -> list[dict[str, Any]]:
        if not isinstance(self.tracker.observed.observations, Rays):
            return []
        found = ray_residuals(self.tracker.observed, self.poses, self.tracker.settings.sigma_px)
        rows = []
        for v, camera in enumerate(self.cameras):
            own, weights = found.pixels[:, v], found.weights[:, v]
            seen = np.isfinite(own)
            shown = own[seen]
            rows.append(
                {
                    "camera": camera,
                    "keypoints": len(shown),
                    "median_px": float(np.median(shown)) if len(shown) else None,
                    "p90_px": float(np.percentile(shown, 90)) if len(shown) else None,
                    "weight": float(weights[seen].mean()) if len(shown) else None,
                }
            )
        return rows

    def _priors(self) -> list[dict[str, Any]]:
        rate_hz = self.tracker.rate_hz
        return [
            {
                "round": row.round,
                "kind": row.kind,
                "side": row.side or None,
                "class": row.motion,
                "hit": row.hit,
                "source_start": row.start,
                "source_stop": row.stop,
                "start_seconds": in_seconds(row.start, rate_hz),
                "stop_seconds": in_seconds(row.stop, rate_hz),
                "first_column": row.first_column,
                "last_column": row.last_column,
                "cost": row.cost,
                "weight": row.weight,
                "kept": row.kept,
                "reason": row.reason or None,
            }
            for row in self.rows
        ]


def stored_poses(rows: pa.Table, nodes: int) -> Poses:
    """Return the poses in rows of `chain_poses` of one take, sorted by frame."""
    positions = np.array(rows.column("place").to_pylist(), np.float64).reshape(-1, 3)
    vectors = np.array(rows.column("turns").to_pylist(), np.float64).reshape(-1, 3)
    rotations = np.stack([rotation_of(one) for one in vectors]) if len(vectors) else np.zeros((0, 3, 3))
    return Poses(positions, rotations.reshape(-1, nodes, 3, 3))


def _table(kind: str, columns: dict[str, Any]) -> pa.Table:
    schema = result_schema(kind)
    return pa.table([pa.array(columns[name], schema.field(name).type) for name in schema.names], schema=schema)


def _lists(values: F64) -> pa.Array:
    """Return the rows of a matrix as lists."""
    flat = np.ascontiguousarray(values, np.float64)
    offsets = np.arange(len(flat) + 1, dtype=np.int32) * flat.shape[1]
    return pa.ListArray.from_arrays(pa.array(offsets, pa.int32()), pa.array(flat.ravel()))


def truth_reference(store: Store, truth: str, folder: Path, recording: str | None) -> TruePositions:
    """Return the truth of a recording.

    Parameters
    ----------
    store : Store
        The store.
    truth : str
        A take of the store, or a motion file of any format, with joints as positions or angles.
    folder : Path
        The folder that relative paths start from.
    recording : str, optional
        The name of the recording, by which failures are looked up.

    Raises
    ------
    KinedexError
        `truth` is neither a take nor a motion file.
    """
    found = read_truth(store, truth, folder, load_kinematic_chain().joints)
    if truth in store.take_ids:
        return found
    return replace(found, failures=_failures((folder / Path(truth).expanduser()).parent / FAILURES, recording))


def _failures(file: Path, recording: str | None) -> tuple[tuple[int, int], ...]:
    if recording is None or not file.is_file():
        return ()
    try:
        with file.open(encoding="utf-8", newline="") as text:
            rows = [row for row in csv.DictReader(text) if row["recording"] == recording]
            return tuple((int(row["start"]), int(row["stop"])) for row in rows)
    except (KeyError, TypeError, ValueError, UnicodeDecodeError) as fault:
        expected = "expected columns recording, start and stop with whole numbers"
        raise KinedexError(f"{file}: {expected}: {fault!r}") from None


def track_errors(row: dict[str, Any], poses: pa.Table, reference: TruePositions) -> list[dict[str, Any]]:
    """Return error statistics of a track against a reference.

    Parameters
    ----------
    row : dict
        The row of the track in the results `tracks`.
    poses : pyarrow.Table
        Its rows of `chain_poses`.
    reference : TruePositions
        The reference; only frames that are common to track and reference are compared.

    Raises
    ------
    KinedexError
        No joint is known in track and reference in any common frame.
    """
    chain = load_kinematic_chain()
    body = ChainBody(chain, np.array(row["body"], np.float64).reshape(-1, 3))
    own, _ = forward(body, stored_poses(poses, len(chain.nodes)))
    known = at_rate(reference.joints, reference.rate_hz, row["rate_hz"])
    frames = min(own.shape[2], known.shape[2])
    order = [chain.joint(name) for name in LIMBS]
    gaps = 1000.0 * np.linalg.norm(own[order, :, :frames] - known[order, :, :frames], axis=1)
    if not np.isfinite(gaps).any():
        raise KinedexError(f"{row['take']}: no joint of the limbs is known to '{reference.name}' in any common frame")
    rows = [_distance_statistics("take", "all", gaps)]
    rows += [_distance_statistics("joint", name, gaps[j : j + 1]) for j, name in enumerate(LIMBS)]
    if reference.failures:
        failing = np.zeros(frames, np.bool_)
        for start, stop in reference.failures:
            share = row["rate_hz"] / reference.rate_hz
            failing[round(start * share) : round(stop * share)] = True
        rows += [
            _distance_statistics("part", "in failures", gaps[:, failing]),
            _distance_statistics("part", "elsewhere", gaps[:, ~failing]),
        ]
    named = {"take_id": row["take_id"], "take": row["take"], "reference": reference.name}
    return [named | one for one in rows if one["frames"]]


def _distance_statistics(scope: str, name: str, gaps: F64) -> dict[str, Any]:
    """Return statistics of distances (J, T) in millimetres, without unknown joints."""
    seen = np.isfinite(gaps)
    count = seen.sum(axis=0)
    frames = np.where(seen, gaps, 0.0).sum(axis=0)[count > 0] / count[count > 0]
    own = gaps[seen]
    return {
        "scope": scope,
        "name": name,
        "frames": len(frames),
        "mean_mm": float(frames.mean()) if len(frames) else None,
        "sd_mm": float(frames.std()) if len(frames) else None,
        "median_mm": float(np.median(own)) if len(own) else None,
        "max_mm": float(frames.max()) if len(frames) else None,
    }


def poses_of(store: Store, stage: str, take_id: int) -> pa.Table:
    """Return the rows of `chain_poses` that a stage has stored for a take."""
    found = store.rows_of("chain_poses", stage, "take_id", [take_id])
    return found.take(pc.sort_indices(found, [("source_frame", "ascending")]))


def sensor_error_statistics(store: Store, stage: str, take_ids: Collection[int]) -> list[dict[str, Any]]:
    """Return error statistics of takes against sensors: for all limbs of a take together, then for each limb.

    Parameters
    ----------
    store : Store
        The store.
    stage : str
        The stage that has stored `limb_errors`, "<pipeline>/<stage>".
    take_ids : collection of int
        The ids of the takes to evaluate.
    """
    rows: list[dict[str, Any]] = []
    for limbs in judged_limbs(store, stage):
        own = [(one.limb, one.error[one.valid]) for one in limbs if one.take_id in take_ids and one.valid.any()]
        if not own:
            continue
        named = {"take_id": limbs[0].take_id, "take": limbs[0].take, "reference": SENSORS}
        rows.append(named | _angle_statistics(SENSORS, "all", np.concatenate([error for _, error in own])))
        rows += [named | _angle_statistics(LIMB, limb, error) for limb, error in own]
    return rows


def _angle_statistics(scope: str, name: str, error: F64) -> dict[str, Any]:
    return {
        "scope": scope,
        "name": name,
        "frames": len(error),
        "mean_deg": float(error.mean()),
        "sd_deg": float(error.std()),
        "median_deg": float(np.median(error)),
        "max_deg": float(error.max()),
    }
