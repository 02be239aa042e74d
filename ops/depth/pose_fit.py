"""This module fits a pose to the points of a depth image by Gauss–Newton (thesis, 8.4.1).

The unknowns of a step are a displacement of the body and a small rotation of every pivot. Each image point pulls the
nearest surface point along the surface normal; if this surface point faces away from the camera, the side of the cone
towards the camera is pulled instead. Surface samples that project outside the foreground are pulled towards the
foreground. In the form printed in the thesis, all samples are pulled to their points, and there are no other terms.

The module also computes the cost of a pose, by which the tracker chooses between poses in a frame (thesis, 8.4.4).
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64, I64
from kinedex.ops.depth.cones import (
    AXIS,
    COLUMNS,
    START,
    ConeBody,
    Cones,
    Pivots,
    Samples,
    nearest_cone,
    pivots_of,
    place_cones,
    place_samples,
    seen_side,
    turn_pose,
)
from kinedex.ops.depth.image_search import DepthView, FrameImage, closest_point, is_hidden, project_samples
from kinedex.ops.depth.nearest_pixels import nearest_pixels
from kinedex.ops.depth.normal_equations import (
    MovingCones,
    Sums,
    add_blended_face,
    add_blended_vector,
    add_rigid_face,
    assemble,
    clear_sums,
    make_sums,
    moving_cones,
    solve,
)
from kinedex.ops.depth.points import FrameCloud
from kinedex.ops.errors import ParameterError

Form = Literal["best", "printed"]

STEPS, PRINTED_STEPS = 8, 6
"""Maximum numbers of steps of a fit, for the best form and for the form printed in the thesis."""

SIGMA_M, RETRIEVED_SIGMA_M = (0.20, 0.05), (0.25, 0.06)
"""σ of the robust weights at the first and last step in metres, for a fit from the last pose and from a retrieved pose.
"""

SAMPLED_POINTS = 700
"""Approximate number of points in a fit: every ⌊n/700⌋-th of a frame's n points is used."""

SILHOUETTE_WEIGHT, STIFFNESS, MIN_STIFFNESS = 2.0, 3.0, 1e-3
"""Weight of a sample outside the foreground, factor of a pivot's stiffness, and the damping of all unknowns."""

MAX_TURN, MIN_TURN = 0.6, 0.004
"""Maximum rotation of a pivot in a step, in radians, and the rotation below which the fit has converged."""

WINDOW = 3
"""Half-width in pixels of the window that is searched for the point of a sample."""

MAX_SAMPLE_M, HIDDEN_COST_M, MAX_POINT_M = 0.5, 0.03, 0.15
"""In metres: the maximum cost of a sample, the constant cost of a hidden sample, and the maximum cost of a point."""

POINTS_WEIGHT = 2.0
"""Weight in the cost of the distance of points from the surface, a term that the cost of the thesis lacks."""

COST_WINDOW = 4
"""Half-width in pixels of the window that is searched for the point of a sample."""


class FitBuffers(NamedTuple):
    """Preallocated arrays for the fits of a recording.

    Attributes
    ----------
    placed : float64 array (C, 13)
        The cones of the pose.
    samples, offsets : float64 array (S, 3)
        The samples of the pose's surface, and their offsets from the axes.
    seen : float64 array (S, 3)
        The samples in the camera, see `project_samples`.
    positions : int64 array (S, 3)
        The pixels of the samples, see `project_samples`.
    guesses : int64 array (N,)
        The cones that were nearest to the sampled points in the previous step.
    rotations : float64 array (P, 3)
        Rotation vectors of the pivots.
    sums : Sums
        The sums of a step.
    """

    placed: F64
    samples: F64
    offsets: F64
    seen: F64
    positions: I64
    guesses: I64
    rotations: F64
    sums: Sums


class FitBody(NamedTuple):
    """The body of an actor as arrays for kernels: cones, samples, pivots, their stiffness, and the cones they move."""

    cones: Cones
    samples: Samples
    pivots: Pivots
    stiffness: F64
    moving: MovingCones


