"""The rows of the study of depth cameras: recordings tracked by one method, with the error of every frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from kinedex.catalog.bodies import load_body
from kinedex.ops.depth.image_search import DepthView, depth_view
from kinedex.ops.depth.low_pass import choose_directions
from kinedex.ops.depth.points import Preparation, choose_stride, ray_table
from kinedex.ops.depth.pose_distance import COMPARED, are_ends_found
from kinedex.ops.depth.size_estimate import estimate_size
from kinedex.ops.depth.tracker import FrameResult, Reconstructor, TrackerSettings
from studies.depth_set import RATE_HZ, Archive, Filmed

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]

BODY = load_body()
LOCAL = TrackerSettings(hypotheses=("local",))
DATABASE = TrackerSettings(hypotheses=("database",))
ONE = TrackerSettings(candidates=1)
DEFAULT = TrackerSettings()
PRINTED = TrackerSettings(form="printed", candidates=1)
PRINTED_LOCAL = TrackerSettings(form="printed", hypotheses=("local",), candidates=1)


@dataclass(frozen=True, eq=False)
class Tracked:
    """A tracked recording of T frames.

    Attributes
    ----------
    poses : float64 array (T, 24, 3)
        The joints in metres.
    costs : float64 array (T,)
        The cost in the vote.
    errors_cm : float64 array (T,)
        The mean distance of the compared joints from the truth; a frame without a pose has an error of its height.
    database : bool array (T,)
        The frames in which the pose of the database was taken.
    found : bool array (T,)
        The frames in which all five ends have an extremum.
    """

    poses: F64
    costs: F64
    errors_cm: F64
    database: Bool
    found: Bool


def errors_cm(poses: F64, truth: F64) -> F64:
    """Return the error (T,) of poses (T, 24, 3); one without a pose is off by the height of the person."""
    away = np.linalg.norm(poses[:, COMPARED] - truth[:, COMPARED], axis=2).mean(axis=1)
    heights = truth[..., 1].max(axis=1) - truth[..., 1].min(axis=1)
    found: F64 = 100.0 * np.where(np.isfinite(away), away, heights)
    return found


def prepared(one: Filmed) -> tuple[Preparation, DepthView]:
    """Return the preparation and the camera of a recording, whose floor is known by the camera's pose."""
    camera, background = one.camera, one.background
    floor = None if camera.place is None else -float(camera.place[1])
    matrix, distortion = camera.matrix, camera.distortion
    stride = choose_stride(one.images[:10], matrix, distortion, background, floor_height=floor)
    rays = ray_table(matrix, distortion, camera.size, stride)
    preparation = Preparation(rays, background, None, floor, stride=stride)
    return preparation, depth_view(matrix, distortion, stride=stride)


def tracked(one: Filmed, archive: Archive, bones: F64, settings: TrackerSettings, *, backward: bool = False) -> Tracked:
    """Track a recording.

    Parameters
    ----------
    one : Filmed
        The recording.
    archive : Archive
        The pose database.
    bones : float64 array (24,)
        Bone lengths in metres.
    settings : TrackerSettings
        The method.
    backward : bool, optional
        Begin with the last frame.
    """
    preparation, view = prepared(one)
    tracker = Reconstructor(BODY, bones, archive.directions, preparation, view, settings)
    order = range(len(one.truth))[:: -1 if backward else 1]
    results = {t: tracker.step(one.images[t]) for t in order}
    return _tracked([results[t] for t in range(len(one.truth))], one.truth)


def _tracked(results: Sequence[FrameResult], truth: F64) -> Tracked:
    poses = np.array([result.pose for result in results])
    found = are_ends_found(np.array([result.extrema[:5] for result in results]), truth)
    return Tracked(
        poses,
        np.array([result.cost for result in results]),
        errors_cm(poses, truth),
        np.array([result.hypothesis == "database" for result in results]),
        found,
    )


def both_ways(forward: Tracked, backward: Tracked, truth: F64) -> Tracked:
    """Return the track that takes each frame from one of two."""
    costs = np.stack([forward.costs, backward.costs], axis=1)
    later = choose_directions(forward.poses, backward.poses, costs).astype(bool)
    poses = np.where(later[:, None, None], backward.poses, forward.poses)
    return Tracked(
        poses,
        np.where(later, backward.costs, forward.costs),
        errors_cm(poses, truth),
        np.where(later, backward.database, forward.database),
        forward.found,
    )


def estimated_bones(one: Filmed, archive: Archive) -> F64:
    """Return the archive's mean bones in proportion to the size that is estimated from the first second."""
    preparation, view = prepared(one)
    images = one.images[: round(RATE_HZ)]
    return estimate_size(BODY, archive.mean_bones, archive.directions, preparation, view, images).bone_lengths
