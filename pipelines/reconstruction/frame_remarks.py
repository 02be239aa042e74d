"""Make remarks on the frames of a tracked depth recording: reasons to doubt a pose, or why there is none."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from kinedex.ops.depth.pose_database import facing_of
from kinedex.ops.depth.size_estimate import LIMITS_M, STEP_M
from kinedex.ops.depth.tracker import FrameResult
from kinedex.ops.wording import counted
from kinedex.pipelines.reconstruction.parameters import ESTIMATE
from kinedex.pipelines.reconstruction.recording_tracks import PersonBones, RecordingTrack, Scene

F64 = npt.NDArray[np.float64]

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
"""A person lies or crouches if the joints are within a layer less high than this share of the standing height."""

TURNED_DEGREES = 45.0
"""The angle, in degrees, between facing direction and camera above which a person counts as turned away."""

MOST_COST_M = 0.1
"""The median cost of poses, in metres, above which a body fits badly; 3 to 6 cm are typical."""

_MOST_RANGES = 8


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
    if cost > MOST_COST_M:
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


def listed_frames(frames: Sequence[int]) -> str:
    """Format ascending frames as ranges such as "3, 7–12"; only the first ones if there are many."""
    ranges: list[list[int]] = []
    for t in frames:
        if ranges and ranges[-1][1] == t - 1:
            ranges[-1][1] = t
        else:
            ranges.append([t, t])
    texts = [str(first) if first == last else f"{first}–{last}" for first, last in ranges[:_MOST_RANGES]]
    more = f" and {len(ranges) - _MOST_RANGES} more ranges" if len(ranges) > _MOST_RANGES else ""
    return ", ".join(texts) + more
