"""Track or stabilise one recording or take, with bone lengths of a take, of the track, or of the mean body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kinedex.catalog.kinematics import load_kinematic_chain, load_surface
from kinedex.ops.arrays import F64, U64, Bool
from kinedex.ops.body.capsules import body_capsules
from kinedex.ops.body.kinematic_chain import ChainBody, Poses
from kinedex.ops.body.pose_fit import measured_body
from kinedex.ops.errors import KinedexError, ParameterError, did_you_mean
from kinedex.ops.intervals import shown_seconds
from kinedex.ops.priors.archive_poses import PriorMotion
from kinedex.ops.priors.stabilisation import Settings, Track, stabilise
from kinedex.ops.tracking.body_estimate import estimate_body, mean_body
from kinedex.ops.tracking.contours import Observed, Silhouettes
from kinedex.ops.tracking.observations import JointPositions
from kinedex.ops.tracking.ray_residuals import keypoint_sigma
from kinedex.ops.tracking.rays import SIGMA_PX
from kinedex.ops.tracking.triangulation import triangulate
from kinedex.ops.tracking.views import camera_view
from kinedex.ops.wording import counted
from kinedex.pipelines.ingestion.analysis import analyse
from kinedex.pipelines.tracking.chain_tracker import ChainTracker, TrackSettings
from kinedex.pipelines.tracking.observed_recordings import StoredRecording, stored_recording
from kinedex.pipelines.tracking.parameters import TrackParameters
from kinedex.pipelines.tracking.recorded_takes import Provenance, take_positions
from kinedex.pipelines.tracking.recording_runs import FinishedTake
from kinedex.pipelines.tracking.tracked_takes import TRACK_KINDS, TrackResult, observed_frames
from kinedex.pipelines.tracking.tracked_takes import Track as TrackedTake
from kinedex.storage.snapshot.schemas import RECORDED_FORMATS
from kinedex.storage.store.store import Store

MAX_ACTORS = 50
"""The largest number of actors of an archive from which the mean body is computed."""

_USUAL_M = {
    "belly": 0.12, "chest": 0.12, "neck": 0.14, "head": 0.1, "headtop": 0.16, "shoulder": 0.18, "elbow": 0.28,
    "wrist": 0.25, "fingers": 0.1, "knee": 0.42, "ankle": 0.42, "toes": 0.15,
}  # fmt: skip
_USUAL_HIP = (0.1, -0.08, 0.0)

ESTIMATE = "estimate"


def usual_body() -> ChainBody:
    """Return a default body for stores without a take of any actor."""
    chain = load_kinematic_chain()
    offsets = np.zeros((len(chain.joints), 3))
    for j, (name, rest) in enumerate(zip(chain.joints, chain.rest, strict=True)):
        if rest.measured:
            offsets[j] = np.array(_USUAL_HIP) * (1.0 if name.startswith("l") else -1.0, 1.0, 1.0)
        elif rest.along is not None:
            offsets[j] = np.array(rest.along) * (_USUAL_M.get(name) or _USUAL_M[name[1:]])
    for j, rest in enumerate(chain.rest):
        if rest.along is None and not rest.measured and rest.start != j:
            offsets[j] = offsets[rest.start]
    return ChainBody(chain, offsets)


def take_joints(store: Store, take: str) -> F64:
    """Return the joint positions (J, 3, T) of the kinematic chain in a take of the store in metres, NaN if unknown."""
    return take_positions(store, take, load_kinematic_chain().joints)


def take_body(store: Store, take: str, where: str) -> ChainBody:
    """Return the body (bone offsets) of the actor of a take.

    Parameters
    ----------
    store : Store
        The store.
    take : str
        The take, which needs all joints.
    where : str
        The place that names the take, for messages.

    Raises
    ------
    KinedexError
        There is no such take, or it lacks joints.
    """
    if take not in store.take_ids:
        near = did_you_mean(take, store.take_ids)
        raise KinedexError(f"{where}: the store has no take '{take}'{near}; name one, or write `body: estimate`")
    try:
        return measured_body(load_kinematic_chain(), take_joints(store, take))
    except ParameterError as fault:
        raise KinedexError(
            f"{where}: take '{take}' lacks joints that lengths are measured from ({fault}); name another take of the "
            "person, or write `body: estimate`"
        ) from None


def archive_body(store: Store) -> ChainBody:
    """Return the mean body of a store's actors, by the longest take of each; the default body if there are none."""
    rows = store.take_rows.select(["name", "actor", "format", "frames"]).to_pylist()
    longest: dict[str, tuple[int, str]] = {}
    for row in rows:
        if row["format"] not in RECORDED_FORMATS:
            key = row["actor"] or ""
            longest[key] = max(longest.get(key, (0, "")), (row["frames"], row["name"]))
    bodies = []
    for actor in sorted(longest)[:MAX_ACTORS]:
        try:
            bodies.append(measured_body(load_kinematic_chain(), take_joints(store, longest[actor][1])))
        except ParameterError:
            continue  # the body of this take lacks joints
    return mean_body(load_kinematic_chain(), bodies or [usual_body()])


