"""The trackers of whole takes and of frames with the rays of a recording, as `ops.priors.stabilisation` needs them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from kinedex.ops.body.kinematic_chain import ChainBody, Poses
from kinedex.ops.priors.stabilisation import Track
from kinedex.ops.tracking.contours import Observed
from kinedex.ops.tracking.first_track import FirstTrack, first_track
from kinedex.ops.tracking.observations import BodyPoints, PriorTerms, Rays
from kinedex.ops.tracking.take_tracker import SCHEDULE, track_take
from kinedex.ops.tracking.trust import exchanged_sides, restart, trust

Bool = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class RayTracker:
    """The tracker of whole takes with the rays of a recording.

    Attributes
    ----------
    body : ChainBody
        The body.
    points : BodyPoints
        The keypoints on it.
    rays : Rays
        The observations.
    rate_hz : float
        Frames a second.
    carries_over : bool
        False: priors change the frames near their own alone.
    """

    body: ChainBody
    points: BodyPoints
    rays: Rays
    rate_hz: float
    carries_over: bool = False

    @cached_property
    def without(self) -> FirstTrack:
        """The track without priors, with that before its restart."""
        return first_track(Observed(self.body, self.rate_hz, self.rays, self.points))

    def track(self, start: Poses, priors: PriorTerms | None) -> Track:
        """Track the recording again from a start, with the terms of priors."""
        rays = exchanged_sides(self.body, self.rays, self.points, start)
        observed = Observed(self.body, self.rate_hz, rays, self.points)
        return track_take(observed, start, priors, schedule=SCHEDULE[-1:])

    def nodes_seen(self, track: Track) -> Bool:
        """Return the nodes whose keypoints the cameras agree on, bool (T, K)."""
        rays = exchanged_sides(self.body, self.rays, self.points, track.poses)
        return trust(self.body, rays, self.points, track.poses).nodes_seen

    def restart(self, poses: Poses, nodes_seen: Bool) -> Poses:
        """Return poses to start again from, interpolated where nodes are not seen."""
        return restart(self.body, poses, nodes_seen)
