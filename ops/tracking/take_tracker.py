"""This module tracks all frames of a take at once, as an iterated smoother (Levenberg's method on a band matrix).

The cost consists of the terms of each frame (see `blocks`) and of second differences of the root's position and of the
rotations of all nodes. The robust loss starts wide and becomes narrower in later solves, so that points far from their
rays are not rejected at once.

Silhouettes are converted to terms of the same form as those of priors. The correspondences of a frame give a quadratic
form with A and b of Eq. 6.4 for every joint. This is a sum of three squares along the eigenvectors of A, each of which
is a position term, so that the tracker needs no other kind of term.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.ops.body.capsules import rest_joints
from kinedex.ops.body.kinematic_chain import PLACES, ChainBody, Poses, forward
from kinedex.ops.errors import ParameterError
from kinedex.ops.tracking.band import assemble, make_band, move, solve_band, take_cost
from kinedex.ops.tracking.blocks import TrackProblem, observation_costs, prior_arrays
from kinedex.ops.tracking.contours import (
    Observed,
    Silhouettes,
    add_contours,
    contour_buffers,
    contour_sums,
    find_contours,
)
from kinedex.ops.tracking.observations import JointPositions, PriorTerms, no_priors
from kinedex.ops.tracking.rays import SIGMA_PX, make_evidence

Loss = Literal["geman_mcclure", "squares"]

SCHEDULE = (12.0, 6.0, 3.0)
"""The widths c of the robust loss, one for each of the successive solves."""

TURN_RAD_S2 = 60.0
"""Standard deviation of the angular acceleration of a node about one axis, in rad/s²."""

PLACE_M_S2 = 8.0
"""Standard deviation of the acceleration of the root, in m/s²."""

WINDOW_FRAMES, OVERLAP_FRAMES = 2000, 60
"""Number of frames of a window, which are solved at once, and number of frames by which two windows overlap."""

MAX_TRIES, TOLERANCE = 12, 1e-4
"""Maximum number of tries for each c, and the relative decrease of the cost below which a solve has converged."""

# the initial damping, and its factors after an accepted and a rejected step
_DAMPING, _EASED, _RAISED = 1e-3, 0.2, 10.0

PASSES = 6
"""Number of times that correspondences with silhouettes are computed for a take."""

_MIN_EIGENVALUE = 1e-6  # relative eigenvalue below which a joint is not pulled along an eigenvector


@dataclass(frozen=True, eq=False)
class TakeTrack:
    """The result of tracking a take.

    Attributes
    ----------
    poses : Poses
        T poses.
    positions : float64 array (T, J, 3)
        The joints in metres.
    costs : float64 array (T,)
        Cost of the observations of each frame, Σ conf² ρ with the last width c.
    steps : int
        The number of steps of Levenberg's method, rejected ones included, in the window with the most.
    """

    poses: Poses
    positions: F64
    costs: F64
    steps: int


def track_take(
    observed: Observed,
    start: Poses,
    priors: PriorTerms | None = None,
    loss: Loss = "geman_mcclure",
    sigma_px: float = SIGMA_PX,
    schedule: Sequence[float] = SCHEDULE,
) -> TakeTrack:
    """Track all frames of a take at once.

    Parameters
    ----------
    observed : Observed
        The body, and rays or joint positions of T frames; silhouettes are not used.
    start : Poses
        T initial poses, see `first_track.find_start`.
    priors : PriorTerms, optional
        The terms of priors.
    loss : str, optional
        `geman_mcclure`, or `squares` as in the thesis.
    sigma_px : float, optional
        Standard deviation of a keypoint in pixels.
    schedule : sequence of float, optional
        The widths c of the loss, one for each solve; not used for squares.

    Raises
    ------
    ParameterError
        The arguments do not match each other.
    """
    if loss not in ("geman_mcclure", "squares"):
        raise ParameterError("loss", "geman_mcclure or squares", loss)
    widths = (np.inf,) if loss == "squares" else tuple(schedule)
    if not widths or not all(width > 0 for width in widths):
        raise ParameterError("schedule", "positive numbers", list(schedule))
    if observed.observations is None:
        raise ParameterError("observations", "rays or places", None)
    body = observed.body
    evidence = make_evidence(body, observed.observations, observed.points, sigma_px)
    frames = len(evidence.confidence)
    if frames == 0 or start.rotations.shape[0] != frames:
        raise ParameterError("start", f"a pose for each of the {frames} frames, at least one", start.rotations.shape[0])
    problem = TrackProblem(body.arrays, evidence, prior_arrays(body, priors, frames))
    smoothness = smoothness_weights(body, observed.rate_hz)
    triples = connected_triples(frames, observed.cuts)
    places, rotations = np.array(start.positions, np.float64), np.array(start.rotations, np.float64)
    steps = 0
    found_places, found_turns = np.empty_like(places), np.empty_like(rotations)
    for first, stop, low, high in windows(frames):
        poses = Poses(places[first:stop].copy(), rotations[first:stop].copy())
        solved, tries = _solve(problem.window(first, stop), smoothness, triples[first:stop], poses, widths)
        found_places[low:high] = solved.positions[low - first : high - first]
        found_turns[low:high] = solved.rotations[low - first : high - first]
        steps = max(steps, tries)
    poses = Poses(found_places, found_turns)
    positions, _ = forward(body, poses)
    costs = observation_costs(body, evidence, poses, widths[-1])
    return TakeTrack(poses, np.ascontiguousarray(np.moveaxis(positions, 2, 0)), costs, steps)


def smoothness_weights(body: ChainBody, rate_hz: float) -> F64:
    """Return the weights 1/σ² of the second differences of all parameters.

    Raises
    ------
    ParameterError
        The rate is not positive.
    """
    if not (np.isfinite(rate_hz) and rate_hz > 0):
        raise ParameterError("rate_hz", "positive and finite", rate_hz)
    weights = np.full(body.chain.parameters, (TURN_RAD_S2 / rate_hz**2) ** -2.0)
    weights[:PLACES] = (PLACE_M_S2 / rate_hz**2) ** -2.0
    return weights


def connected_triples(frames: int, cuts: Sequence[int]) -> F64:
    """Return 1 for every frame that has a previous and a next frame without a cut in between, else 0.

    Raises
    ------
    ParameterError
        A cut is not a frame number.
    """
    if not all(0 <= cut < frames for cut in cuts):
        raise ParameterError("cuts", f"frames from 0 to {frames - 1}", list(cuts))
    triples = np.ones(frames)
    triples[[0, -1]] = 0.0
    for cut in cuts:
        triples[[max(cut - 1, 0), cut]] = 0.0
    return triples


def windows(frames: int) -> list[tuple[int, int, int, int]]:
    """Return the windows of a take: the range of frames to solve, and the range of frames to keep, as four numbers."""
    found: list[tuple[int, int, int, int]] = []
    first = 0
    while True:
        stop = min(first + WINDOW_FRAMES, frames)
        low = first + OVERLAP_FRAMES // 2 if first else 0
        if stop == frames:
            return [*found, (first, stop, low, stop)]
        found.append((first, stop, low, stop - OVERLAP_FRAMES // 2))
        first = stop - OVERLAP_FRAMES


def _solve(
    problem: TrackProblem,
    smoothness: F64,
    triples: F64,
    poses: Poses,
    widths: Sequence[float],
    tolerance: float = TOLERANCE,
    most: int = MAX_TRIES,
) -> tuple[Poses, int]:
    """Solve one window, and return its poses and the number of steps tried.

    First, g uses the identity as the derivative of logarithms, like H. Steps then succeed even if the initial poses
    jump between frames, whereas most steps with the exact g would be rejected. The exact g is used at the end.
    """
    chain, evidence, priors = problem
    joints = np.unique(priors.place_joints[priors.place_starts[0] : priors.place_starts[-1]])
    moving = np.unique(np.concatenate([evidence.nodes, chain.joint_nodes[joints]]))
    band = make_band(chain, moving, smoothness, triples)
    units = np.zeros(evidence.confidence.shape)
    factors = np.empty((len(triples), len(band.coupled), 2 * len(band.coupled) + 1))
    steps = np.empty_like(band.gradient)
    trial = Poses(np.empty_like(poses.positions), np.empty_like(poses.rotations))
    count = 0
    for width, exact in [*((width, False) for width in widths), (widths[-1], True)]:
        damping, fresh, cost = _DAMPING, True, 0.0
        for _ in range(most):
            count += 1
            if fresh:
                cost = assemble(problem, *poses, width, units, exact, band)
            solve_band(band, damping, factors, steps)
            move(chain, *poses, steps, *trial)
            new = take_cost(problem, *trial, width, units, band)
            fresh = new < cost
            if not fresh:
                damping *= _RAISED
                continue
            poses, trial = trial, poses
            damping *= _EASED
            if cost - new < tolerance * cost:
                break
    return poses, count


def silhouette_terms(body: ChainBody, poses: Poses, silhouettes: Silhouettes) -> tuple[PriorTerms, F64]:
    """Return the correspondences of poses with silhouettes as position terms.

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
        At most three position terms for each joint and frame, and no other terms.
    shifts_px : float64 array (T,)
        Mean distance of the contour from the silhouettes' boundary in pixels of the cameras; NaN without
        correspondences.
    """
    positions = np.ascontiguousarray(np.moveaxis(forward(body, poses)[0], 2, 0))
    frames, joints = positions.shape[:2]
    capsules = silhouettes.capsules
    buffers, shifts = contour_buffers(capsules, rest_joints(body)), np.full(frames, np.nan)
    matrices, vectors = np.zeros((frames, joints, 3, 3)), np.zeros((frames, joints, 3))
    for t in range(frames):
        sums, found = contour_sums(capsules, joints), []
        for view, mask in silhouettes.seen(t):
            count, _ = find_contours(view, mask, positions[t], capsules, buffers)
            add_contours(view, buffers, count, sums)
            found.append(np.abs(buffers.shifts[:count]))
        if sum(map(len, found)):
            shifts[t] = np.concatenate(found).mean()
        matrices[t], vectors[t] = sums.matrices, sums.vectors
        # each end of a capsule moves its points alone: an upper bound of the squares without terms of two joints
        np.add.at(matrices[t], capsules.starts, sums.mixed)
        np.add.at(matrices[t], capsules.ends, sums.mixed)
    return _position_terms(body, positions, matrices, vectors), shifts


def _position_terms(body: ChainBody, positions: F64, matrices: F64, vectors: F64) -> PriorTerms:
    """Return the position terms of quadratic forms xᵀ A x + 2 bᵀ x in the displacements x of joints (T, J, 3)."""
    values, axes = np.linalg.eigh(matrices)
    used = values > _MIN_EIGENVALUE * values[..., -1:].clip(min=1e-12)
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


def with_position_terms(terms: PriorTerms, others: PriorTerms) -> PriorTerms:
    """Add the position terms of `others` to terms, sorted by frame."""
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
    observed: Observed,
    start: Poses,
    priors: PriorTerms | None = None,
    loss: Loss = "geman_mcclure",
    sigma_px: float = SIGMA_PX,
    passes: int = PASSES,
) -> TakeTrack:
    """Track all frames of a take at once on silhouettes, together with rays or joint positions if there are any.

    Parameters
    ----------
    observed : Observed
        The body, masks of T frames, and optionally rays or joint positions.
    priors, loss, sigma_px
        See `track_take`.
    start : Poses
        Initial poses from a track on rays or joint positions, or from the frame tracker. They must be good, because a
        boundary is only searched near the contour.
    passes : int, optional
        The number of times, at least 1, that correspondences are computed and the take is solved.

    Returns
    -------
    TakeTrack
        The track. With silhouettes alone its costs are the mean distances of the contour from the boundary in pixels, 0
        in frames without correspondences.

    Raises
    ------
    ParameterError
        There are no silhouettes, numbers of frames differ, or `passes` is below 1.
    """
    if passes < 1:
        raise ParameterError("passes", "1 or more", passes)
    body, silhouettes = observed.body, observed.silhouettes
    if silhouettes is None:
        raise ParameterError("silhouettes", "masks in calibrated cameras", None)
    frames, joints = len(start.positions), len(body.chain.joints)
    if len(silhouettes.masks) != frames:
        raise ParameterError("masks", f"those of {frames} frames", len(silhouettes.masks))
    seen = observed
    if observed.observations is None:
        seen = replace(
            observed, observations=JointPositions(np.full((frames, joints, 3), np.nan), np.ones((frames, joints)))
        )
    others = priors or no_priors(frames, len(body.chain.nodes))
    poses = start
    for _ in range(passes):
        pulls = with_position_terms(others, silhouette_terms(body, poses, silhouettes)[0])
        track = track_take(seen, poses, pulls, loss, sigma_px, SCHEDULE[-1:])
        poses = track.poses
    if observed.observations is None:
        track = replace(track, costs=np.nan_to_num(silhouette_terms(body, poses, silhouettes)[1]))
    return track