def body_of_track(positions: F64, mean: ChainBody) -> ChainBody:
    """Return the body of a 3D track, with missing lengths from the mean body in proportion.

    Parameters
    ----------
    positions : float64 array (T, J, 3)
        Joint positions of the kinematic chain in metres; NaN if a joint is not tracked.
    mean : ChainBody
        The mean body.

    Raises
    ------
    KinedexError
        The positions of hips and shoulders are impossible for a body.
    """
    try:
        return measured_body(mean.chain, np.ascontiguousarray(positions.transpose(1, 2, 0)))
    except ParameterError:
        shown = np.isfinite(positions.sum(axis=2))
        joints = np.flatnonzero(shown.any(axis=0))
        seen = np.where(shown[:, joints], 3, 0)
        return estimate_body(mean.chain, positions[:, joints], seen, joints, mean).body


@dataclass(frozen=True, eq=False)
class Subject:
    """A recording or 3D track that is ready for tracking.

    Attributes
    ----------
    observed : Observed
        The observations, with the body.
    provenance : Provenance
        Its files.
    body_from : str
        Origin of the bone lengths.
    actor : str, optional
        The actor.
    remarks : tuple of str
        Remarks about it.
    sigma_px : float
        Standard deviation of its keypoints in pixels, estimated by triangulation.
    """

    observed: Observed
    provenance: Provenance
    body_from: str
    actor: str | None = None
    remarks: tuple[str, ...] = ()
    sigma_px: float = SIGMA_PX


@dataclass(frozen=True, eq=False)
class TrackTask:
    """A task that tracks a recording.

    Attributes
    ----------
    store : Store
        The store that has its observations.
    stage : str or None
        The stage that has read the observations.
    recording : str
        Its name.
    take, take_id : str, int
        Name and id of the take to make.
    params : TrackParameters
        The tracker.
    mean : ChainBody
        The mean body of the archive.
    fingerprint, run : str
        A hash of everything that determines the take, and the id of the run.
    """

    store: Store
    stage: str | None
    recording: str
    take: str
    take_id: int
    params: TrackParameters
    mean: ChainBody
    fingerprint: str
    run: str

    @property
    def subject(self) -> str:
        """The name of the recording, for messages."""
        return self.recording


@dataclass(frozen=True, eq=False)
class StabiliseTask:
    """A task that stabilises the take `of`, by priors from the motions of an archive.

    `tracker` applies to takes that were tracked from a recording; only its loss applies to other takes. Attributes that
    are not mentioned here are as in `TrackTask`.
    """

    store: Store
    of: str
    take: str
    take_id: int
    tracker: TrackParameters
    sigma_m: float
    body: str
    mean: ChainBody
    priors: Settings
    motions: Sequence[PriorMotion]
    fingerprint: str
    run: str

    @property
    def subject(self) -> str:
        """The name of the take, for messages."""
        return self.of


def track_recording(task: TrackTask) -> FinishedTake:
    """Track a recording without priors."""
    found = stored_recording(task.store, task.recording, task.stage)
    subject = recording_subject(task.store, found, task.mean, task.params.sigma_m)
    tracker = ChainTracker(subject.observed, _settings(task.params, subject))
    track = _first(tracker, task.recording)
    result = _result(task, tracker, track, subject)
    line = f"{task.recording}: {counted(len(track.costs), 'frame')} tracked as {task.take}" + _doubts(result, subject)
    return _finished(task, result, subject, TRACK_KINDS, line)


