"""Track a person before a depth camera frame by frame, with images that the caller reads, and store the take."""

from __future__ import annotations

import hashlib
import re
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.catalog.bodies import load_body
from kinedex.catalog.depth_cameras import DepthCamera, Placement, placement_of
from kinedex.ops.arrays import F32, F64
from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.depth.frame_records import FrameRecords
from kinedex.ops.depth.points import choose_stride
from kinedex.ops.depth.pose_fit import Form
from kinedex.ops.depth.size_estimate import LIMITS_M, SECONDS, estimate_size
from kinedex.ops.depth.thinned_poses import DISTANCE_M
from kinedex.ops.depth.tracker import FrameResult, Reconstructor, TrackerSettings
from kinedex.ops.errors import KinedexError, ParameterError
from kinedex.pipelines.engine.digests import hash_of
from kinedex.pipelines.engine.run_id import new_run_id
from kinedex.pipelines.reconstruction.parameters import ESTIMATE, ReconstructParameters
from kinedex.pipelines.reconstruction.reconstructed_takes import (
    LIVE,
    RECONSTRUCTION_KINDS,
    ReconstructedTake,
    ReconstructionResult,
)
from kinedex.pipelines.reconstruction.reconstruction_runs import take_bones
from kinedex.pipelines.reconstruction.recording_tracks import (
    PersonBones,
    RecordingTrack,
    Scene,
    coarse_camera,
    fit_remarks,
    frame_remarks,
    is_camera_moved,
    make_scene,
    reconstructor_of,
    remark_sentences,
    shows_person,
)
from kinedex.pipelines.reconstruction.stored_poses import (
    PoseDatabase,
    build_pose_database,
    listed_takes,
    read_pose_database,
)
from kinedex.pipelines.tracking.recorded_takes import Provenance, put_takes
from kinedex.pipelines.tracking.recording_runs import put_for_takes, take_ids_of
from kinedex.storage.durable_files import whole_file
from kinedex.storage.formats.depth.camera_file import read_camera
from kinedex.storage.formats.depth.frames import read_frame
from kinedex.storage.formats.motion.joint_motion import JointMotion
from kinedex.storage.formats.motion.sources import checksum
from kinedex.storage.formats.motion.table_writer import write_trc
from kinedex.storage.lock import NO_WAIT, Wait
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.writer import StoreWriter

_DRAWN_M, _DRAWN_PX = 2.5, 160  # the distance of a drawn figure, and the width of its image

USUAL_HZ = 30.0
"""The assumed frames per second of a camera that does not state its rate."""

STAGE = "depth/live"
"""The stage of results of live cameras, which runs over recordings leave unchanged."""

_MAX_LETTERS = 80


def newest_database(store: Store) -> PoseDatabase:
    """Return the newest pose database of a store; if it has none, build one from its takes with a class.

    Raises
    ------
    KinedexError
        No take provides a pose.
    """
    parts = sorted(store.manifest.results.get("pose_takes", ()), key=lambda part: part.run, reverse=True)
    for stage in dict.fromkeys(part.stage for part in parts):
        found = read_pose_database(store, stage)
        if found is not None and len(found.directions):
            return found
    takes = listed_takes(store, "class IS NOT NULL", "")
    if not takes:
        raise KinedexError(
            f"{store.path}: there is no pose database, and no take with a class that provides poses; "
            f"`kinedex reconstruct {store.path} RECORDINGS --set pose_database.where=true` makes one of all takes"
        )
    return build_pose_database(store, takes, DISTANCE_M, None, lambda line: None)


def bones_of(store: Store, database: PoseDatabase, body: str | float | None) -> PersonBones:
    """Return the bones of a take, or the archive's mean bones, scaled to a height in metres if one is given.

    The mean bones are also used for a person whose size is yet to be estimated.

    Raises
    ------
    KinedexError
        The store has no such take, or the height is not that of a person.
    """
    if isinstance(body, str) and body != ESTIMATE:
        return take_bones(store, body, "body")
    mean, model = database.mean_bones, load_body()
    usual = model.standing_height(mean)
    height_m = usual if body is None or body == ESTIMATE else float(body)
    if not LIMITS_M[0] <= height_m <= LIMITS_M[1]:
        raise ParameterError("body", f"a take, or a height from {LIMITS_M[0]:g} to {LIMITS_M[1]:g} m", body)
    return PersonBones("mean" if body is None else "height", mean * (height_m / usual), height_m)


