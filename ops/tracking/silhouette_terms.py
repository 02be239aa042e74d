"""This module turns silhouettes into terms for the tracker of whole takes.

The correspondences of a frame pull every joint by A and b of Eq. 6.4. The quadratic form of one joint is a sum of three
squares along the eigenvectors of A, which are place terms, so the tracker of takes needs no other kind of term.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.ops.body.capsules import rest_joints
from kinedex.ops.body.kinematic_chain import ChainBody, Poses, forward
from kinedex.ops.errors import ParameterError
from kinedex.ops.tracking.contour_sums import add_contours, contour_sums
from kinedex.ops.tracking.contours import Silhouettes, contour_room, find_contours
from kinedex.ops.tracking.observations import BodyPoints, Places, Rays
from kinedex.ops.tracking.prior_terms import PriorTerms, no_priors
from kinedex.ops.tracking.rays import SIGMA_PX
from kinedex.ops.tracking.take_tracker import SCHEDULE, Loss, TakeTrack, track_take

PASSES = 6
"""Number of times that correspondences with silhouettes are computed for a take."""

_LEAST = 1e-6  # relative eigenvalue below which a joint is not pulled along an eigenvector


def silhouette_terms(body: ChainBody, poses: Poses, silhouettes: Silhouettes) -> tuple[PriorTerms, F64]:
    """Return the place terms of the correspondences of poses with silhouettes.

    Parameters
    ----------
    body : ChainBody
        The body.
    poses : Poses
        T poses, at which the correspondences are found.
    silhouettes : Silhouettes
        Masks of T frames.

    Returns
    -------
    terms : PriorTerms
        At most three place terms for each joint and frame, and no others.
    shifts_px : float64 array (T,)
        Mean distance of the contour from the silhouettes' boundary in pixels of the cameras, NaN without any.
    """
    positions = np.ascontiguousarray(np.moveaxis(forward(body, poses)[0], 2, 0))
    frames, joints = positions.shape[:2]
    capsules = silhouettes.capsules
    room, shifts = contour_room(capsules, rest_joints(body)), np.full(frames, np.nan)
    matrices, vectors = np.zeros((frames, joints, 3, 3)), np.zeros((frames, joints, 3))
    for t in range(frames):
        sums, found = contour_sums(capsules, joints), []
        for view, mask in silhouettes.seen(t):
            count, _ = find_contours(view, mask, positions[t], capsules, room)
            add_contours(view, room, count, capsules, sums)
            found.append(np.abs(room.shifts[:count]))
        if sum(map(len, found)):
            shifts[t] = np.concatenate(found).mean()
        matrices[t], vectors[t] = sums.matrices, sums.vectors
        # each end of a capsule moves its points alone: an upper bound of the squares without terms of two joints
        np.add.at(matrices[t], capsules.starts, sums.mixed)
        np.add.at(matrices[t], capsules.ends, sums.mixed)
    return _place_terms(body, positions, matrices, vectors), shifts


def _place_terms(body: ChainBody, positions: F64, matrices: F64, vectors: F64) -> PriorTerms:
    """Return the place terms of quadratics moveᵀ A move + 2 bᵀ move of the joints (T, J, 3)."""
    values, axes = np.linalg.eigh(matrices)
    used = values > _LEAST * values[..., -1:].clip(min=1e-12)
    frames, joints, columns = np.nonzero(used)
    weights = values[used]
    directions = axes[frames, joints, :, columns]
    at, pulls = positions[frames, joints], vectors[frames, joints]
    targets = (directions * at).sum(axis=1) - (directions * pulls).sum(axis=1) / weights
    return replace(
        no_priors(len(positions), len(body.chain.nodes)),
        place_frames=frames,
        place_joints=joints,
        place_directions=directions,
        place_targets=targets,
        place_weights=weights,
    )


def with_places(terms: PriorTerms, others: PriorTerms) -> PriorTerms:
    """Return terms with the place terms of others added, sorted by frame."""
    frames = np.concatenate([terms.place_frames, others.place_frames])
    order = np.argsort(frames, kind="stable")
    return replace(
        terms,
        place_frames=frames[order],
        place_joints=np.concatenate([terms.place_joints, others.place_joints])[order],
        place_directions=np.concatenate([terms.place_directions, others.place_directions])[order],
        place_targets=np.concatenate([terms.place_targets, others.place_targets])[order],
        place_weights=np.concatenate([terms.place_weights, others.place_weights])[order],
    )


def track_take_on_silhouettes(
    body: ChainBody,
    observations: Rays | Places | None,
    points: BodyPoints | None,
    rate_hz: float,
    start: Poses,
    silhouettes: Silhouettes,
    priors: PriorTerms | None = None,
    loss: Loss = "geman_mcclure",
    sigma_px: float = SIGMA_PX,
    cuts: Sequence[int] = (),
    passes: int = PASSES,
) -> TakeTrack:
    """Track all frames of a take at once on silhouettes, with rays or places if there are any.

    Parameters
    ----------
    body, observations, points, rate_hz, priors, loss, sigma_px, cuts
        Those of `kinedex.ops.tracking.take_tracker.track_take`; observations and points are None for silhouettes alone.
    start : Poses
        Initial poses from a track on rays or places, or from the frame tracker; contours only find a boundary within
        reach.
    silhouettes : Silhouettes
        Masks of T frames.
    passes : int, optional
        Number of times, 1 or more, that correspondences are computed and the take is solved.

    Returns
    -------
    TakeTrack
        The track. With silhouettes alone its costs are the mean distances of the contour from the boundary in pixels.

    Raises
    ------
    ParameterError
        A number of frames differs, or `passes` is below 1.
    """
    if passes < 1:
        raise ParameterError("passes", "1 or more", passes)
    frames, joints = len(start.places), len(body.chain.joints)
    if len(silhouettes.masks) != frames:
        raise ParameterError("masks", f"those of {frames} frames", len(silhouettes.masks))
    seen = (
        Places(np.full((frames, joints, 3), np.nan), np.ones((frames, joints)))
        if observations is None
        else observations
    )
    others = priors or no_priors(frames, len(body.chain.nodes))
    poses = start
    for _ in range(passes):
        pulls = with_places(others, silhouette_terms(body, poses, silhouettes)[0])
        track = track_take(
            body, seen, points, rate_hz, poses, pulls, loss, sigma_px, SCHEDULE[-1:], cuts
        )  # fmt: skip
        poses = track.poses
    if observations is None:
        track = replace(track, costs=np.nan_to_num(silhouette_terms(body, poses, silhouettes)[1]))
    return track