def stabilise_take(task: StabiliseTask) -> FinishedTake:
    """Stabilise a take by priors of the archive."""
    subject = take_subject(task)
    tracker = ChainTracker(subject.observed, _settings(task.tracker, subject))

    def words(current: Track) -> U64:
        placed = _take(task.take, subject, current.poses, task.fingerprint)
        return analyse(placed.joints(task.store.feature_set), task.store.feature_set, task.store.rate_hz)[2]

    done = stabilise(tracker, _first(tracker, task.of), words, task.motions, task.priors)
    rows = tuple(row for one in done.rounds for row in one.rows)
    result = replace(
        _result(task, tracker, done.track, subject),
        track_of=task.of,
        moved_mm=done.moved_mm,
        rows=rows,
        rounds=len(done.rounds),
    )
    return _finished(task, result, subject, (*TRACK_KINDS, "priors"), _stabilised_line(task, result))


def _settings(params: TrackParameters, subject: Subject) -> TrackSettings:
    """Return the settings of the tracker; for 3D tracks it is always `take`, which optimises all frames at once."""
    settings = params.settings(subject.sigma_px)
    return replace(settings, tracker="take") if isinstance(subject.observed.observations, JointPositions) else settings


def recording_subject(store: Store, found: StoredRecording, mean: ChainBody, sigma_m: float) -> Subject:
    """Return a recording in the form that is tracked.

    Raises
    ------
    KinedexError
        Its body cannot be measured; the message names the remedy.
    """
    where = f"recording '{found.name}', body"
    body, given = found.row["body"], None
    if body != ESTIMATE:
        given = take_body(store, body, where)
    if found.recording is None:
        name = found.row["track"]
        own = track_subject(store, name, ESTIMATE if given is None else body, mean, sigma_m)
        cuts = tuple(found.row["cuts"])
        origin = replace(found.provenance, recording=found.name)
        return replace(own, observed=replace(own.observed, cuts=cuts), provenance=origin)
    recording, remarks = found.recording, [*found.row["remarks"]]
    rays = recording.rays() if recording.keypoints else None
    points, cameras = triangulate(rays) if rays is not None else (None, None)
    if given is None:
        if points is None or cameras is None:
            raise KinedexError(f"{where}: lengths are not measured from silhouettes; name a take: `body: <take>`")
        estimate = estimate_body(mean.chain, points, cameras, recording.body_points(mean).joints, mean)
        given, body = estimate.body, ESTIMATE
        remarks += [
            f"the bone that ends in the {one.joint} is {one.left_m:.3f} m on the left and {one.right_m:.3f} m on the "
            "right; keypoints under a wrong name, or a bad calibration?"
            for one in estimate.uneven
        ]
    observed = Observed(
        given, recording.rate_hz, rays, recording.body_points(given) if rays is not None else None,
        _silhouettes(found, given), recording.cuts,
    )  # fmt: skip
    sigma_px = keypoint_sigma(rays, points) if rays is not None and points is not None else SIGMA_PX
    return Subject(observed, found.provenance, body, None, tuple(remarks), sigma_px)


def _silhouettes(found: StoredRecording, body: ChainBody) -> Silhouettes | None:
    recording = found.recording
    if recording is None or recording.masks is None:
        return None
    views = tuple(
        camera_view(
            one.matrix, one.rotation, one.translation, one.distortion, one.size, None if masks is None else masks.size
        )
        for one, masks in zip(recording.cameras, recording.masks.cameras, strict=True)
    )
    return Silhouettes(views, recording.masks, body_capsules(body, load_surface()))


def track_subject(store: Store, take: str, body: str, mean: ChainBody, sigma_m: float) -> Subject:
    """Return a take of the store as a 3D track."""
    row = next(row for row in store.take_rows.to_pylist() if row["name"] == take)
    positions = take_joints(store, take).transpose(2, 0, 1)
    _require_trunk(take, positions)
    own = body_of_track(positions, mean) if body == ESTIMATE else take_body(store, body, "body")
    observed = Observed(own, store.rate_hz, JointPositions(positions, np.full(positions.shape[:2], sigma_m)))
    provenance = Provenance(
        row["source_root"], row["source"], row["checksum"], row["source_bytes"], row["source_mtime_ns"],
        row.get("recording"), tuple(row.get("cameras") or ()),
    )  # fmt: skip
    return Subject(observed, provenance, "the track itself" if body == ESTIMATE else body, row["actor"])


def _require_trunk(take: str, positions: F64) -> None:
    chain = load_kinematic_chain()
    for name in ("lhip", "rhip", "lshoulder", "rshoulder"):
        if not np.isfinite(positions[:, chain.joint(name)]).all(axis=1).any():
            raise KinedexError(
                f"take '{take}' has no {name} in any frame; a 3D track needs hips and shoulders. Is its skeleton "
                "mapping right? `kinedex inspect FILE` shows how its joints were named"
            )


