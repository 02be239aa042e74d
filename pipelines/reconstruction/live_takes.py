"""Store takes of live cameras, or write them to a motion file if the store cannot be written."""

from __future__ import annotations

import hashlib
import re
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.ops.body.joint_tree import JOINTS
from kinedex.pipelines.engine.digests import hash_of
from kinedex.pipelines.engine.run_id import new_run_id
from kinedex.pipelines.reconstruction.frame_remarks import fit_remarks, frame_remarks, remark_sentences
from kinedex.pipelines.reconstruction.live import LiveTracker
from kinedex.pipelines.reconstruction.parameters import ReconstructParameters
from kinedex.pipelines.reconstruction.reconstructed_takes import (
    LIVE,
    RECONSTRUCTION_KINDS,
    ReconstructedTake,
    ReconstructionResult,
)
from kinedex.pipelines.reconstruction.recording_tracks import RecordingTrack
from kinedex.pipelines.recordings.recorded_takes import Provenance, put_takes
from kinedex.pipelines.recordings.runs import take_ids_of
from kinedex.pipelines.recordings.stored_results import put_beside
from kinedex.storage.disk import whole_file
from kinedex.storage.formats.motion.joint_motion import JointMotion
from kinedex.storage.formats.motion.sources import checksum
from kinedex.storage.formats.motion.trc_writer import write_trc
from kinedex.storage.lock import NO_WAIT, Wait
from kinedex.storage.store.store import open_store
from kinedex.storage.store.writer import StoreWriter

F64 = npt.NDArray[np.float64]

STAGE = "depth/live"
"""The stage of results of live cameras, which runs over recordings leave unchanged."""

_MOST_LETTERS = 80


@dataclass(eq=False)
class LiveRecording:
    """Frames of a live camera that were tracked.

    Attributes
    ----------
    tracker : LiveTracker
        The tracker, with the records of all frames.
    folder, camera : Path
        The folder that was followed, and the camera's file.
    first_frame : int
        Number of the first frame in the files.
    bytes : int
        Size of all files.
    begin : float
        The time at which tracking began, in seconds since 1970.
    """

    tracker: LiveTracker
    folder: Path
    camera: Path
    first_frame: int = 0
    bytes: int = 0
    begin: float = field(default_factory=time.time)

    @property
    def recording(self) -> str:
        """The name of the recording: that of the folder, without characters that names must not have."""
        return re.sub(r"[^\w .+-]", "_", self.folder.resolve().name)[:_MOST_LETTERS].lstrip(" .+-") or "camera"

    @property
    def poses(self) -> F64:
        """The poses in the world, float64 (T, 24, 3), in metres; NaN without a person."""
        assert self.tracker.records is not None
        return self.tracker.placement.in_world(self.tracker.records.poses)

    @property
    def is_seen(self) -> bool:
        """True if a frame has a pose."""
        return bool(np.isfinite(self.poses).any())


def put_live_take(path: Path, live: LiveRecording, wait: Wait = NO_WAIT) -> tuple[str, tuple[str, ...]]:
    """Store a take of a live camera under an unused name; the index is not rebuilt.

    Parameters
    ----------
    path : Path
        The store.
    live : LiveRecording
        The tracked frames, with a pose in at least one.
    wait : Wait, optional
        The time to wait for another writer.

    Returns
    -------
    take : str
        The name of the take.
    remarks : tuple of str
        Remarks about it.

    Raises
    ------
    KinedexError
        The store cannot be written.
    """
    with open_store(path, at="newest") as store:
        features, rate_hz = store.feature_set, store.rate_hz
    with StoreWriter.open(path, features, rate_hz, wait) as writer:
        take = _free_name(live.recording + LIVE, set(writer.store.take_ids))
        result = _result(live, take, take_ids_of(writer, [take])[take])
        source = live.folder.resolve()
        origin = Provenance(
            str(source.parent), source.name, hash_of(live.poses, checksum(live.camera)), live.bytes,
            round(1e9 * live.begin), live.recording,
        )  # fmt: skip
        made = ReconstructedTake(
            take, origin, result.poses, result.rate_hz, result.fingerprint, tuple(remark_sentences(result.remarks))
        )
        put_takes(writer, [made])
        run = new_run_id()
        for kind in RECONSTRUCTION_KINDS:
            table = result.table(kind, run)
            put_beside(writer, kind, [table], stage=STAGE, run=run, column="take_id", gone=[result.take_id])
        writer.commit()
    return take, result.sentences


def write_live_motion(live: LiveRecording, folder: Path) -> Path:
    """Write the poses as a TRC file with an unused name into a folder, and return its path."""
    names = {one.stem for one in folder.glob("*.trc")}
    path = folder / f"{_free_name(live.recording + LIVE, names)}.trc"
    motion = JointMotion(path.stem, JOINTS, live.poses.astype(np.float32), live.tracker.settings.rate_hz)
    with whole_file(path) as unfinished:
        write_trc(unfinished, motion)
    return path


def _result(live: LiveRecording, take: str, take_id: int) -> ReconstructionResult:
    tracker = live.tracker
    assert tracker.records is not None
    assert tracker.scene is not None  # the scene exists, because there is a pose
    chosen = np.zeros(len(tracker.records), np.int64)
    track = RecordingTrack((tracker.records,), chosen, tuple(tracker.moved), tuple(tracker.missing))
    remarks = frame_remarks(track, tracker.scene, tracker.bones.height_m)
    settings = tracker.settings
    params = ReconstructParameters.model_validate(
        {
            "recordings": str(live.folder), "form": settings.form, "candidates": settings.candidates,
            "direction": "forward", "body": tracker.bones.origin, "stride": tracker.stride,
        }
    )  # fmt: skip
    sentences = list(tracker.placement.notes)
    if tracker.camera.rate_hz is None:
        sentences.append(f"the camera's file states no `rate_hz`: {settings.rate_hz:g} frames per second are assumed")
    sentences += [*remark_sentences(remarks), *fit_remarks(track, tracker.bones)]
    fingerprint = hash_of(hashlib.sha256(live.poses.tobytes()).hexdigest(), params.model_dump(), tracker.bones.lengths)
    return ReconstructionResult(
        take_id, take, live.recording, None, params, track, tracker.scene, tracker.bones, tracker.database.origins,
        settings.rate_hz, live.first_frame, remarks, tuple(sentences), fingerprint,
    )  # fmt: skip


def _free_name(name: str, taken: set[str]) -> str:
    """Return the name, or the name with the lowest unused number from 2 on if it is taken."""
    number, free = 1, name
    while free in taken:
        number += 1
        free = f"{name}_{number}"
    return free
