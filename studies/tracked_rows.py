"""Tracks of a recording by every method of the study of priors: filtered points, a fit of points, and the body."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from kinedex.ops.body.kinematic_chain import ChainBody
from kinedex.ops.priors.archive_poses import PriorMotion
from kinedex.ops.priors.stabilisation import Settings, StabilisedTrack, stabilise
from kinedex.ops.tracking.body_estimate import estimate_body
from kinedex.ops.tracking.triangulation import triangulate
from studies.camera_set import CHAIN, KEYPOINTS, Filmed
from studies.filters import butterworth, kalman_smoother, one_euro, savitzky_golay, without_gaps
from studies.point_fit import fitted_points
from studies.prior_archive import track_words
from studies.ray_tracker import RayTracker

F64 = npt.NDArray[np.float64]

TRIANGULATION = "triangulation, gaps filled"
FILTERS: dict[str, Callable[[F64, F64, float], F64]] = {
    "+ Butterworth 6 Hz": lambda filled, _, rate_hz: butterworth(filled, 6.0, rate_hz),
    "+ Savitzky–Golay, 11 frames": lambda filled, _, rate_hz: savitzky_golay(filled, 11, 3),
    "+ one-euro (1 Hz, 0.7)": lambda filled, _, rate_hz: one_euro(filled, 1.0, 0.7, rate_hz),
    "+ Kalman and RTS": lambda _, points, rate_hz: kalman_smoother(points, rate_hz, 0.02, 15.0),
}
"""Filters of points, from points with gaps filled, points with gaps, and frames a second."""
POINT_FIT = "points with limb lengths (after AniPose)"
CHAIN_ROW, WITHOUT = "whole-take chain, no priors", "+ restart"
BONES = (
    ("left_shoulder", "right_shoulder"), ("left_hip", "right_hip"),
    *((f"{side}_{one}", f"{side}_{other}") for side in ("left", "right") for one, other in (
        ("shoulder", "hip"), ("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"),
        ("ankle", "big_toe"),
    )),
)  # fmt: skip
"""Pairs of keypoints whose distance the fit of points keeps."""


@dataclass(frozen=True, eq=False)
class Tracked:
    """A track of a recording.

    Attributes
    ----------
    errors_mm : float64 array (T,)
        The mean error of the measured joints in each frame.
    seconds : float
        The time that it took, that of the tracks that it starts from included.
    """

    errors_mm: F64
    seconds: float


def round_name(number: int) -> str:
    """Return the name of the row of a round of archive priors."""
    return f"+ archive priors, {number} round{'s' if number > 1 else ''}"


def point_rows(one: Filmed) -> dict[str, Tracked]:
    """Return the tracks of points without a body."""
    begin = time.perf_counter()
    points, _ = triangulate(one.rays)
    filled = without_gaps(points)
    spent = time.perf_counter() - begin
    found = {TRIANGULATION: Tracked(one.keypoint_errors_mm(filled), spent)}
    for name, smoother in FILTERS.items():
        begin = time.perf_counter()
        smoothed = smoother(filled, points, one.rate_hz)
        found[name] = Tracked(one.keypoint_errors_mm(smoothed), spent + time.perf_counter() - begin)
    begin = time.perf_counter()
    bones = [(KEYPOINTS.order.index(first), KEYPOINTS.order.index(second)) for first, second in BONES]
    fitted = fitted_points(one.rays, points, bones, one.rate_hz)
    found[POINT_FIT] = Tracked(one.keypoint_errors_mm(fitted), spent + time.perf_counter() - begin)
    return found


def tracker_of(one: Filmed, body: ChainBody | None = None) -> RayTracker:
    """Return the tracker of a recording, with the actor's body or another one."""
    chosen = one.body if body is None else body
    return RayTracker(chosen, KEYPOINTS.body_points(KEYPOINTS.order, chosen), one.rays, one.rate_hz)


def stabilised(tracker: RayTracker, motions: Sequence[PriorMotion], settings: Settings) -> StabilisedTrack:
    """Stabilise the track of a recording."""
    words = lambda track: track_words(tracker.body, track.poses, tracker.rate_hz)  # noqa: E731
    return stabilise(tracker, tracker.without.track, words, motions, settings)


def body_rows(
    one: Filmed, tracker: RayTracker, motions: Sequence[PriorMotion], rounds: Sequence[int]
) -> dict[str, Tracked]:
    """Return the tracks of the body, without priors and with them."""
    begin = time.perf_counter()
    first = tracker.without
    spent = time.perf_counter() - begin
    found = {
        CHAIN_ROW: Tracked(one.errors_mm(first.before.positions), spent),
        WITHOUT: Tracked(one.errors_mm(first.track.positions), spent),
    }
    for number in rounds:
        begin = time.perf_counter()
        track = stabilised(tracker, motions, Settings(rounds=number)).track
        found[round_name(number)] = Tracked(one.errors_mm(track.positions), spent + time.perf_counter() - begin)
    return found


def estimated_body(one: Filmed, archive_mean: ChainBody) -> ChainBody:
    """Return the body whose lengths are estimated from the recording."""
    points, cameras = triangulate(one.rays)
    return estimate_body(CHAIN, points, cameras, one.points.joints, archive_mean).body
