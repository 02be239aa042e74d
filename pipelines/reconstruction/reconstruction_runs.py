"""Reconstruct depth recordings; commit each take when it is done, and skip unchanged recordings."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinedex.catalog.bodies import load_body
from kinedex.catalog.depth_recordings import AUTO, NONE, DepthRecordingsFile, load_depth_recordings
from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.depth.lookup import near_maps
from kinedex.ops.depth.thinned_poses import bone_lengths_of
from kinedex.ops.depth.tracker import TrackerSettings
from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.wording import counted
from kinedex.pipelines.engine.digests import hash_of
from kinedex.pipelines.reconstruction.parameters import ESTIMATE, ReconstructParameters
from kinedex.pipelines.reconstruction.reconstructed_takes import (
    RECONSTRUCTED,
    RECONSTRUCTION_KINDS,
    ReconstructedTake,
    ReconstructionResult,
)
from kinedex.pipelines.reconstruction.recording_tracks import (
    PersonBones,
    Scene,
    UnusableRecording,
    estimated_bones,
    fit_remarks,
    frame_remarks,
    reconstructor_of,
    remark_sentences,
    scene_of,
    track_recording,
)
from kinedex.pipelines.reconstruction.stored_poses import PoseDatabase, read_pose_database
from kinedex.pipelines.tracking.recorded_takes import Provenance, stamp_of
from kinedex.pipelines.tracking.recording_runs import (
    FinishedTake,
    RecordingOutcome,
    RunContext,
    is_compiled,
    run_tasks,
    take_ids_of,
)
from kinedex.storage.formats.depth.recording import CAMERA_MOVED, DepthRecording, read_recording, recording_files
from kinedex.storage.formats.motion.sources import checksum
from kinedex.storage.snapshot.parts import joint_positions
from kinedex.storage.store.store import Store
from kinedex.storage.store.writer import StoreWriter


@dataclass(frozen=True, eq=False)
class ReconstructTask:
    """A depth recording to reconstruct.

    Attributes
    ----------
    store : Store
        The store.
    database : str
        The stage that has the pose database, "<pipeline>/<stage>".
    recording : str
        Name of the recording.
    take, take_id : str, int
        Name and id of the take to make.
    params : ReconstructParameters
        The parameters, which name the recordings file.
    fingerprint, run : str
        A hash of everything that determines the take, and the id of the run.
    """

    store: Store
    database: str
    recording: str
    take: str
    take_id: int
    params: ReconstructParameters
    fingerprint: str
    run: str

    @property
    def subject(self) -> str:
        """The name of the recording, for messages."""
        return self.recording


def reconstruct_recording(task: ReconstructTask) -> FinishedTake:
    """Track the person in a depth recording, and return the take with its results.

    Raises
    ------
    KinedexError
        A file of it is invalid, no person is seen in it, or its body cannot be determined.
    """
    params = task.params
    file = load_depth_recordings(params.recordings)
    recording = read_recording(file, task.recording)
    of_frames = recording.frames.notes()  # before all frames are read below, which adds notes
    database = stored_database(task.store, task.database)
    settings = params.settings(recording.rate_hz)
    try:
        scene = scene_of(recording, params.stride)
        bones = _bones(task, recording, scene, database, settings)
    except UnusableRecording as fault:
        raise file.error(task.recording, fault.key, str(fault)) from None
    tracker = reconstructor_of(load_body(), bones, database, scene, settings)
    is_empty_room = file.entry(task.recording).background not in (None, AUTO, NONE)
    track = track_recording(recording, tracker, both_ways=params.both_ways, is_empty_room=is_empty_room)
    if not np.isfinite(track.poses).any():
        text = (
            f"no pose was found in any of the {len(track.chosen)} frames: `kinedex inspect` draws what is seen of one"
        )
        raise file.error(task.recording, "depth", text)
    remarks = frame_remarks(track, scene, bones.height_m)
    doubts = (*_damaged(recording), *remark_sentences(remarks), *fit_remarks(track, bones))
    kept = (note for note in recording.notes if note not in of_frames and not note.endswith(CAMERA_MOVED))
    notes = (*kept, *scene.placement.notes)
    result = ReconstructionResult(
        task.take_id, task.take, task.recording, os.path.abspath(params.recordings), params, track, scene, bones,
        database.origins, recording.rate_hz, recording.frames.first, remarks, (*notes, *doubts), task.fingerprint,
    )  # fmt: skip
    take = ReconstructedTake(
        task.take, provenance_of(file, task.recording), result.poses, recording.rate_hz, task.fingerprint, doubts
    )
    tables = {kind: result.table(kind, task.run) for kind in RECONSTRUCTION_KINDS}
    return FinishedTake(take, tables, (_line(result), *(f"{task.recording}: {text}" for text in (*notes, *doubts))))


def _bones(
    task: ReconstructTask, recording: DepthRecording, scene: Scene, database: PoseDatabase, settings: TrackerSettings
) -> PersonBones:
    """Return the bones of the person, from a take or estimated."""
    body = recording.body or task.params.body
    if body == ESTIMATE:
        return estimated_bones(recording, scene, database, settings)
    return take_bones(task.store, body, f"recording '{task.recording}', body")


def stored_database(store: Store, stage: str) -> PoseDatabase:
    """Return the pose database of a stage; raise a KinedexError, with the remedy, if there is none."""
    database = read_pose_database(store, stage)
    if database is None or not len(database.directions):
        raise KinedexError(
            f"{store.path}: the pose database of {stage} has no pose; its parameter `where` selects the takes that "
            "provide poses: --set pose_database.where=true takes all"
        )
    return database


def take_bones(store: Store, take: str, where: str) -> PersonBones:
    """Return the median bone lengths of a take.

    Parameters
    ----------
    store : Store
        The store.
    take : str
        The take, which needs frames with all named joints.
    where : str
        The place that names the take, for messages.

    Raises
    ------
    KinedexError
        There is no such take, or it has no frame with all joints.
    """
    if take not in store.take_ids:
        near = did_you_mean(take, store.take_ids)
        raise KinedexError(f"{where}: the store has no take '{take}'{near}; name one, or write `body: {ESTIMATE}`")
    positions = joint_positions(store.frames(take), JOINTS).transpose(2, 0, 1).astype(np.float64)
    whole = positions[np.isfinite(positions).all(axis=(1, 2))]
    if not len(whole):
        raise KinedexError(
            f"{where}: take '{take}' has no frame with all {len(JOINTS)} named joints, which bones are measured in; "
            f"name another take of the person, or write `body: {ESTIMATE}`"
        )
    lengths = bone_lengths_of(whole)
    return PersonBones(take, lengths, load_body().standing_height(lengths))


def provenance_of(file: DepthRecordingsFile, name: str) -> Provenance:
    """Return the files of a recording as the origin of a take."""
    path = Path(file.located.path).absolute()
    hasher = hashlib.sha256(repr(_settings(file, name)).encode())
    size, latest = 0, 0
    for key, one in recording_files(file, name):
        found = one.stat()
        size, latest = size + found.st_size, max(latest, found.st_mtime_ns)
        hasher.update(f"{key} {one.name} {checksum(one)}".encode())
    return Provenance(str(path.parent), path.name, hasher.hexdigest(), size, latest, name)


def files_stamp(file: DepthRecordingsFile, name: str) -> str:
    """Return a hash of the settings of a recording, and of its files by path, size and time."""
    return stamp_of((name, _settings(file, name)), recording_files(file, name))


def _settings(file: DepthRecordingsFile, name: str) -> dict[str, object]:
    """Return the settings of a recording that affect its take: all except the truth."""
    return file.entry(name).model_dump(mode="json", exclude={"truth", "truth_pose", "markers"})


def _damaged(recording: DepthRecording) -> list[str]:
    """Return a sentence on damaged frames that were found while reading."""
    damaged = recording.frames.damaged
    if not damaged:
        return []
    first = min(damaged)
    return [f"{counted(len(damaged), 'frame')} damaged and passed over; the first, {first}: {damaged[first]}"]


def _line(result: ReconstructionResult) -> str:
    frames = len(result.track.chosen)
    hypotheses = [one and one.hypothesis for one in result.track.results]
    lent, unseen = hypotheses.count("database"), hypotheses.count(None)
    parts = [
        f"{result.recording}: {counted(frames, 'frame')} as {result.take}",
        f"{result.bones.height_m:.2f} m tall ({result.bones.origin})",
        f"{lent / frames:.0%} of the poses come from the archive",
    ]
    return ", ".join([*parts, *([f"{unseen} without a pose"] if unseen else [])])


def chosen_recordings(params: ReconstructParameters) -> list[str]:
    """Return the names of the recordings that the parameters select.

    Raises
    ------
    ConfigError
        The file is invalid, or has no recording with a given name.
    """
    file = load_depth_recordings(params.recordings)
    for name in params.only:
        file.entry(name)
    return list(dict.fromkeys(params.only)) or list(file.recordings)


def named_bodies(params: ReconstructParameters) -> dict[str, str]:
    """Return the body of each selected recording: a take, or `estimate`."""
    file = load_depth_recordings(params.recordings)
    return {name: file.entry(name).body or params.body for name in chosen_recordings(params)}


def reconstruct(
    writer: StoreWriter, params: ReconstructParameters, database: str, place: RunContext
) -> RecordingOutcome:
    """Reconstruct depth recordings, commit each as a take, and return the outcome.

    Parameters
    ----------
    writer : StoreWriter
        The writer of the store.
    params : ReconstructParameters
        The recordings and the tracker.
    database : str
        The stage that has the pose database, "<pipeline>/<stage>".
    place : RunContext
        The stage and run of the results.

    Raises
    ------
    KinedexError
        A recording, or a file that it names, is invalid; recordings before it remain in the store.
    """
    file, names = load_depth_recordings(params.recordings), chosen_recordings(params)
    store, bodies = writer.store, named_bodies(params)
    takes = {name: f"{name}{RECONSTRUCTED}" for name in names}
    ids = take_ids_of(writer, takes.values())
    found = stored_database(store, database)
    poses = hash_of(found.directions, found.origins, found.mean_bones)
    chosen = params.model_dump(exclude={"recordings", "only", "body"})
    tasks = [
        ReconstructTask(
            writer.store, database, name, takes[name], ids[takes[name]], params,
            hash_of(place.code, chosen, poses, files_stamp(file, name), take_digest(store, [bodies[name]])), place.run,
        )
        for name in names
    ]  # fmt: skip
    return run_tasks(writer, place, "reconstructions", reconstruct_recording, tasks, lambda: is_compiled(near_maps))


def take_digest(store: Store, takes: Sequence[str]) -> str:
    """Return a hash of the takes that provide bones: of their names, files and recipes."""
    rows = {row["name"]: (row["checksum"], row["recipe"]) for row in store.take_rows.to_pylist()}
    return hash_of(*((name, rows.get(name)) for name in sorted(set(takes))))
