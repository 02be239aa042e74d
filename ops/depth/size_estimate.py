"""This module estimates a person's size from depth frames, as the height at which the body model fits best."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from kinedex.ops.arrays import F32, F64
from kinedex.ops.depth.cones import ConeBody
from kinedex.ops.depth.image_search import DepthView
from kinedex.ops.depth.points import Preparation
from kinedex.ops.depth.tracker import Reconstructor, TrackerSettings
from kinedex.ops.errors import ParameterError

HEIGHTS_M = (1.45, 2.0)
"""Range of standing heights in metres that are tried; it is extended if its lowest or highest height fits best."""

STEP_M = 0.05

LIMITS_M = (1.0, 2.4)
"""Minimum and maximum height in metres that is ever tried."""

SECONDS = 1.0
"""Duration in seconds of the part of a recording that is tracked at each height."""


class SizeEstimate(NamedTuple):
    """The estimated size of a person.

    Attributes
    ----------
    height : float
        The standing height in metres.
    bone_lengths : float64 array (24,)
        The mean bone lengths, scaled to this height, in metres.
    heights : float64 array (N,)
        The heights that were tried.
    costs : float64 array (N,)
        The mean cost of poses at each height; infinite if no person was found.
    """

    height: float
    bone_lengths: F64
    heights: F64
    costs: F64


def estimate_size(
    body: ConeBody,
    mean_bones: F64,
    directions: F32,
    preparation: Preparation,
    view: DepthView,
    images: Sequence[npt.ArrayLike],
    settings: TrackerSettings | None = None,
) -> SizeEstimate:
    """Estimate the size of a person from the first second of a recording.

    Parameters
    ----------
    body : ConeBody
        The surface.
    mean_bones : float64 array (24,)
        The mean bone lengths of an archive's actors in metres.
    directions : float32 array (N, 24, 3)
        The pose database.
    preparation : Preparation
        The preparation that converts frames to points.
    view : DepthView
        The camera.
    images : sequence of float32 array (H, W)
        The first frames that show the person, at least one; frames after the first second are not used.
    settings : TrackerSettings, optional
        The settings of the tracker.

    Returns
    -------
    SizeEstimate
        The height and the bones.

    Raises
    ------
    ParameterError
        Nobody is found in the frames.
    """
    settings = settings or TrackerSettings()
    frames = list(images)[: max(1, round(SECONDS * settings.rate_hz))]
    mean_height = body.standing_height(mean_bones)

    def cost(height: float) -> float:
        tracker = Reconstructor(body, mean_bones * (height / mean_height), directions, preparation, view, settings)
        costs = [tracker.step(image).cost for image in frames]
        found = np.array(costs)[np.isfinite(costs)]
        return float(found.mean()) if len(found) else np.inf

    height, tried = least_height(cost)
    if not np.isfinite(list(tried.values())).any():
        raise ParameterError("images", f"frames that show a person, among the first {len(frames)}", "nobody")
    heights = np.array(sorted(tried))
    costs = np.array([tried[one] for one in heights.tolist()])
    return SizeEstimate(height, mean_bones * (height / mean_height), heights, costs)


def least_height(cost: Callable[[float], float]) -> tuple[float, dict[float, float]]:
    """Return the height of lowest cost, and the costs of all heights that were tried.

    Parameters
    ----------
    cost : callable
        The cost of a height in metres.

    Returns
    -------
    height : float
        The vertex of the parabola through the lowest cost and its neighbours; if there is no such parabola, the height
        of the lowest cost.
    tried : dict of float to float
        A dict from height to cost.
    """
    first, last = (round(height / STEP_M) for height in HEIGHTS_M)
    costs = {step: cost(step * STEP_M) for step in range(first, last + 1)}
    while True:
        best = min(costs, key=lambda step: (costs[step], step))
        beyond = [step for step in (best - 1, best + 1) if step not in costs and _is_allowed(step)]
        if not beyond or not np.isfinite(costs[best]):
            break
        costs[beyond[0]] = cost(beyond[0] * STEP_M)
    below, here, above = (costs.get(step, np.inf) for step in (best - 1, best, best + 1))
    bend = below - 2 * here + above
    shift = 0.5 * (below - above) / bend if np.isfinite(bend) and bend > 0 else 0.0
    return (best + shift) * STEP_M, {step * STEP_M: value for step, value in costs.items()}


def _is_allowed(step: int) -> bool:
    return LIMITS_M[0] - 1e-9 <= step * STEP_M <= LIMITS_M[1] + 1e-9
