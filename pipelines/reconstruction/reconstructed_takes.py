"""Takes reconstructed from depth recordings, and the tables of their results."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from kinedex.catalog.depth_cameras import FLIP
from kinedex.catalog.features import FeatureSet
from kinedex.ops.arrays import F64, Bool
from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.body.resample import fill_gaps
from kinedex.ops.depth.low_pass import low_pass
from kinedex.ops.depth.pose_fit import PoseCost
from kinedex.ops.depth.tracker import Candidate, FrameResult
from kinedex.pipelines.reconstruction.parameters import ReconstructParameters
from kinedex.pipelines.reconstruction.recording_tracks import (
    BACKWARD,
    DIRECTIONS,
    FORWARD,
    PersonBones,
    RecordingTrack,
    Scene,
)
from kinedex.pipelines.tracking.recorded_takes import Provenance
from kinedex.storage.formats.motion.points import root_orientation
from kinedex.storage.formats.motion.reader import SHORT_GAP_S, Body
from kinedex.storage.snapshot.schemas import DEPTH_FORMAT, result_schema
from kinedex.storage.store.store import Store

RECONSTRUCTED = "_reconstructed"
"""The suffix of the name of a take that was reconstructed from a recording."""

LIVE = "_live"
"""The suffix of the name of a take of a live camera; a number follows if there are several from one folder."""

RECONSTRUCTION_KINDS = ("reconstructions", "reconstruction_frames", "depth_votes")
"""The kinds of results of a reconstructed take."""

_PIECE_ROWS = 5000

SKELETON = "depth"
"""The value of the column `skeleton` of reconstructed takes, which have no skeleton mapping."""

EXPLAINED = (
    "take", "source_frame", "direction", "hypothesis", "candidate", "archive_take", "archive_frame", "ends", "ends_m",
    "distance_m", "lookup_cost", "trial_cost", "cost", "winner",
)  # fmt: skip
"""The columns of `depth_votes` that a command shows."""


@dataclass(frozen=True, eq=False)
class ReconstructedTake:
    """A take reconstructed from a depth recording.

    Attributes
    ----------
    name : str
        Its name.
    provenance : Provenance
        Its origin.
    poses : float64 array (T, 24, 3)
        The joint positions in the world in metres; NaN without a person.
    rate_hz : float
        Frames per second.
    recipe : str
        A hash of everything that determines the take, except its files.
    warnings : tuple of str
        Warnings about the take.
    actor : str, optional
        The actor.
    """

    name: str
    provenance: Provenance
    poses: F64
    rate_hz: float
    recipe: str
    warnings: tuple[str, ...] = ()
    actor: str | None = None

    @property
    def format(self) -> str:
        """The format of the take."""
        return DEPTH_FORMAT

    def joints(self, features: FeatureSet) -> Body:
        """Return the joints as those of a motion file; gaps of up to 0.1 s are interpolated linearly."""
        places, _, _ = fill_gaps(self.poses.transpose(1, 2, 0), round(SHORT_GAP_S * self.rate_hz))
        nowhere = np.full(places.shape[1:], np.nan)
        positions = np.stack([places[JOINTS.index(one)] if one in JOINTS else nowhere for one in features.joints])
        valid: Bool = np.all(np.isfinite(places), axis=(0, 1))
        warnings = list(self.warnings)
        return Body(
            positions=positions,
            orientation=root_orientation(positions, features.joints, valid, warnings),
            rate_hz=self.rate_hz,
            unit="metre",
            skeleton=SKELETON,
            unknown=tuple(one for one in features.joints if one not in JOINTS),
            warnings=tuple(warnings),
            valid=None if valid.all() else valid,
        )


@dataclass(frozen=True, eq=False)
class ReconstructionResult:
    """A reconstructed take with everything that its results are made from.

    Attributes
    ----------
    take_id : int
        Id of the take.
    take, recording : str
        The names of the take and of the recording.
    file : str or None
        The path of the recordings file; None for a live camera.
    params : ReconstructParameters
        The parameters.
    track : RecordingTrack
        The tracked recording.
    scene : Scene
        The camera.
    bones : PersonBones
        The bones of the person.
    origins : sequence of (str, int)
        Take and frame of each pose of the database.
    rate_hz : float
        Frames per second.
    first_frame : int
        Number of the first frame in the files.
    remarks : sequence of tuple of str
        The remarks on each frame.
    sentences : tuple of str
        Remarks about the take.
    fingerprint : str
        A hash of everything that determines the take.
    """

    take_id: int
    take: str
    recording: str
    file: str | None
    params: ReconstructParameters
    track: RecordingTrack
    scene: Scene
    bones: PersonBones
    origins: Sequence[tuple[str, int]]
    rate_hz: float
    first_frame: int
    remarks: Sequence[tuple[str, ...]]
    sentences: tuple[str, ...]
    fingerprint: str

    @property
    def poses(self) -> F64:
        """The joint positions in the world, float64 (T, 24, 3), smoothed if requested; NaN without a person."""
        positions = self.scene.placement.in_world(self.track.poses)
        return positions if self.params.smooth_hz is None else low_pass(positions, self.rate_hz, self.params.smooth_hz)

    def table(self, kind: str, run: str) -> pa.Table:
        """Return the results of one kind ("reconstructions", "reconstruction_frames", "depth_votes") as a table."""
        rows: Iterator[dict[str, Any]] = {
            "reconstructions": self._reconstruction,
            "reconstruction_frames": self._frames,
            "depth_votes": self._votes,
        }[kind]()
        own = {"run": run, "take_id": self.take_id, "take": self.take}
        schema = result_schema(kind)
        pieces = [schema.empty_table()]
        while some := [own | row for row in islice(rows, _PIECE_ROWS)]:
            pieces.append(pa.Table.from_pylist(some, schema=schema))
        return pa.concat_tables(pieces)

    def _reconstruction(self) -> Iterator[dict[str, Any]]:
        placement, params = self.scene.placement, self.params
        settings = params.settings(self.rate_hz)
        yield {
            "recording": self.recording,
            "file": self.file,
            "form": params.form,
            "direction": "both" if params.both_ways else "forward",
            "hypotheses": list(settings.hypotheses),
            "candidates": settings.candidates,
            "stride": self.scene.stride,
            "smooth_hz": params.smooth_hz,
            "body_from": self.bones.origin,
            "height_m": self.bones.height_m,
            "joints": list(JOINTS),
            "bone_lengths": self.bones.lengths.tolist(),
            "floor_m": None if placement.floor_height is None else -placement.floor_height,
            # from the axes of the camera (x right, y down, z forward) to the world
            "turn": (placement.rotation @ placement.turn * FLIP).ravel().tolist(),
            "place": placement.place.tolist(),
            "rate_hz": self.rate_hz,
            "source_frames": len(self.track.chosen),
            "unseen_frames": int(np.isnan(self.track.poses).any(axis=(1, 2)).sum()),
            "first_frame": self.first_frame,
            "remarks": list(self.sentences),
            "fingerprint": self.fingerprint,
        }

    def _frames(self) -> Iterator[dict[str, Any]]:
        poses = self.poses
        chosen = self.track.chosen.tolist()
        for t, (result, way) in enumerate(zip(self.track.results, chosen, strict=True)):
            row: dict[str, Any] = {
                "source_frame": t,
                "direction": DIRECTIONS[way],
                "remarks": list(self.remarks[t]),
                "unseen": list(JOINTS),
            }
            if result is not None:
                row |= self._frame(result, poses[t])
            yield row

    def _frame(self, result: FrameResult, pose: F64) -> dict[str, Any]:
        placement = self.scene.placement
        take, frame = (None, None) if result.row < 0 else self.origins[result.row]
        is_seen = result.hypothesis is not None
        return {
            "hypothesis": result.hypothesis,
            "cost_local": _number(result.cost_local),
            "cost_database": _number(result.cost_database),
            "archive_take": take,
            "archive_frame": frame,
            "points": result.points,
            "components": result.components,
            "links": result.links,
            "maps": len(result.maps),
            "facing": (placement.rotation @ result.facing).tolist() if is_seen else None,
            "centre": placement.in_world(result.centre).tolist() if is_seen else None,
            "extrema": placement.in_world(result.extrema).ravel().tolist() if is_seen else None,
            "unseen": [JOINTS[j] for j in np.flatnonzero(result.unseen)],
            "joints": pose.ravel().tolist() if is_seen else None,
        }

    def _votes(self) -> Iterator[dict[str, Any]]:
        for t, way in enumerate(self.track.chosen.tolist()):
            for direction in (FORWARD, BACKWARD)[: len(self.track.directions)]:
                result = self.track.directions[direction][t]
                if result is not None:
                    own = {"source_frame": t, "direction": DIRECTIONS[direction]}
                    yield from (own | row for row in self._hypotheses(result, direction == way))

    def _hypotheses(self, result: FrameResult, is_taken: bool) -> list[dict[str, Any]]:
        """Return a row for the local hypothesis, and for each candidate of the database."""
        local, database = result.parts
        rows: list[dict[str, Any]] = []
        if local is not None:
            winner = is_taken and result.hypothesis == "local"
            rows.append({"hypothesis": "local", "winner": winner, "cost": local.total, **_parts(local)})
        for number, one in enumerate(result.candidates, 1):
            is_fitted = database is not None and one.row == result.row
            row = self._candidate(result, number, one)
            row["winner"] = is_taken and is_fitted and result.hypothesis == "database"
            if is_fitted and database is not None:
                row |= {"cost": database.total, **_parts(database)}
            rows.append(row)
        return rows

    def _candidate(self, result: FrameResult, number: int, one: Candidate) -> dict[str, Any]:
        take, frame = self.origins[one.row]
        return {
            "hypothesis": "database",
            "candidate": number,
            "archive_take": take,
            "archive_frame": frame,
            "ends": (result.maps[one.map] + 1).tolist(),
            "ends_m": _number(float(result.sums[one.map])),
            "distance_m": one.ends,
            "lookup_cost": one.lookup_cost,
            "trial_cost": _number(one.cost),
        }


def _parts(cost: PoseCost) -> dict[str, float]:
    return {"surface": cost.surface, "extrema": cost.extrema, "points": cost.points}


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def explained_votes(
    store: Store, stage: str, takes: Collection[str], interval: tuple[int, int] | None = None
) -> pa.Table:
    """Return the hypotheses and candidates that were tried in the frames of takes.

    Parameters
    ----------
    store : Store
        The store.
    stage : str
        The stage that has reconstructed the takes, "<pipeline>/<stage>".
    takes : collection of str
        The names of the takes.
    interval : tuple of (int, int), optional
        The first frame and the one after the last; by default all frames.

    Returns
    -------
    pyarrow.Table
        Rows of `depth_votes` with the columns `EXPLAINED`, by take and frame.
    """
    found = store.rows_of("depth_votes", stage, "take", takes).select(list(EXPLAINED))
    if interval is not None:
        frame = found.column("source_frame")
        found = found.filter(pc.and_(pc.greater_equal(frame, interval[0]), pc.less(frame, interval[1])))
    order = [("take", "ascending"), ("source_frame", "ascending"), ("direction", "descending"),
             ("hypothesis", "descending"), ("candidate", "ascending")]  # fmt: skip
    return found.take(pc.sort_indices(found, order))
