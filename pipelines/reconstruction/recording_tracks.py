"""Track a depth recording frame by frame, and remark on doubtful frames."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from kinedex.catalog.bodies import load_body
from kinedex.catalog.depth_cameras import DepthCamera, Placement, placement_of
from kinedex.ops.arrays import F32, F64, I64
from kinedex.ops.depth.background import behind_share
from kinedex.ops.depth.cones import ConeBody
from kinedex.ops.depth.frame_records import FrameRecords
from kinedex.ops.depth.image_search import DepthView, depth_view
from kinedex.ops.depth.low_pass import choose_directions
from kinedex.ops.depth.points import Preparation, choose_stride, ray_table
from kinedex.ops.depth.size_estimate import LIMITS_M, SECONDS, STEP_M, estimate_size
from kinedex.ops.depth.thinned_poses import facing_of
from kinedex.ops.depth.tracker import MIN_POINTS, FrameResult, Reconstructor, TrackerSettings
from kinedex.ops.errors import KinedexError, ParameterError
from kinedex.ops.wording import counted, listed_frames
from kinedex.pipelines.reconstruction.parameters import ESTIMATE
from kinedex.pipelines.reconstruction.stored_poses import PoseDatabase
from kinedex.storage.formats.depth.recording import DepthRecording
from kinedex.storage.formats.depth.recording_checks import MAX_BEHIND

STRIDE_FRAMES = 10
"""The number of frames by which the stride is chosen."""

_COARSE_PX = 160  # the width of the images in which a person is first searched
FORWARD, BACKWARD = 0, 1
DIRECTIONS = ("forward", "backward")
"""The names of the directions in results."""

MISSING, MOVED, NOBODY = "no image", "camera moved", "nobody"
PEOPLE, CUT, LYING, TURNED = "several people", "cut off", "lying", "turned away"
REMARKS = {
    MISSING: "{frames} without an image, missing or damaged: {numbers}",
    MOVED: "the camera seems to have moved, since much lies behind the background; {frames} not used: {numbers}",
    NOBODY: "nobody is seen in {frames}: {numbers}",
    PEOPLE: "several people are seen in {frames}, and the one nearest to the last pose is tracked: {numbers}",
    CUT: "the image's border cuts the body off in {frames}, where joints are guessed: {numbers}",
    LYING: "the person lies or crouches in {frames}, where errors are larger: {numbers}",
    TURNED: "the person faces more than 45° away from the camera in {frames}, where errors are larger: {numbers}",
}
"""The kinds of remarks on frames, each with the sentence that lists the frames."""

NEAR_BORDER_PX = 1
"""The distance, in pixels, of a body from the image border up to which it counts as cut off."""

LYING_SHARE = 0.4
"""The fraction of the standing height below which the vertical extent of the joints means lying or crouching."""

TURNED_DEGREES = 45.0
"""The angle, in degrees, between facing direction and camera above which a person counts as turned away."""

MAX_COST_M = 0.1
"""The median cost of poses, in metres, above which a body fits badly; 3 to 6 cm are typical."""


class UnusableRecording(KinedexError):
    """A recording cannot be reconstructed because of one key in its file.

    Parameters
    ----------
    key : str
        The key in the recordings file.
    message : str
        What is wrong.
    """

    def __init__(self, key: str, message: str) -> None:
        super().__init__(message)
        self.key = key


@dataclass(frozen=True, eq=False)
class Scene:
    """A camera that is prepared for processing frames.

    Attributes
    ----------
    placement : Placement
        Its position and orientation in the world.
    preparation : Preparation
        Converts frames to points.
    view : DepthView
        The camera in the form that kernels use.
    stride : int
        Step between the rows and columns whose pixels are used.
    """

    placement: Placement
    preparation: Preparation
    view: DepthView
    stride: int


@dataclass(frozen=True, eq=False)
class PersonBones:
    """The bones that a person is tracked with.

    Attributes
    ----------
    origin : str
        The take with these bones; "estimate"; or, before a live camera, "mean" or "height" for mean bones of the
        archive as they are, or scaled to a given height.
    lengths : float64 array (24,)
        The lengths of the bones in metres.
    height_m : float
        The standing height.
    """

    origin: str
    lengths: F64
    height_m: float


class RecordingTrack(NamedTuple):
    """A tracked recording of T frames.

    Attributes
    ----------
    directions : tuple of FrameRecords
        The results of each direction in order of time, forward first; None in frames without an image.
    chosen : int64 array (T,)
        The index of the direction from which each frame is taken.
    moved : tuple of int
        Frames that contradict the background: the camera has moved.
    missing : tuple of int
        Frames without an image, including damaged ones.
    """

    directions: tuple[FrameRecords, ...]
    chosen: I64
    moved: tuple[int, ...]
    missing: tuple[int, ...]

    @property
    def results(self) -> Iterator[FrameResult | None]:
        """The results of the chosen directions, frame by frame; None for frames without an image."""
        return (self.directions[way][t] for t, way in enumerate(self.chosen.tolist()))

    @property
    def poses(self) -> F64:
        """The tracked joint positions in the placement's axes, float64 (T, 24, 3); NaN in frames without a person."""
        poses = self.directions[FORWARD].poses
        for way in range(1, len(self.directions)):
            poses = np.where((self.chosen == way)[:, None, None], self.directions[way].poses, poses)
        return poses