class PoseFit:
    """Fits poses to the frames of one recording and computes their costs, with preallocated arrays.

    Parameters
    ----------
    body : ConeBody
        The body.
    height : float
        The actor's standing height in metres.
    view : DepthView
        The camera.
    """

    def __init__(self, body: ConeBody, height: float, view: DepthView) -> None:
        pivots, moving = pivots_of(body.pivots), moving_cones(body)
        self.body = FitBody(body.cones(height), body.samples, pivots, body.stiffness, moving)
        self.view = view
        samples, count = len(body.sample_cones), len(body.pivots)
        self.buffers = FitBuffers(
            np.zeros((len(body.radii), COLUMNS)), np.zeros((samples, 3)), np.zeros((samples, 3)),
            np.zeros((samples, 3)), np.zeros((samples, 3), np.int64), np.zeros(2 * SAMPLED_POINTS, np.int64),
            np.zeros((count, 3)), make_sums(count, moving),
        )  # fmt: skip
        self.image: FrameImage | None = None

    def look(self, cloud: FrameCloud) -> None:
        """Set the frame that fits and costs refer to until the next call.

        Parameters
        ----------
        cloud : FrameCloud
            The frame, with at least one point; its arrays are not copied.

        Raises
        ------
        ParameterError
            The frame has no points.
        """
        if not len(cloud.points):
            raise ParameterError("cloud", "a frame with points", "none")
        box = np.array(cloud.box, np.int64)
        self.image = FrameImage(
            cloud.points, cloud.pixels, cloud.numbers, nearest_pixels(cloud.numbers, cloud.box, cloud.buffers), box
        )

    def fit(
        self,
        pose: F64,
        steps: int = STEPS,
        sigma: tuple[float, float] = SIGMA_M,
        form: Form = "best",
        out: F64 | None = None,
    ) -> F64:
        """Fit a pose to the points of the frame, starting from the given pose.

        Parameters
        ----------
        pose : float64 array (24, 3)
            The pose to begin with, in metres.
        steps : int, optional
            The maximum number of steps.
        sigma : tuple of (float, float), optional
            Scale σ of the robust weights in metres, in the first and in the last step; interpolated geometrically.
        form : {"best", "printed"}, optional
            "best" fits points to the surface, and the silhouette; "printed" fits samples to points as in the thesis.
        out : float64 array (24, 3), optional
            The array to write the fitted pose to; a new array by default.

        Returns
        -------
        float64 array (24, 3)
            The fitted pose; bones keep their lengths.
        """
        if self.image is None:
            raise ParameterError("image", "that of a frame: call `look` first", None)
        fitted = np.empty_like(pose) if out is None else out
        fitted[:] = pose
        _fit(self.body, self.view, self.image, self.buffers, fitted, steps, sigma, form == "printed")
        return fitted


@njit(cache=True, nogil=True, error_model="numpy")
def _fit(
    body: FitBody, view: DepthView, image: FrameImage, buffers: FitBuffers, pose: F64, steps: int,
    sigmas: tuple[float, float], printed: bool,
) -> int:  # fmt: skip
    """Update a pose in place by Gauss–Newton, and return the number of steps."""
    buffers.guesses[0] = -1
    for step in range(steps):
        share = step / (steps - 1.0) if steps > 1 else 0.0
        sigma = sigmas[0] * (sigmas[1] / sigmas[0]) ** share
        place_cones(body.cones, pose, buffers.placed)
        place_samples(body.samples, buffers.placed, buffers.samples, buffers.offsets)
        clear_sums(buffers.sums)
        if not printed:
            add_points(body, image, buffers, pose, sigma)
        add_samples(body, view, image, buffers, pose, sigma, printed)
        assemble(body.moving, body.cones.joints, body.pivots, pose, buffers.sums)
        if _move(body, buffers, pose) <= MIN_TURN:
            return step + 1
    return steps


