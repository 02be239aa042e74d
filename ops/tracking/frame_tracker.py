"""This module tracks a body frame by frame, on rays, silhouettes, or joint positions (thesis, Section 6.2).

In every frame, the squares of Eq. 6.4 are minimised by the Gauss–Newton method, starting from the previous pose; no
term couples frames. On silhouettes, the start is the previous pose, extrapolated by the last velocity, and the
correspondences with the silhouettes are computed several times.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64, I64, U8, Bool
from kinedex.ops.body.capsules import Capsules, rest_joints
from kinedex.ops.body.kinematic_chain import (
    PLACES,
    Poses,
    forward,
    pose_joints,
    pose_nodes,
    rotation_of,
    take_step,
    vector_of,
)
from kinedex.ops.body.pose_fit import solve_step
from kinedex.ops.copies import copy_row, copy_table
from kinedex.ops.errors import ParameterError
from kinedex.ops.tracking.blocks import (
    FrameBuffers,
    PriorArrays,
    TrackProblem,
    frame_buffers,
    frame_cost,
    frame_terms,
    place_points,
    prior_arrays,
)
from kinedex.ops.tracking.contours import (
    HALF,
    ContourSums,
    Observed,
    add_contours,
    add_sums,
    contour_buffers,
    contour_sums,
    find_contours,
    sums_cost,
)
from kinedex.ops.tracking.observations import JointPositions, PriorTerms, Rays
from kinedex.ops.tracking.rays import SIGMA_PX, make_evidence, point_cost
from kinedex.ops.tracking.triangulation import start_from_positions, start_from_triangulation, triangulate
from kinedex.ops.tracking.views import View, count_overlap

STEPS = 10
"""Maximum number of steps in a frame without silhouettes, rejected ones included."""

PASSES, PASS_STEPS = 8, 2
"""Number of times that correspondences with silhouettes are computed in a frame, and number of steps each time."""

START_RAD = 0.12
"""Standard deviation in radians, on silhouettes, of the rotation of a node without priors from its start in a frame.
"""

MIN_CONTOURS = 30
"""Minimum number of correspondences with silhouettes; with fewer a frame is lost."""

MIN_FOUND = 0.5
"""Minimum fraction of the visible contour that must find a boundary; below it a frame is lost."""

MIN_RAYS, MIN_PLACES = 12, 4
"""Minimum numbers of rays and of joint positions without silhouettes; with fewer a frame is lost."""

FASTEST_M_S = 9.0
"""Speed of the root in m/s above which a frame is lost, which is 0.3 m per frame at 30 Hz."""

WORSE = 1.1
"""Ratio of mask differences with and without priors above which a frame on silhouettes is fitted without priors."""

_CARRIED = 0.7  # share of the last rotations by which the start of a frame on silhouettes is extrapolated
# the initial damping, and its factors after an accepted and a rejected step
_DAMPING, _EASED, _RAISED = 1e-4, 0.2, 10.0
_STIFF = 1e-2  # is added to the diagonal of H, per rad² and m²
_TOLERANCE = 1e-4  # relative decrease of the cost below which a frame has converged


@dataclass(frozen=True, eq=False)
class FrameTrack:
    """The result of tracking frame by frame.

    Attributes
    ----------
    poses : Poses
        T poses.
    positions : float64 array (T, J, 3)
        The joints in metres.
    costs : float64 array (T,)
        The costs that are compared to decide whether priors are kept. With silhouettes alone these are the
        `differences`, with 0 for NaN, otherwise the sums of the squared residuals of the observations.
    lost : bool array (T,)
        True if a frame has too few observations or its pose would jump, so that the previous rotations are kept. The
        position is also kept, unless two masks or more determine it.
    contours : int64 array (T,)
        The number of correspondences with silhouettes.
    shifts_px : float64 array (T,)
        Mean distance of the contour from the silhouettes' boundary in pixels of the cameras; NaN without silhouettes.
    differences : float64 array (T,)
        Number of pixels that are either body or foreground but not both, divided by the number of foreground pixels;
        NaN without silhouettes.
    """

    poses: Poses
    positions: F64
    costs: F64
    lost: Bool
    contours: I64
    shifts_px: F64
    differences: F64


def track_frames(
    observed: Observed, first: Poses | None = None, priors: PriorTerms | None = None, sigma_px: float = SIGMA_PX
) -> FrameTrack:
    """Track a body frame by frame.

    Parameters
    ----------
    observed : Observed
        The body, and rays, joint positions or silhouettes over T frames.
    first : Poses, optional
        A single pose from which the first frame starts; by default it is fitted to the triangulated points, or to the
        joint positions.
    priors : PriorTerms, optional
        Terms of priors for T frames.
    sigma_px : float, optional
        Standard deviation of a keypoint in pixels.

    Returns
    -------
    FrameTrack
        The track.

    Raises
    ------
    ParameterError
        There are no observations, there are only silhouettes but no first pose, numbers of frames differ, or a mask
        does not have its camera's size.
    """
    body, frames = observed.body, _Frames(observed, priors, sigma_px)
    if first is None:
        first = _first_pose(observed)
    if first.positions.shape != (1, 3) or first.rotations.shape != (1, len(body.chain.nodes), 3, 3):
        raise ParameterError("first", f"one pose of {len(body.chain.nodes)} nodes", first.rotations.shape)
    count = frames.count
    poses = Poses(np.empty((count, 3)), np.empty((count, *first.rotations.shape[1:])))
    costs, lost = np.zeros(count), np.zeros(count, np.bool_)
    contours, shifts = np.zeros(count, np.int64), np.full(count, np.nan)
    differences = np.full(count, np.nan)
    place, rotations = first.positions[0].copy(), first.rotations[0].copy()
    state = _State(place, rotations, np.zeros(3), np.zeros((len(rotations), 3)), _Fit(place, rotations))
    for t in range(count):
        state = frames.track(t, state)
        poses.positions[t], poses.rotations[t] = state.place, state.rotations
        fit = state.fit
        costs[t], lost[t], contours[t] = fit.cost, state.frames_lost > 0, fit.contours
        shifts[t], differences[t] = fit.shift_px, fit.difference
    positions, _ = forward(body, poses)
    if observed.observations is None:
        costs = np.nan_to_num(differences)
    return FrameTrack(
        poses, np.ascontiguousarray(positions.transpose(2, 0, 1)), costs, lost, contours, shifts, differences
    )


def _first_pose(observed: Observed) -> Poses:
    """Return the initial pose of the first frame."""
    body, observations, points = observed.body, observed.observations, observed.points
    if observations is None:
        raise ParameterError("first", "a pose, which silhouettes alone do not give", None)
    if isinstance(observations, JointPositions):
        start = start_from_positions(body, observations)
    else:
        assert points is not None  # which `make_evidence` has already checked
        start = start_from_triangulation(body, triangulate(observations)[0], points)
    return Poses(start.positions[:1], start.rotations[:1])


@dataclass(eq=False)
class _Fit:
    """The fitted pose of a frame, with measures of the fit."""

    place: F64
    rotations: F64
    cost: float = 0.0
    contours: int = 0
    share: float = 0.0
    shift_px: float = np.nan
    difference: float = np.nan


@dataclass(frozen=True, eq=False)
class _State:
    """The pose of a frame and its velocity per frame."""

    place: F64
    rotations: F64
    moved: F64  # (3,) metres
    turned: F64  # (K, 3) rotation vectors
    fit: _Fit
    frames_lost: int = 0


class _Frames:
    """The observations, priors and preallocated arrays that all frames of a track share."""

    def __init__(self, observed: Observed, priors: PriorTerms | None, sigma_px: float) -> None:
        body, observations, silhouettes, rate_hz = (
            observed.body, observed.observations, observed.silhouettes, observed.rate_hz
        )  # fmt: skip
        if not (np.isfinite(rate_hz) and rate_hz > 0):
            raise ParameterError("rate_hz", "positive and finite", rate_hz)
        joints = len(body.chain.joints)
        if observations is None:
            if silhouettes is None:
                raise ParameterError("observations", "rays or places, unless there are silhouettes", None)
            frames = len(silhouettes.masks)
            observations = JointPositions(np.full((frames, joints, 3), np.nan), np.ones((frames, joints)))
        counts = observations.confidence if isinstance(observations, Rays) else observations.sigma_m
        self.count = len(counts)
        if silhouettes is not None and len(silhouettes.masks) != self.count:
            raise ParameterError("masks", f"those of {self.count} frames", len(silhouettes.masks))
        self.body, self.silhouettes = body, silhouettes
        self.evidence = make_evidence(body, observations, observed.points, sigma_px)
        arrays = prior_arrays(body, priors, self.count)
        # work arrays for the start of frames on silhouettes
        targets, weights = arrays.turn_targets.copy(), arrays.turn_weights.copy()
        self.priors = arrays._replace(turn_targets=targets, turn_weights=weights)
        self.no_priors = prior_arrays(body, None, self.count)
        self.longest_step_m = FASTEST_M_S / rate_hz
        self.buffers = frame_buffers(body.arrays, self.evidence)
        self.units = np.zeros((len(self.evidence.centres), len(self.evidence.nodes)))
        none = Capsules(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0))
        self.capsules = none if silhouettes is None else silhouettes.capsules
        self.sums = contour_sums(self.capsules, joints)
        if silhouettes is not None:
            # in the rest pose lines between joints are longest, so its contour needs the most points
            self.contours = contour_buffers(self.capsules, rest_joints(body))

    def track(self, t: int, last: _State) -> _State:
        """Return the state of frame t, tracked from the state of the previous frame."""
        if self.silhouettes is None:
            fit, masks = _Fit(last.place.copy(), last.rotations.copy()), []
            fit.cost = self._solve(t, fit.place, fit.rotations, STEPS, self.priors)
        else:
            masks = self.silhouettes.seen(t)
            fit = self._best_fit(t, masks, last)
        step = fit.place - last.place
        seen = (fit.contours >= MIN_CONTOURS and fit.share >= MIN_FOUND) or self._sees(t)
        # the greatest plausible distance since the last frame that was not lost
        longest = self.longest_step_m * (1 + last.frames_lost)
        if not seen or not np.sqrt(step @ step) <= longest:
            still = self._centred(masks, last.place, last.rotations)
            none = np.zeros_like(last.moved), np.zeros_like(last.turned)
            return _State(still, last.rotations, *none, fit, last.frames_lost + 1)
        turned = np.stack([vector_of(turn) for turn in last.rotations.transpose(0, 2, 1) @ fit.rotations])
        if last.frames_lost:
            step, turned = np.zeros_like(step), np.zeros_like(turned)
        return _State(fit.place, fit.rotations, step, turned, fit, 0)

    def _best_fit(self, t: int, masks: list[tuple[View, U8]], last: _State) -> _Fit:
        """Return the fit to silhouettes with priors, or without priors if the masks then fit clearly better."""
        priors = self.priors
        place = last.place + last.moved
        moved = last.rotations @ np.stack([rotation_of(_CARRIED * vector) for vector in last.turned])
        plain = self._fit(t, masks, place, moved, self.no_priors)
        own = (priors.turn_weights[t] > 0.0).any(axis=1)
        if not own.any() and priors.tilt_weights[t] <= 0.0 and priors.place_starts[t] == priors.place_starts[t + 1]:
            return plain
        fits = [self._fit(t, masks, place, moved, priors)]
        lent = (priors.turn_weights[t] > 0.0).all(axis=1)  # a constraint has weight on only one axis, that of an elbow
        if lent.any():
            pulled = np.where(lent[:, None, None], priors.turn_targets[t], moved)
            fits.append(self._fit(t, masks, place, pulled, priors))
        best = min(fits, key=lambda fit: fit.difference)
        return plain if best.difference > WORSE * plain.difference else best

    def _fit(self, t: int, masks: list[tuple[View, U8]], place: F64, rotations: F64, priors: PriorArrays) -> _Fit:
        """Fit the pose of a frame to silhouettes; nodes without a prior are pulled to the initial pose."""
        free = priors.turn_weights[t].max(axis=1) <= 0.0
        targets, weights = priors.turn_targets[t].copy(), priors.turn_weights[t].copy()
        priors.turn_targets[t, free], priors.turn_weights[t, free] = rotations[free], START_RAD**-2.0
        fit = _Fit(place.copy(), rotations.copy())
        for _ in range(PASSES):
            fit.contours, fit.share, fit.shift_px, contour_cost = self._find(masks, fit.place, fit.rotations)
            fit.cost = self._solve(t, fit.place, fit.rotations, PASS_STEPS, priors) + contour_cost
        priors.turn_targets[t], priors.turn_weights[t] = targets, weights
        fit.difference = self._difference(masks, fit.place, fit.rotations)
        return fit

    def _difference(self, masks: list[tuple[View, U8]], place: F64, rotations: F64) -> float:
        """Return the number of pixels that are body or foreground but not both, divided by the foreground's number.

        The result is NaN without foreground.
        """
        pose_nodes(self.body.arrays, place, rotations, self.buffers.turned, self.buffers.centres)
        pose_joints(self.body.arrays, self.buffers.turned, self.buffers.centres, self.sums.joints)
        apart, foreground = 0, 0
        for view, mask in masks:
            own, common = count_overlap(self.capsules, self.sums.joints, view, mask)
            pixels = int(np.count_nonzero(mask > HALF))
            apart, foreground = apart + pixels + own - 2 * common, foreground + pixels
        return apart / foreground if foreground else np.nan

    def _find(self, masks: list[tuple[View, U8]], place: F64, rotations: F64) -> tuple[int, float, float, float]:
        """Find the correspondences of a pose; return their number, share of the contour, mean shift and cost."""
        capsules, sums = self.capsules, self.sums
        pose_nodes(self.body.arrays, place, rotations, self.buffers.turned, self.buffers.centres)
        pose_joints(self.body.arrays, self.buffers.turned, self.buffers.centres, sums.joints)
        sums.matrices[:], sums.vectors[:], sums.mixed[:] = 0.0, 0.0, 0.0
        total, contour, shifts, cost = 0, 0, 0.0, 0.0
        for view, mask in masks:
            count, visible = find_contours(view, mask, sums.joints, capsules, self.contours)
            cost += add_contours(view, self.contours, count, sums)
            total, contour = total + count, contour + visible
            shifts += float(np.abs(self.contours.shifts[:count]).sum())
        return (total, total / contour, shifts / total, cost) if total else (0, 0.0, np.nan, 0.0)

    def _solve(self, t: int, place: F64, rotations: F64, steps: int, priors: PriorArrays) -> float:
        """Minimise the cost of a frame in place; return the sum of the squared residuals of rays and positions."""
        evidence, buffers = self.evidence, self.buffers
        problem = TrackProblem(self.body.arrays, evidence, priors)
        _solve_frame(problem, self.sums, t, place, rotations, steps, self.units, buffers)
        pose_nodes(problem.chain, place, rotations, buffers.turned, buffers.centres)
        place_points(evidence.nodes, evidence.offsets, buffers.turned, buffers.centres, buffers.points)
        return point_cost(evidence, t, buffers.points, np.inf, self.units, True)

    def _sees(self, t: int) -> bool:
        """Return whether a frame has enough rays or joint positions to be tracked without silhouettes."""
        rays = np.count_nonzero(self.evidence.confidence[t] > 0)
        positions = np.isfinite(self.evidence.positions[t]).all(axis=1).sum() if len(self.evidence.positions) else 0
        return bool(rays >= MIN_RAYS or positions >= MIN_PLACES)

    def _centred(self, masks: list[tuple[View, U8]], place: F64, rotations: F64) -> F64:
        """Return the root position for which the middle of the body is where the rays of the masks' centroids meet.

        Return `place` if there are fewer than two masks, or the rays are nearly parallel.
        """
        if len(masks) < 2:
            return place
        capsules = self.capsules
        joints = forward(self.body, Poses(place[None], rotations[None]))[0][:, :, 0]
        one, other = joints[capsules.starts], joints[capsules.ends]
        areas = capsules.radii * np.sqrt(((other - one) ** 2).sum(axis=1))
        middle = (areas[:, None] * 0.5 * (one + other)).sum(axis=0) / areas.sum()
        matrix, vector = np.zeros((3, 3)), np.zeros(3)
        for view, mask in masks:
            rows, columns = np.nonzero(mask >= HALF)
            if not len(rows):
                continue
            x, y = view.plane[round(float(rows.mean())), round(float(columns.mean()))]
            ray = np.array([x, y, 1.0]) @ view.rotation
            square = np.eye(3) - np.outer(ray, ray) / (ray @ ray)
            matrix, vector = matrix + square, vector + square @ view.centre
        found: F64 = place + np.linalg.lstsq(matrix, vector, rcond=None)[0] - middle
        return found if np.isfinite(found).all() and np.linalg.cond(matrix) < 1e3 else place


@njit(cache=True, nogil=True)
def _solve_frame(
    problem: TrackProblem,
    sums: ContourSums,
    t: int,
    place: F64,
    rotations: F64,
    steps: int,
    units: F64,
    buffers: FrameBuffers,
) -> None:
    """Take up to `steps` steps of Levenberg's method from the pose of a frame, in place, until the cost converges."""
    chain = problem.chain
    size = PLACES + len(chain.axis_nodes)
    gradient, step, damped = np.empty(size), np.empty(size), np.empty((size, size))
    new_place, new_turns, joints = np.empty_like(place), np.empty_like(rotations), np.empty_like(sums.joints)
    damping, fresh, cost = _DAMPING, True, 0.0
    for _ in range(steps):
        if fresh:
            cost = frame_terms(problem, t, place, rotations, np.inf, units, buffers, gradient)
            pose_joints(chain, buffers.turned, buffers.centres, joints)
            cost += add_sums(chain, sums, joints, buffers, gradient)
        copy_table(damped, buffers.hessian)
        for i in range(size):
            damped[i, i] += damping * buffers.hessian[i, i] + _STIFF
        solve_step(damped, gradient, step)
        take_step(chain, place, rotations, step, new_place, new_turns)
        new = frame_cost(problem, t, new_place, new_turns, np.inf, units, buffers)
        pose_joints(chain, buffers.turned, buffers.centres, joints)
        new += sums_cost(sums, joints)
        fresh = new < cost
        if not fresh:
            damping *= _RAISED
            continue
        damping *= _EASED
        copy_row(place, new_place)
        for node in range(len(rotations)):
            copy_table(rotations[node], new_turns[node])
        if cost - new <= _TOLERANCE * abs(cost):
            break
