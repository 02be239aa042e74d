"""This module tracks a recording without priors, in two passes.

The second pass restarts from the result of the first, with nodes interpolated in frames in which they are not seen, and
with the keypoints of the legs exchanged where a camera has confused left and right.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from kinedex.ops.body.kinematic_chain import ChainBody, Poses
from kinedex.ops.errors import ParameterError
from kinedex.ops.tracking.contours import Observed
from kinedex.ops.tracking.observations import BodyPoints, JointPositions, Rays
from kinedex.ops.tracking.rays import SIGMA_PX
from kinedex.ops.tracking.take_tracker import SCHEDULE, Loss, TakeTrack, track_take
from kinedex.ops.tracking.triangulation import (
    MIN_CONFIDENCE,
    start_from_positions,
    start_from_triangulation,
    triangulate,
)
from kinedex.ops.tracking.trust import Trust, exchanged_sides, restart, trust


@dataclass(frozen=True, eq=False)
class FirstTrack:
    """The track of a recording without priors, with intermediate results.

    Attributes
    ----------
    start : Poses
        The initial poses.
    before : TakeTrack
        The track of the first pass.
    track : TakeTrack
        The track of the second pass, the result.
    trust : Trust
        The reliability of the original observations, computed from the result.
    """

    start: Poses
    before: TakeTrack
    track: TakeTrack
    trust: Trust


def first_track(observed: Observed, loss: Loss = "geman_mcclure", sigma_px: float = SIGMA_PX) -> FirstTrack:
    """Track a recording without priors.

    Parameters
    ----------
    observed : Observed
        A body with the nodes of the shipped chain, and rays or joint positions of T frames.
    loss : str, optional
        `geman_mcclure`, or `squares` as in the thesis.
    sigma_px : float, optional
        Standard deviation of a keypoint in pixels.

    Raises
    ------
    ParameterError
        The arguments do not match each other, or a hip or a shoulder is never seen.
    """
    body, observations, points = observed.body, observed.observations, observed.points
    if observations is None:
        raise ParameterError("observations", "rays or places", None)
    start = find_start(body, observations, points, sigma_px)
    before = track_take(observed, start, None, loss, sigma_px)
    seen = trust(body, observations, points, before.poses, sigma_px).nodes_seen
    again = restart(body, before.poses, seen)
    fitting = replace(observed, observations=exchanged_sides(body, observations, points, again, sigma_px))
    track = track_take(fitting, again, None, loss, sigma_px, SCHEDULE[-1:])
    return FirstTrack(start, before, track, trust(body, observations, points, track.poses, sigma_px))


def find_start(
    body: ChainBody, observations: Rays | JointPositions, points: BodyPoints | None, sigma_px: float = SIGMA_PX
) -> Poses:
    """Return initial poses of a track: the chain fitted to points, interpolated where they are not reliable.

    A triangulated point is only used if more than half of the cameras that see it agree on it, unless its keypoint has
    no such point in any frame. If two of four cameras confuse left and right, each pair of cameras is consistent, and
    the choice between them would change from frame to frame.

    Parameters
    ----------
    body : ChainBody
        A body with the nodes of the shipped chain.
    observations : Rays or JointPositions
        The observations of T frames.
    points : BodyPoints or None
        The points that rays observe; None for joint positions.
    sigma_px : float, optional
        Standard deviation of a keypoint in pixels.

    Raises
    ------
    ParameterError
        The points do not match the observations, or a hip or a shoulder is never seen.
    """
    if isinstance(observations, JointPositions):
        start = start_from_positions(body, observations)
    elif points is None:
        raise ParameterError("points", "the points that the rays observe", None)
    else:
        positions, cameras = triangulate(observations)
        given = (observations.confidence >= MIN_CONFIDENCE).sum(axis=1)
        agreed = 2 * cameras > given
        agreed |= ~agreed.any(axis=0)  # a keypoint without a majority in any frame keeps all of its points
        positions[~agreed] = np.nan
        start = start_from_triangulation(body, positions, points)
    return restart(body, start, trust(body, observations, points, start, sigma_px).nodes_seen)