@njit(cache=True, nogil=True, error_model="numpy")
def add_points(body: FitBody, image: FrameImage, buffers: FitBuffers, pose: F64, sigma: float) -> None:
    """Add to the normal equations the rows n · dq = d that pull the visible side of cones to sampled image points."""
    points, guesses, placed, root = image.points, buffers.guesses, buffers.placed, pose[body.pivots.joints[0]]
    blends, pivots, faces, rigid = body.moving.blends, body.moving.rigid, buffers.sums.faces, buffers.sums.rigid
    every = max(1, len(points) // SAMPLED_POINTS)
    first = guesses[0] < 0
    guess = 0
    for n, i in enumerate(range(0, len(points), every)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        _, guess, s = nearest_cone(placed, x, y, z, guess if first else guesses[n])
        guesses[n] = guess
        a, b, c, d = seen_side(placed[guess], s, x, y, z)
        u = placed[guess, START] + s * placed[guess, AXIS]
        v = placed[guess, START + 1] + s * placed[guess, AXIS + 1]
        w = placed[guess, START + 2] + s * placed[guess, AXIS + 2]
        ratio = 1.0 + d * d / (sigma * sigma)
        weight = 1.0 / (ratio * ratio)
        if blends[guess] < 0:
            add_rigid_face(rigid, pivots[guess], u - root[0], v - root[1], w - root[2], a, b, c, d, weight)
        else:
            add_blended_face(faces, blends[guess], s, a, b, c, d, weight)


@njit(cache=True, nogil=True, error_model="numpy")
def add_samples(
    body: FitBody, view: DepthView, image: FrameImage, buffers: FitBuffers, pose: F64, sigma: float, printed: bool
) -> None:
    """Add to the normal equations the rows that pull surface samples to image points.

    These are the samples that project outside the foreground or, if `printed`, all visible samples, as the thesis
    prints it.
    """
    factor = 1.0 if printed else SILHOUETTE_WEIGHT
    root, rigid = pose[body.pivots.joints[0]], buffers.sums.rigid
    samples, seen, positions = buffers.samples, buffers.seen, buffers.positions
    points, numbers, turn = image.points, image.numbers, view.turn
    project_samples(view, image, samples, seen, positions)
    for i in range(len(samples)):
        if seen[i, 2] <= 0.0 or (positions[i, 2] <= 1 and not printed):
            continue
        x, y, z = samples[i, 0], samples[i, 1], samples[i, 2]
        number = closest_point(points, numbers, positions[i, 0], positions[i, 1], x, y, z, WINDOW)
        if is_hidden(turn, points[number], seen[i, 0], seen[i, 1], seen[i, 2]):
            continue
        u, v, w = points[number, 0] - x, points[number, 1] - y, points[number, 2] - z
        ratio = 1.0 + (u * u + v * v + w * w) / (4.0 * sigma * sigma)
        weight = factor / (ratio * ratio)
        cone = body.samples.cones[i]
        blend, pivot = body.moving.blends[cone], body.moving.rigid[cone]
        if blend >= 0:
            matrix, right = buffers.sums.blended[blend], buffers.sums.blended_right[blend]
            add_blended_vector(matrix, right, body.samples.positions[i], buffers.offsets[i], u, v, w, weight)
            continue
        x, y, z = x - root[0], y - root[1], z - root[2]
        add_rigid_face(rigid, pivot, x, y, z, 1.0, 0.0, 0.0, u, weight)
        add_rigid_face(rigid, pivot, x, y, z, 0.0, 1.0, 0.0, v, weight)
        add_rigid_face(rigid, pivot, x, y, z, 0.0, 0.0, 1.0, w, weight)


@njit(cache=True, nogil=True, error_model="numpy")
def _move(body: FitBody, buffers: FitBuffers, pose: F64) -> float:
    """Solve for a step, apply it to the pose, and return the largest rotation in radians."""
    count, matrix, step = len(body.pivots.joints), buffers.sums.matrix, buffers.sums.right
    for k in range(count):
        for i in range(3 * (count - 1 - k), 3 * (count - k)):
            matrix[i, i] += STIFFNESS * body.stiffness[k] + MIN_STIFFNESS
    for i in range(3 * count, 3 * count + 3):
        matrix[i, i] += MIN_STIFFNESS
    if not solve(buffers.sums):
        return 0.0
    largest = 0.0
    for k in range(count):
        turn = step[3 * (count - 1 - k) : 3 * (count - k)]
        angle = math.sqrt(turn[0] * turn[0] + turn[1] * turn[1] + turn[2] * turn[2])
        scale = MAX_TURN / angle if angle > MAX_TURN else 1.0
        largest = max(largest, angle)
        for i in range(3):
            buffers.rotations[k, i] = scale * turn[i]
    turn_pose(body.pivots, pose, buffers.rotations, step[3 * count :])
    return largest


class PoseCost(NamedTuple):
    """The cost of a pose in metres, and its three parts.

    Attributes
    ----------
    total : float
        The sum of the three parts; the pose with the lowest total is chosen.
    surface : float
        Mean distance of the surface's samples from their points (8.7).
    extrema : float
        Mean distance of the geodesic extrema from the surface (8.8).
    points : float
        Twice the mean distance of sampled points from the surface; 0 if the form is "printed".
    """

    total: float
    surface: float
    extrema: float
    points: float


def cost_of(fit: PoseFit, pose: F64, extrema: F64, form: Form = "best") -> PoseCost:
    """Return the cost of a pose in the frame that was last set by `PoseFit.look`.

    Parameters
    ----------
    fit : PoseFit
        The body, the camera and the frame.
    pose : float64 array (24, 3)
        Joints in metres.
    extrema : float64 array (n, 3)
        The positions of the geodesic extrema in metres; if there are none, their part of the cost is 0.
    form : {"best", "printed"}, optional
        The terms; "printed", as in the thesis, has no points term.

    Returns
    -------
    PoseCost
        The cost.
    """
    if fit.image is None:
        raise ParameterError("fit", "one that has looked at a frame", None)
    surface, ends, points = _cost(
        fit.body, fit.view, fit.image, fit.buffers, pose, np.ascontiguousarray(extrema), form == "printed"
    )
    return PoseCost(surface + ends + points, surface, ends, points)


@njit(cache=True, nogil=True, error_model="numpy")
def _cost(
    body: FitBody, view: DepthView, image: FrameImage, buffers: FitBuffers, pose: F64, extrema: F64, printed: bool
) -> tuple[float, float, float]:
    """Return the three parts of the cost: surface, extrema and points."""
    place_cones(body.cones, pose, buffers.placed)
    place_samples(body.samples, buffers.placed, buffers.samples, buffers.offsets)
    surface, ends, points = 0.0, 0.0, 0.0
    project_samples(view, image, buffers.samples, buffers.seen, buffers.positions)
    for i in range(len(buffers.samples)):
        if buffers.seen[i, 2] <= 0.0:
            surface += MAX_SAMPLE_M
            continue
        x, y, z = buffers.samples[i, 0], buffers.samples[i, 1], buffers.samples[i, 2]
        number = closest_point(
            image.points, image.numbers, buffers.positions[i, 0], buffers.positions[i, 1], x, y, z, COST_WINDOW
        )
        point = image.points[number]
        if is_hidden(view.turn, point, buffers.seen[i, 0], buffers.seen[i, 1], buffers.seen[i, 2]):
            surface += HIDDEN_COST_M
        else:
            distance = math.sqrt((point[0] - x) ** 2 + (point[1] - y) ** 2 + (point[2] - z) ** 2)
            surface += min(distance, MAX_SAMPLE_M)
    guess = 0
    for i in range(len(extrema)):
        d, guess, _ = nearest_cone(buffers.placed, extrema[i, 0], extrema[i, 1], extrema[i, 2], np.int64(guess))
        ends += abs(d)
    if not printed:
        every, count = max(1, len(image.points) // SAMPLED_POINTS), 0
        for i in range(0, len(image.points), every):
            d, guess, _ = nearest_cone(
                buffers.placed, image.points[i, 0], image.points[i, 1], image.points[i, 2], guess
            )
            points += min(abs(d), MAX_POINT_M)
            count += 1
        points *= POINTS_WEIGHT / count
    return surface / len(buffers.samples), ends / max(1, len(extrema)), points