@dataclass(eq=False)
class LiveTracker:
    """A tracker of a person before a depth camera.

    Attributes
    ----------
    camera : DepthCamera
        The camera.
    background : float32 array (H, W) or None
        The depths of the empty room in metres.
    placement : Placement
        The position and orientation of the camera.
    bones : PersonBones
        The bones of the person.
    database : PoseDatabase
        The poses.
    settings : TrackerSettings
        The settings of the tracker.
    stride : int or None
        Step between the rows and columns whose pixels are used; None until a frame shows a person.
    records : FrameRecords or None
        The results of all frames; None if they are not recorded.
    moved, missing : list of int
        Numbers, from 0, of frames that contradict the background, and of frames without an image.
    """

    camera: DepthCamera
    background: F32 | None
    placement: Placement
    bones: PersonBones
    database: PoseDatabase
    settings: TrackerSettings
    stride: int | None = None
    records: FrameRecords | None = None
    moved: list[int] = field(default_factory=list)
    missing: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._coarse = coarse_camera(self.camera, self.background, self.placement)
        self._tracker: Reconstructor | None = None
        self._scene: Scene | None = None
        self._measured: list[F32 | None] | None = (
            None  # the frames from which the size is estimated; None for a given size
        )
        self._frames = self._first = 0  # numbers of frames so far, and before the first person

    @classmethod
    def open(
        cls,
        path: Path,
        camera_file: Path,
        body: str | float | None = None,
        background: str | Path | npt.ArrayLike | None = None,
        rate_hz: float | None = None,
        form: Form = "best",
        stride: int | None = None,
        *,
        keep: bool = False,
    ) -> LiveTracker:
        """Return a tracker with the poses of a store; see `kinedex.Reconstructor`."""
        camera = read_camera(camera_file)
        room: F32 | None = None
        if isinstance(background, str | Path):
            room = read_frame(Path(background), camera)
        elif background is not None:
            room = camera.depths(np.asarray(background))
        with open_store(path, at="newest") as store:
            database = newest_database(store)
            bones = bones_of(store, database, body)
        settings = TrackerSettings(
            form, candidates=1 if form == "printed" else TrackerSettings.candidates,
            rate_hz=rate_hz or camera.rate_hz or USUAL_HZ,
        )  # fmt: skip
        records = FrameRecords(settings.most_candidates) if keep else None
        made = cls(camera, room, placement_of(camera, room), bones, database, settings, stride, records)
        made._measured = [] if body == ESTIMATE else None
        made.load_kernels()
        return made

    def load_kernels(self) -> None:
        """Track a synthetic figure for two frames, so that kernels are loaded before the first frame of the camera."""
        camera, placement = self.camera, Placement(np.eye(3), None, np.eye(3), np.zeros(3))
        stride = max(1, camera.size[0] // _DRAWN_PX)
        a, b = camera.rays[..., 0] * _DRAWN_M, camera.rays[..., 1] * _DRAWN_M
        image = np.where((a / 0.3) ** 2 + (b / 0.9) ** 2 < 1.0, np.float32(_DRAWN_M), np.float32(0.0))
        tracker = reconstructor_of(
            load_body(), self.bones, self.database, make_scene(camera, None, placement, stride), self.settings
        )
        for _ in range(2):
            tracker.step(image)

    @property
    def scene(self) -> Scene | None:
        """The prepared camera; None until a frame shows a person."""
        return self._scene

    @property
    def is_measuring(self) -> bool:
        """True until the size of the person has been estimated; always False for a given size."""
        return self._measured is not None

    def step(self, values: npt.NDArray[np.generic]) -> tuple[FrameResult | None, F64]:
        """Return the result of the next frame and world positions (24, 3) of joints; None and NaN if nobody is seen."""
        return self.follow(self.camera.depths(values))

    def follow(self, image: F32) -> tuple[FrameResult | None, F64]:
        """Track a frame of depths in metres along the camera's axis; return the same as `step`."""
        nobody = None, np.full((len(JOINTS), 3), np.nan)
        if is_camera_moved(image, self.background):
            self.moved.append(self._frames)
            self._pass_over(1)
            return nobody
        if self._tracker is None and not self._begin(image):
            self._keep(None)
            return nobody
        assert self._tracker is not None
        result = self._tracker.step(image)
        self._keep(result)
        if self._measured is not None:
            self._measured.append(image)
            if len(self._measured) >= max(1, round(SECONDS * self.settings.rate_hz)):
                result = self.measure() or result
        return result, self.placement.in_world(result.pose)

    def skip(self, frames: int) -> None:
        """Skip frames that are missing."""
        self.missing += range(self._frames, self._frames + frames)
        self._pass_over(frames)

    def measure(self) -> FrameResult | None:
        """Estimate the size of the person from the frames so far, and track these again; return the last result.

        The result is None, and the bones are not changed, if no person was seen, or the size is known or cannot be
        estimated.
        """
        images, self._measured = self._measured, None
        seen = [image for image in images or () if image is not None]
        if not seen or self._scene is None:
            return None
        body, scene = load_body(), self._scene
        try:
            found = estimate_size(
                body, self.database.mean_bones, self.database.directions, scene.preparation, scene.view, seen,
                self.settings,
            )  # fmt: skip
        except ParameterError:
            return None
        self.bones = PersonBones(ESTIMATE, found.bone_lengths, found.height)
        self._tracker = reconstructor_of(body, self.bones, self.database, scene, self.settings)
        result = None
        assert images is not None
        for t, image in enumerate(images, self._first):
            if image is None:
                self._tracker.skip()
                continue
            result = self._tracker.step(image)
            if self.records is not None:
                self.records[t] = result
        return result

    def _pass_over(self, frames: int) -> None:
        if self._tracker is not None:
            self._tracker.skip(frames)
            if self._measured is not None:
                self._measured += [None] * frames
        for _ in range(frames):
            self._keep(None)

    def _keep(self, result: FrameResult | None) -> None:
        self._frames += 1
        if self.records is not None:
            self.records.append(result)

    def _begin(self, image: F32) -> bool:
        """Create the tracker if a frame shows a person; return whether it does."""
        if not shows_person(self._coarse, image):
            return False
        camera, placement = self.camera, self.placement
        self._first = self._frames
        self.stride = self.stride or choose_stride(
            [image], camera.matrix, camera.distortion, self.background, placement.turn, placement.floor_height
        )
        self._scene = make_scene(camera, self.background, placement, self.stride)
        self._tracker = reconstructor_of(load_body(), self.bones, self.database, self._scene, self.settings)
        return True


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
        """The name of the recording: the name of the folder without characters that are not allowed in names."""
        return re.sub(r"[^\w .+-]", "_", self.folder.resolve().name)[:_MAX_LETTERS].lstrip(" .+-") or "camera"

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
            put_for_takes(writer, kind, [table], stage=STAGE, run=run, column="take_id", gone=[result.take_id])
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