def take_subject(task: StabiliseTask) -> Subject:
    """Return the observations of a take: those of its recording if it was tracked from one, otherwise its joints."""
    row = tracked_row(task.store, task.of)
    if row is None:
        return track_subject(task.store, task.of, task.body, task.mean, task.sigma_m)
    return recording_subject(task.store, stored_recording(task.store, row["recording"]), task.mean, task.sigma_m)


def tracked_row(store: Store, take: str) -> dict[str, Any] | None:
    """Return the row of `tracks` of a take that was tracked from a recording in the store; None for others."""
    for part in store.manifest.results.get("tracks", ()):
        for rows in store.result_pieces("tracks", [part]):
            for row in rows.to_pylist():
                if row["take"] == take and row["take_id"] == store.take_ids.get(take) and row["track_of"] is None:
                    return dict(row)
    return None


def _first(tracker: ChainTracker, name: str) -> Track:
    if tracker.observed.observations is None:
        raise KinedexError(
            f"{name}: silhouettes alone give no first pose; add `keypoints:` of the first frames to the recording, and "
            "track it with --tracker frames"
        )
    try:
        return tracker.first()
    except ParameterError as fault:
        raise KinedexError(f"{name}: {fault}") from None


def _take(name: str, subject: Subject, poses: Poses, recipe: str, warnings: Sequence[str] = ()) -> TrackedTake:
    observed = subject.observed
    valid = observed_frames(observed.seen, observed.rate_hz)
    return TrackedTake(
        name, subject.provenance, observed.body, poses, observed.rate_hz, valid, recipe, subject.actor, tuple(warnings)
    )


def _result(task: TrackTask | StabiliseTask, tracker: ChainTracker, track: Track, subject: Subject) -> TrackResult:
    lost = getattr(track, "lost", None)
    return TrackResult(
        task.take_id, task.take, tracker, track.poses, track.costs, task.fingerprint, subject.body_from,
        subject.provenance.cameras, subject.provenance.recording, lost=lost, remarks=subject.remarks,
    )  # fmt: skip


def _finished(
    task: TrackTask | StabiliseTask, result: TrackResult, subject: Subject, kinds: Sequence[str], line: str
) -> FinishedTake:
    lost = 0 if result.lost is None else int(result.lost.sum())
    warnings = [f"the tracker had lost the body in {counted(lost, 'frame')}"] if lost else []
    take = _take(task.take, subject, result.poses, task.fingerprint, warnings)
    return FinishedTake(take, {kind: result.table(kind, task.run) for kind in kinds}, (line,))


def _doubts(result: TrackResult, subject: Subject) -> str:
    unseen = int((~observed_frames(subject.observed.seen, subject.observed.rate_hz)).sum())
    lost = 0 if result.lost is None else int(result.lost.sum())
    parts = [f"{unseen} invalid, which nothing has seen"] if unseen else []
    parts += [f"{lost} in which the body was lost"] if lost else []
    return f", {', '.join(parts)}" if parts else ""


def _stabilised_line(task: StabiliseTask, result: TrackResult) -> str:
    kept = {(row.round, row.hit) for row in result.rows if row.kept}
    gone = [row for row in result.rows if not row.kept]
    last = {hit for number, hit in kept if number == result.rounds}
    moved = 0.0 if result.moved_mm is None else float(result.moved_mm.mean())
    filled = filled_gaps(result.tracker.observed)
    if not kept:
        why = "all were withdrawn" if gone else "no motion of the archive was found"
        return f"{task.of}: no priors, {why}{filled}; as {task.take}"
    frames = {frame for row in gone for frame in range(row.start, row.stop)}
    withdrawn = f", withdrawn over {shown_seconds(len(frames), result.tracker.rate_hz, 1)} s" if gone else ""
    return (
        f"{task.of}: priors of {counted(len(last), 'hit')} in {counted(result.rounds, 'round')}{withdrawn}; joints "
        f"moved by {moved:.1f} mm on average{filled}; as {task.take}"
    )


def filled_gaps(observed: Observed) -> str:
    """Return a phrase about the gaps in a 3D track, ignoring joints that are never known."""
    if not isinstance(observed.observations, JointPositions):
        return ""
    known: Bool = np.all(np.isfinite(observed.observations.positions), axis=2)
    gaps = int((~known[:, known.any(axis=0)]).any(axis=1).sum())
    return f"; gaps in {counted(gaps, 'frame')} filled" if gaps else ""
