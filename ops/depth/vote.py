"""This module computes the cost by which the vote chooses one of several poses in a frame (thesis, 8.4.4)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64
from kinedex.ops.depth.cones import nearest_cone, place_cones, place_samples
from kinedex.ops.depth.image_search import DepthView, FrameImage, closest_point, is_hidden, project_samples
from kinedex.ops.depth.pose_fit import SAMPLED_POINTS, FitBody, FitRoom, Form, PoseFit
from kinedex.ops.errors import ParameterError

MOST_SAMPLE_M, HIDDEN_COST_M, MOST_POINT_M = 0.5, 0.03, 0.15
"""Upper limits of a sample's cost, of a hidden sample's (its constant cost), and of a point's, in metres."""

POINTS_WEIGHT = 2.0
"""Weight of the points' distance in the cost, which the thesis's cost lacks."""

WINDOW = 4
"""Half-width in pixels of the window that is searched for the point of a sample."""


class PoseCost(NamedTuple):
    """The cost of a pose in metres, and its three parts.

    Attributes
    ----------
    total : float
        The sum of the parts; the pose of least total is chosen.
    surface : float
        Mean distance of the surface's samples from their points (8.7).
    extrema : float
        Mean distance of the geodesic extrema from the surface (8.8).
    points : float
        Twice the mean distance of sampled points from the surface; 0 in the printed form.
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
        The places of the geodesic extrema in metres; without any, that part is 0.
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
        fit.body, fit.view, fit.image, fit.room, pose, np.ascontiguousarray(extrema), form == "printed"
    )
    return PoseCost(surface + ends + points, surface, ends, points)


@njit(cache=True, nogil=True, error_model="numpy")
def _cost(
    body: FitBody, view: DepthView, image: FrameImage, room: FitRoom, pose: F64, extrema: F64, printed: bool
) -> tuple[float, float, float]:
    """Return the three parts of the cost: surface, extrema and points."""
    place_cones(body.cones, pose, room.placed)
    place_samples(body.samples, room.placed, room.samples, room.offsets)
    surface, ends, points = 0.0, 0.0, 0.0
    project_samples(view, image, room.samples, room.seen, room.places)
    for i in range(len(room.samples)):
        if room.seen[i, 2] <= 0.0:
            surface += MOST_SAMPLE_M
            continue
        x, y, z = room.samples[i, 0], room.samples[i, 1], room.samples[i, 2]
        number = closest_point(image.points, image.numbers, room.places[i, 0], room.places[i, 1], x, y, z, WINDOW)
        point = image.points[number]
        if is_hidden(view.turn, point, room.seen[i, 0], room.seen[i, 1], room.seen[i, 2]):
            surface += HIDDEN_COST_M
        else:
            distance = math.sqrt((point[0] - x) ** 2 + (point[1] - y) ** 2 + (point[2] - z) ** 2)
            surface += min(distance, MOST_SAMPLE_M)
    guess = 0
    for i in range(len(extrema)):
        d, guess, _ = nearest_cone(room.placed, extrema[i, 0], extrema[i, 1], extrema[i, 2], np.int64(guess))
        ends += abs(d)
    if not printed:
        every, count = max(1, len(image.points) // SAMPLED_POINTS), 0
        for i in range(0, len(image.points), every):
            d, guess, _ = nearest_cone(room.placed, image.points[i, 0], image.points[i, 1], image.points[i, 2], guess)
            points += min(abs(d), MOST_POINT_M)
            count += 1
        points *= POINTS_WEIGHT / count
    return surface / len(room.samples), ends / max(1, len(extrema)), points