def make_scene(camera: DepthCamera, background: F32 | None, placement: Placement, stride: int) -> Scene:
    """Return a camera that is prepared for processing frames.

    Raises
    ------
    ParameterError
        The camera stands on the floor or below it.
    """
    rays = ray_table(camera.matrix, camera.distortion, camera.size, stride)
    preparation = Preparation(rays, background, placement.turn, placement.floor_height, stride=stride)
    view = depth_view(camera.matrix, camera.distortion, placement.turn, stride)
    return Scene(placement, preparation, view, stride)


def coarse_camera(camera: DepthCamera, background: F32 | None, placement: Placement) -> Scene:
    """Return a camera with reduced resolution, whose images are first searched for a person."""
    return make_scene(camera, background, placement, max(1, camera.size[0] // _COARSE_PX))


def shows_person(coarse: Scene, image: F32) -> bool:
    """Return whether an image shows a person to a camera of reduced resolution."""
    return len(coarse.preparation.prepare(image).points) * coarse.stride**2 >= MIN_POINTS


def first_images(recording: DepthRecording, placement: Placement, count: int) -> list[F32]:
    """Return up to `count` images, beginning with the first frame that shows a person.

    Raises
    ------
    UnusableRecording
        No frame shows a person.
    """
    coarse = coarse_camera(recording.camera, recording.background, placement)
    found: list[F32] = []
    for t in range(len(recording.frames)):
        image = recording.frames[t]
        if image is None or (not found and not shows_person(coarse, image)):
            continue
        found.append(image)
        if len(found) == count:
            break
    if not found:
        raise UnusableRecording(
            "background", f"no frame shows a person, who takes at least {MIN_POINTS} pixels before the background; "
            "are background and `depth_unit_m` those of these images?",
        )  # fmt: skip
    return found


def scene_of(recording: DepthRecording, stride: int | None) -> Scene:
    """Return the camera of a recording, prepared for its frames.

    Parameters
    ----------
    recording : DepthRecording
        The recording.
    stride : int, optional
        Step between the rows and columns whose pixels are used; by default chosen by the first frames with a person.

    Raises
    ------
    UnusableRecording
        No frame shows a person, or the position of the camera in its file is impossible.
    """
    camera, background = recording.camera, recording.background
    placement = placement_of(camera, background)
    try:
        if stride is None:
            images = first_images(recording, placement, STRIDE_FRAMES)
            stride = choose_stride(
                images, camera.matrix, camera.distortion, background, placement.turn, placement.floor_height
            )
        return make_scene(camera, background, placement, stride)
    except ParameterError as fault:
        raise UnusableRecording("camera", str(fault)) from None


def estimated_bones(
    recording: DepthRecording, scene: Scene, database: PoseDatabase, settings: TrackerSettings
) -> PersonBones:
    """Return the mean bones of the archive, scaled to the size of the person.

    Raises
    ------
    UnusableRecording
        No person is found in the first second.
    """
    images = first_images(recording, scene.placement, max(1, round(SECONDS * recording.rate_hz)))
    try:
        found = estimate_size(
            load_body(), database.mean_bones, database.directions, scene.preparation, scene.view, images, settings
        )
    except ParameterError as fault:
        raise UnusableRecording(
            "body", f"the size cannot be estimated ({fault}); name a take of the person: `body: <take>`"
        ) from None
    return PersonBones("estimate", found.bone_lengths, found.height)


def reconstructor_of(
    body: ConeBody, bones: PersonBones, database: PoseDatabase, scene: Scene, settings: TrackerSettings
) -> Reconstructor:
    """Return a tracker of a person before a camera."""
    return Reconstructor(body, bones.lengths, database.directions, scene.preparation, scene.view, settings)


def track_recording(
    recording: DepthRecording, tracker: Reconstructor, *, both_ways: bool, is_empty_room: bool
) -> RecordingTrack:
    """Track the poses of a person through a depth recording, in one or both directions of time.

    Parameters
    ----------
    recording : DepthRecording
        The recording.
    tracker : Reconstructor
        The tracker, which is restarted.
    both_ways : bool
        True to track backwards as well, and take each frame from one of the two directions.
    is_empty_room : bool
        True if the background is an image of the empty room: frames with many pixels behind it are not used.

    Returns
    -------
    RecordingTrack
        The results of each direction, the direction chosen for each frame, and the frames that were not used.
    """
    moved: set[int] = set()
    missing: set[int] = set()

    def images(order: Iterable[int]) -> Iterable[tuple[int, F32 | None]]:
        for t in order:
            image = None if t in moved or t in missing else recording.frames[t]
            if image is None:
                missing.update({t} - moved)
            elif is_empty_room and is_camera_moved(image, recording.background):
                moved.add(t)
                image = None
            yield t, image

    frames = range(len(recording.frames))
    tracks = [_results(tracker, images(frames), len(frames))]
    if both_ways:
        tracks.append(_results(tracker, images(reversed(frames)), len(frames)))
        tracks[BACKWARD].reverse()
    chosen = np.zeros(len(frames), np.int64)
    if both_ways:
        costs = np.stack([one.costs for one in tracks], axis=1)
        chosen = choose_directions(tracks[FORWARD].poses, tracks[BACKWARD].poses, costs)
    return RecordingTrack(tuple(tracks), chosen, tuple(sorted(moved)), tuple(sorted(missing)))


def is_camera_moved(image: F32, background: F32 | None) -> bool:
    """Return whether more than `MAX_BEHIND` of an image lies behind the background; False without a background."""
    return background is not None and behind_share(image, background) > MAX_BEHIND


def _results(tracker: Reconstructor, images: Iterable[tuple[int, F32 | None]], frames: int) -> FrameRecords:
    """Track images in their order, and return the results."""
    tracker.restart()
    found = FrameRecords(tracker.settings.most_candidates, frames)
    for _, image in images:
        if image is None:
            tracker.skip()
            found.append(None)
        else:
            found.append(tracker.step(image))
    return found


def frame_remarks(track: RecordingTrack, scene: Scene, height_m: float) -> list[tuple[str, ...]]:
    """Return the remarks on each frame, as keys of `REMARKS`.

    Parameters
    ----------
    track : RecordingTrack
        The tracked recording.
    scene : Scene
        Its camera.
    height_m : float
        The standing height of the person in metres.
    """
    moved, missing = set(track.moved), set(track.missing)
    shape = scene.preparation.shape
    found: list[tuple[str, ...]] = []
    for t, result in enumerate(track.results):
        if result is None:
            found.append((MISSING if t in missing else MOVED if t in moved else NOBODY,))
        else:
            found.append(tuple(_remarks(result, (int(shape[0]), int(shape[1])), height_m)))
    return found


def _remarks(result: FrameResult, shape: tuple[int, int], height_m: float) -> list[str]:
    if result.hypothesis is None:
        return [NOBODY]
    found = [PEOPLE] if result.people > 1 else []
    u0, v0, u1, v1 = result.box
    if min(u0, v0, shape[1] - u1, shape[0] - v1) < NEAR_BORDER_PX:
        found.append(CUT)
    heights = result.pose[:, 1]
    if heights.max() - heights.min() < LYING_SHARE * height_m:
        found.append(LYING)
    facing = np.empty(3)
    facing_of(result.pose, facing)
    towards = -result.pose[0] * (1.0, 0.0, 1.0)
    cosine = float(facing @ towards) / max(float(np.linalg.norm(towards)), 1e-9)
    if cosine < np.cos(np.radians(TURNED_DEGREES)):
        found.append(TURNED)
    return found


def remark_sentences(remarks: Sequence[Sequence[str]]) -> list[str]:
    """Return a sentence for each kind of remark, with the frames that have it.

    Parameters
    ----------
    remarks : sequence of sequence of str
        The remarks on each frame.
    """
    sentences = []
    for name, text in REMARKS.items():
        frames = [t for t, own in enumerate(remarks) if name in own]
        if frames:
            sentences.append(text.format(frames=counted(len(frames), "frame"), numbers=listed_frames(frames)))
    return sentences


def fit_remarks(track: RecordingTrack, bones: PersonBones) -> list[str]:
    """Return sentences on a body that fits the points badly, or whose estimated size is at a limit.

    Parameters
    ----------
    track : RecordingTrack
        The tracked recording, with a pose in at least one frame.
    bones : PersonBones
        The bones of the person.
    """
    found = []
    costs = np.where(track.chosen == 0, track.directions[0].costs, track.directions[-1].costs)
    cost = float(np.nanmedian(costs))
    if cost > MAX_COST_M:
        found.append(
            f"the body fits the points badly: half of the poses cost more than {100 * cost:.0f} cm, usual are 3 to 6; "
            "are fx, fy, `depth_unit_m` and `body` those of this recording, and does nothing but the person stand "
            "before the background?"
        )
    if bones.origin == ESTIMATE and not LIMITS_M[0] + STEP_M < bones.height_m < LIMITS_M[1] - STEP_M:
        found.append(
            f"the estimated height of {bones.height_m:.2f} m is at the end of what is tried: are fx, fy and "
            "`depth_unit_m` those of this recording?"
        )
    return found
