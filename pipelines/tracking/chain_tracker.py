"""Track recordings by the kinematic chain, in the form that stabilisation by priors requires."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from kinedex.ops.arrays import F64, I64, Bool
from kinedex.ops.body.kinematic_chain import ChainBody, Poses
from kinedex.ops.priors.stabilisation import Track
from kinedex.ops.tracking.contours import Observed
from kinedex.ops.tracking.first_track import first_track
from kinedex.ops.tracking.frame_tracker import track_frames
from kinedex.ops.tracking.observations import JointPositions, PriorTerms, Rays
from kinedex.ops.tracking.ray_residuals import ray_residuals
from kinedex.ops.tracking.rays import SIGMA_PX
from kinedex.ops.tracking.take_tracker import SCHEDULE, Loss, TakeTrack, track_take, track_take_on_silhouettes
from kinedex.ops.tracking.trust import SEEN, Trust, exchanged_sides, restart, trust

AGREEING = 0.5
"""The smallest robust weight of a keypoint with which a camera agrees with a track."""


@dataclass(frozen=True)
class TrackSettings:
    """Settings of a tracker.

    Attributes
    ----------
    tracker : str
        `take`, which optimises all frames at once, or `frames`, one after the other, as in the thesis.
    loss : str
        The loss of the tracker `take`: `geman_mcclure` or `squares`.
    sigma_px : float
        Standard deviation of a keypoint in pixels.
    """

    tracker: Literal["take", "frames"] = "take"
    loss: Loss = "geman_mcclure"
    sigma_px: float = SIGMA_PX


class ChainTracker:
    """A tracker with its observations, as required by `ops.priors.stabilisation`.

    Parameters
    ----------
    observed : Observed
        The observations.
    settings : TrackSettings
        The tracker and its settings.
    """

    def __init__(self, observed: Observed, settings: TrackSettings) -> None:
        self.observed = observed
        self.settings = settings

    @property
    def body(self) -> ChainBody:
        """The body that is tracked."""
        return self.observed.body

    @property
    def rate_hz(self) -> float:
        """Frames per second."""
        return self.observed.rate_hz

    @property
    def carries_over(self) -> bool:
        """True if a prior also changes later frames and can lower their costs, as with silhouettes alone."""
        return self.observed.observations is None

    def first(self) -> Track:
        """Track without priors, and restart where neither hip is seen.

        Raises
        ------
        ParameterError
            Hips and shoulders are seen in no frame.
        """
        if self.settings.tracker == "frames":
            return self._frame_by_frame(None, None)
        found = first_track(self.observed, self.settings.loss, self.settings.sigma_px).track
        return self._with_silhouettes(found, None)

    def track(self, start: Poses, priors: PriorTerms | None) -> Track:
        """Track the recording again from initial poses, with the terms of priors."""
        if self.settings.tracker == "frames":
            return self._frame_by_frame(Poses(start.positions[:1], start.rotations[:1]), priors)
        fitting = replace(self.observed, observations=self._exchanged(start))
        found = track_take(fitting, start, priors, self.settings.loss, self.settings.sigma_px, SCHEDULE[-1:])
        return self._with_silhouettes(found, priors)

    def _with_silhouettes(self, found: TakeTrack, priors: PriorTerms | None) -> TakeTrack:
        """Return a track that is fitted to the masks as well, if there are any."""
        if self.observed.silhouettes is None:
            return found
        fitting = replace(self.observed, observations=self._exchanged(found.poses))
        return track_take_on_silhouettes(fitting, found.poses, priors, self.settings.loss, self.settings.sigma_px)

    def trust(self, poses: Poses) -> Trust | None:
        """Return how well the original observations agree with poses; None if there are only silhouettes."""
        observed = self.observed
        if observed.observations is None:
            return None
        return trust(observed.body, observed.observations, observed.points, poses, self.settings.sigma_px)

    def _exchanged(self, poses: Poses) -> Rays | JointPositions | None:
        """Return the observations, with legs exchanged if that fits the poses; unchanged for the tracker `frames`."""
        observed, settings = self.observed, self.settings
        if observed.observations is None or settings.tracker == "frames":
            return observed.observations
        return exchanged_sides(observed.body, observed.observations, observed.points, poses, settings.sigma_px)

    def nodes_seen(self, track: Track) -> Bool:
        """Return the nodes on whose keypoints the cameras agree, bool (T, K); all nodes for silhouettes alone."""
        observed, fitting = self.observed, self._exchanged(track.poses)
        if fitting is None:
            return np.ones(track.poses.rotations.shape[:2], np.bool_)
        return trust(observed.body, fitting, observed.points, track.poses, self.settings.sigma_px).nodes_seen

    def restart(self, poses: Poses, nodes_seen: Bool) -> Poses:
        """Return poses whose first node is interpolated in frames in which neither hip is seen."""
        return restart(self.body, poses, nodes_seen)

    def _frame_by_frame(self, first: Poses | None, priors: PriorTerms | None) -> Track:
        return track_frames(self.observed, first, priors, self.settings.sigma_px)


@dataclass(frozen=True, eq=False)
class FrameStatistics:
    """Statistics of the frames of a track.

    Attributes
    ----------
    cameras : int64 array (T,), optional
        The number of cameras that saw the body; None without cameras.
    agreeing : float64 array (T,), optional
        The number of cameras that agree with the track, as mean over the keypoints seen; None without cameras.
    trusted : float64 array (T,)
        The fraction of keypoints that are trusted.
    contested : int64 array (T,)
        The number of keypoints on which the cameras disagree.
    """

    cameras: I64 | None
    agreeing: F64 | None
    trusted: F64
    contested: I64


def frame_statistics(tracker: ChainTracker, poses: Poses) -> FrameStatistics:
    """Return statistics of the frames of a track."""
    observed, frames = tracker.observed, tracker.observed.frames
    found = tracker.trust(poses)
    if found is None:
        return FrameStatistics(None, None, np.ones(frames), np.zeros(frames, np.int64))
    trusted, contested = (found.keypoints > SEEN).mean(axis=1), found.contested.sum(axis=1)
    if not isinstance(observed.observations, Rays):
        return FrameStatistics(None, None, trusted, contested)
    residuals = ray_residuals(observed, poses, tracker.settings.sigma_px)
    seen = np.isfinite(residuals.pixels)
    agreeing = (residuals.weights >= AGREEING).sum(axis=1).sum(axis=1) / np.maximum(seen.any(axis=1).sum(axis=1), 1)
    return FrameStatistics(seen.any(axis=2).sum(axis=1), agreeing, trusted, contested)
