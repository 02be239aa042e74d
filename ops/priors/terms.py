"""This module turns allocations into terms that a tracker adds to its energy (thesis, Sections 6.4.2 and 6.4.3)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kinedex.ops.arrays import F64, I64, Bool
from kinedex.ops.body.kinematic_chain import ChainBody, Poses
from kinedex.ops.priors.allocation import ARCHIVE, POSE, Allocation
from kinedex.ops.priors.archive_poses import Motion, own_way
from kinedex.ops.priors.constraints import (
    BENT_RAD,
    Constraint,
    PlacePulls,
    Side,
    front_pulls,
    ground_pulls,
    joined,
    straight_elbow,
)
from kinedex.ops.tracking.observations import PriorTerms, no_priors

POSE_RAD = 0.15
"""Standard deviation in radians of a rotation about its prior, in addition to the spread of the archive."""

SEEN_SHARE = 0.3
"""Factor of the archive's weight for nodes whose keypoints are consistent between cameras."""

SPREAD_S = 1 / 3
"""Time in seconds of a seen node whose residuals have the same weight as the spread of the archive."""


@dataclass(frozen=True, eq=False)
class TrackState:
    """A track in the form in which priors are allocated to it.

    Attributes
    ----------
    body : ChainBody
        The body.
    poses : Poses
        Its poses.
    positions : float64 array (J, 3, T)
        Its joints in metres, Y up.
    nodes_seen : bool array (T, K)
        The nodes whose keypoints are consistent between cameras.
    rate_hz : float
        Frames per second.
    """

    body: ChainBody
    poses: Poses
    positions: F64
    nodes_seen: Bool
    rate_hz: float


def make_terms(
    state: TrackState, allocation: Allocation, motions: Sequence[Motion], weights: Mapping[str, float]
) -> PriorTerms:
    """Return the terms of an allocation; all of them are constant during the round.

    Parameters
    ----------
    state : TrackState
        The track before the round.
    allocation : Allocation
        The hits of its frames.
    motions : sequence of Motion
        The motions of the archive.
    weights : mapping of str to float
        The factor of each kind of priors that is used: "archive", "pose" and constraints.

    Returns
    -------
    PriorTerms
    """
    terms = no_priors(len(allocation.owners), len(state.body.chain.nodes))
    borrowed = allocation.lenders >= 0
    for place, hit in enumerate(allocation.hits):
        table, frames = motions[hit.motion].poses, allocation.frames(place)
        if ARCHIVE in weights and table is not None and len(frames):
            borrowed[frames] = False
            _add_archive(terms, state, allocation, motions, place, weights[ARCHIVE])
    if POSE in weights:
        _add_lent(terms, state, allocation, np.flatnonzero(borrowed), weights[POSE])
    return _with_constraints(terms, state, allocation, motions, weights)


def _add_archive(
    terms: PriorTerms, state: TrackState, allocation: Allocation, motions: Sequence[Motion], place: int, weight: float
) -> None:
    """Add the archive's rotations, corrected by the actor's own deviation, and tilts to the frames of a hit."""
    table = motions[allocation.hits[place].motion].poses
    assert table is not None
    frames = allocation.frames(place)
    columns = allocation.columns[frames]
    means, quality = table.means[columns], weight * allocation.qualities[place]
    way = own_way(means, state.poses.turns[frames], state.nodes_seen[frames], state.rate_hz)
    terms.turn_targets[frames, 1:] = (means @ way.turns)[:, 1:]
    variance = actual_variance(table.spreads[columns], way.residuals, way.seen_s)
    need = np.where(state.nodes_seen[frames], SEEN_SHARE, 1.0)[:, :, None]
    terms.turn_weights[frames, 1:] = (need * quality / (variance + POSE_RAD**2))[:, 1:]
    terms.tilt_targets[frames] = table.tilts[columns]
    terms.tilt_weights[frames] = quality / POSE_RAD**2


def actual_variance(spreads: F64, residuals: F64, seen_s: F64) -> F64:
    """Return the variance of rotations about the archive's rotations, from its spread and the hit's residuals.

    Where the cameras are consistent for a node, they show how well the hit fits it: the variances of the archive and of
    the residuals are averaged, with the weights `SPREAD_S` and the time for which the node is seen. So hits of a wrong
    class pull less, and so do limbs that people move in different ways.

    Parameters
    ----------
    spreads : float64 array (E, K, 3)
        The spread in the archive in each frame, in radians.
    residuals : float64 array (K, 3)
        Root mean square of the residuals, in radians; NaN where a node is hardly seen.
    seen_s : float64 array (K,)
        The time for which each node is seen, in seconds.
    """
    share = np.where(np.isnan(residuals), 0.0, (seen_s / (SPREAD_S + seen_s))[:, None])
    variance: F64 = (1.0 - share) * spreads**2 + share * np.nan_to_num(residuals) ** 2
    return variance


def _add_lent(terms: PriorTerms, state: TrackState, allocation: Allocation, frames: I64, weight: float) -> None:
    """Add as priors the rotations and tilts of the frames whose poses are borrowed."""
    lent = state.poses.turns[allocation.lenders[frames]]
    quality = weight * allocation.qualities[allocation.owners[frames]] / POSE_RAD**2
    terms.turn_targets[frames, 1:] = lent[:, 1:]
    terms.turn_weights[frames, 1:] = quality[:, None, None]
    terms.tilt_targets[frames] = lent[:, 0, 1, :]
    terms.tilt_weights[frames] = quality


def _with_constraints(
    terms: PriorTerms,
    state: TrackState,
    allocation: Allocation,
    motions: Sequence[Motion],
    weights: Mapping[str, float],
) -> PriorTerms:
    """Add the terms of the marked regions that the track passes through, and return all terms."""
    # index −1, of frames without a hit, selects the appended 0
    quality = np.append(allocation.qualities, 0.0)[allocation.owners]
    pulls: list[PlacePulls] = []
    regions: dict[tuple[Constraint, Side], Bool] = {}
    for place, hit in enumerate(allocation.hits):
        own = allocation.owners == place
        for mark in motions[hit.motion].marks:
            inside = own & (allocation.columns >= mark.start) & (allocation.columns < mark.stop)
            key = (mark.constraint, mark.side)
            regions[key] = regions.get(key, np.zeros_like(own)) | inside
    for (constraint, side), marked in sorted(regions.items()):
        if constraint not in weights or not marked.any():
            continue
        if constraint == "elbow_bent":
            node, straight, target = straight_elbow(state.body, state.poses, marked, side)
            straight &= ~terms.turn_weights[:, node].any(axis=1)
            terms.turn_targets[straight, node] = target
            axis = state.body.chain.axes_of(node)[0].direction
            terms.turn_weights[straight, node, axis] = weights[constraint] * quality[straight] / BENT_RAD**2
            continue
        if constraint == "foot_on_ground":
            found = ground_pulls(state.body, state.positions, marked, side)
        else:
            found = front_pulls(state.body, state.poses, state.positions, marked, constraint, side, state.rate_hz)
        pulls.append(found._replace(weights=found.weights * weights[constraint] * quality[found.frames]))
    places = joined(pulls)
    return PriorTerms(
        terms.turn_targets, terms.turn_weights, terms.tilt_targets, terms.tilt_weights, places.frames, places.joints,
        places.directions, places.targets, places.weights,
    )  # fmt: skip
