"""This module tracks whole takes: all frames at once, as an iterated smoother (Levenberg's method on a band).

The terms of each frame (see `blocks`) are combined with second differences of the root's position and of all nodes'
rotations. The robust loss starts wide and becomes narrower, so that points far from their rays are not rejected at
once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.ops.body.kinematic_chain import PLACES, ChainBody, Poses, forward
from kinedex.ops.errors import ParameterError
from kinedex.ops.tracking.band import assemble, make_band, move, solve_band, take_cost
from kinedex.ops.tracking.blocks import PriorArrays, observation_costs, prior_arrays
from kinedex.ops.tracking.observations import BodyPoints, Places, Rays
from kinedex.ops.tracking.prior_terms import PriorTerms
from kinedex.ops.tracking.rays import SIGMA_PX, Evidence, make_evidence

Loss = Literal["geman_mcclure", "squares"]

SCHEDULE = (12.0, 6.0, 3.0)
"""The widths c of the robust loss, one per solve."""

TURN_RAD_S2 = 60.0
"""Standard deviation of the angular acceleration of a node about one axis, in rad/s²."""

PLACE_M_S2 = 8.0
"""Standard deviation of the acceleration of the root, in m/s²."""

WINDOW_FRAMES, OVERLAP_FRAMES = 2000, 60
"""Number of frames that are solved at once, and overlap of two such windows in frames."""

MOST_TRIES, TOLERANCE = 12, 1e-4
"""Maximum number of tries for each c, and the relative decrease of the cost below which a solve has converged."""

# the initial damping, and its factors after an accepted and a rejected step
_DAMPING, _EASED, _RAISED = 1e-3, 0.2, 10.0


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
        Cost of the observations of each frame, Σ conf² ρ at the last c.
    steps : int
        The number of steps of Levenberg's method, rejected ones included, in the window with the most.
    """

    poses: Poses
    positions: F64
    costs: F64
    steps: int


def track_take(
    body: ChainBody,
    observations: Rays | Places,
    points: BodyPoints | None,
    rate_hz: float,
    start: Poses,
    priors: PriorTerms | None = None,
    loss: Loss = "geman_mcclure",
    sigma_px: float = SIGMA_PX,
    schedule: Sequence[float] = SCHEDULE,
    cuts: Sequence[int] = (),
) -> TakeTrack:
    """Track all frames of a take at once.

    Parameters
    ----------
    body : ChainBody
        The body.
    observations : Rays or Places
        The observations of T frames.
    points : BodyPoints or None
        The points that rays observe; None for places.
    rate_hz : float
        Frames per second.
    start : Poses
        T poses to start from, see `first_track.find_start`.
    priors : PriorTerms, optional
        Pulls of priors.
    loss : str, optional
        `geman_mcclure`, or `squares`, which the thesis has.
    sigma_px : float, optional
        Standard deviation of a keypoint in pixels.
    schedule : sequence of float, optional
        The values of c, one per solve; not used for squares.
    cuts : sequence of int, optional
        Frames after a cut, which no term couples with the frame before.

    Raises
    ------
    ParameterError
        The arguments do not fit each other.
    """
    if loss not in ("geman_mcclure", "squares"):
        raise ParameterError("loss", "geman_mcclure or squares", loss)
    widths = (np.inf,) if loss == "squares" else tuple(schedule)
    if not widths or not all(width > 0 for width in widths):
        raise ParameterError("schedule", "positive numbers", list(schedule))
    evidence = make_evidence(body, observations, points, sigma_px)
    frames = len(evidence.confidence)
    if frames == 0 or start.turns.shape[0] != frames:
        raise ParameterError("start", f"a pose for each of the {frames} frames, at least one", start.turns.shape[0])
    pulls = prior_arrays(body, priors, frames)
    smoothness, triples = smoothness_weights(body, rate_hz), connected_triples(frames, cuts)
    places, turns = np.array(start.places, np.float64), np.array(start.turns, np.float64)
    steps = 0
    found_places, found_turns = np.empty_like(places), np.empty_like(turns)
    for first, stop, low, high in windows(frames):
        system = _System(body, _evidence_of(evidence, first, stop), _priors_of(pulls, first, stop))
        poses = Poses(places[first:stop].copy(), turns[first:stop].copy())
        solved, tries = _solve(system, smoothness, triples[first:stop], poses, widths)
        found_places[low:high] = solved.places[low - first : high - first]
        found_turns[low:high] = solved.turns[low - first : high - first]
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
    """Return 1 for every frame that is consecutive with the one before and the one after, else 0.

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


@dataclass(frozen=True, eq=False)
class _System:
    body: ChainBody
    evidence: Evidence
    priors: PriorArrays


def _evidence_of(evidence: Evidence, first: int, stop: int) -> Evidence:
    return evidence._replace(
        directions=evidence.directions[first:stop],
        confidence=evidence.confidence[first:stop],
        places=evidence.places[first:stop],
        precisions=evidence.precisions[first:stop],
    )


def _priors_of(priors: PriorArrays, first: int, stop: int) -> PriorArrays:
    return priors._replace(
        turn_targets=priors.turn_targets[first:stop],
        turn_weights=priors.turn_weights[first:stop],
        tilt_targets=priors.tilt_targets[first:stop],
        tilt_weights=priors.tilt_weights[first:stop],
        place_starts=priors.place_starts[first : stop + 1],
    )


def _solve(
    system: _System,
    smoothness: F64,
    triples: F64,
    poses: Poses,
    widths: Sequence[float],
    tolerance: float = TOLERANCE,
    most: int = MOST_TRIES,
) -> tuple[Poses, int]:
    """Solve one window, and return its poses and the number of steps tried.

    With the identity as the derivative of logarithms, g is consistent with H, and steps succeed even if the start jumps
    between frames, where most steps with the exact g would be rejected. The exact g is used at the end.
    """
    chain, evidence, priors = system.body.arrays, system.evidence, system.priors
    joints = np.unique(priors.place_joints[priors.place_starts[0] : priors.place_starts[-1]])
    moving = np.unique(np.concatenate([evidence.nodes, chain.joint_nodes[joints]]))
    band = make_band(chain, moving, smoothness, triples)
    units = np.zeros(evidence.confidence.shape)
    factors = np.empty((len(triples), len(band.coupled), 2 * len(band.coupled) + 1))
    steps = np.empty_like(band.gradient)
    trial = Poses(np.empty_like(poses.places), np.empty_like(poses.turns))
    count = 0
    for width, exact in [*((width, False) for width in widths), (widths[-1], True)]:
        damping, fresh, cost = _DAMPING, True, 0.0
        for _ in range(most):
            count += 1
            if fresh:
                cost = assemble(chain, evidence, priors, *poses, width, units, exact, band)
            solve_band(band, damping, factors, steps)
            move(chain, *poses, steps, *trial)
            new = take_cost(chain, evidence, priors, *trial, width, units, band)
            fresh = new < cost
            if not fresh:
                damping *= _RAISED
                continue
            poses, trial = trial, poses
            damping *= _EASED
            if cost - new < tolerance * cost:
                break
    return poses, count
