"""The cost of a pose in a frame, by which the vote is decided."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.ops.arrays import F64
from kinedex.ops.depth.cones import ConeBody
from kinedex.ops.depth.image_search import DepthView
from kinedex.ops.depth.points import FrameCloud
from kinedex.ops.depth.pose_fit import Form, PoseCost, PoseFit, cost_of
from kinedex.ops.errors import ParameterError
from tests.ops.depth.cone_bodies import BODY, HEIGHT, POSE, random_pose
from tests.ops.depth.filmed_cones import LEVEL, MATRIX, film, standing, tilted, view
from tests.oracles import pose_fit as oracle
from tests.plain_python import slow_as_python


def pose_cost(
    body: ConeBody, height: float, view: DepthView, pose: F64, cloud: FrameCloud, extrema: F64, form: Form = "best"
) -> PoseCost:
    """Return the cost of a pose in one frame."""
    fit = PoseFit(body, height, view)
    fit.look(cloud)
    return cost_of(fit, np.ascontiguousarray(pose, np.float64), np.ascontiguousarray(extrema, np.float64), form)


@pytest.mark.parametrize(("turn", "degrees"), [(LEVEL, 5), (tilted(20), 40)])
def test_the_cost_is_that_of_the_definition(turn: np.ndarray, degrees: float) -> None:
    cloud, pose = film(POSE, turn), random_pose(5, degrees)
    extrema = cloud.points[::200]
    found = pose_cost(BODY, HEIGHT, view(turn), pose, cloud, extrema)
    expected = oracle.cost(BODY, HEIGHT, MATRIX, turn, pose, cloud, extrema)
    assert (found.surface, found.extrema, found.points) == pytest.approx(expected, abs=1e-9)
    assert found.total == pytest.approx(sum(expected))
    printed = pose_cost(BODY, HEIGHT, view(turn), pose, cloud, extrema, "printed")
    assert printed == (pytest.approx(sum(expected[:2])), found.surface, found.extrema, 0.0)


@slow_as_python
def test_the_true_pose_costs_least() -> None:
    fit = PoseFit(BODY, HEIGHT, view())
    fit.look(standing())
    extrema = standing().points[::200]
    true = cost_of(fit, POSE, extrema)
    assert true.total < 0.03
    assert all(cost_of(fit, random_pose(seed, 5), extrema).total > 2 * true.total for seed in range(4))
    assert cost_of(fit, POSE + np.array([0, 0, 10]), np.empty((0, 3))).surface == 0.5  # behind the camera


def test_a_cost_needs_a_frame() -> None:
    with pytest.raises(ParameterError, match="fit must be one that has looked at a frame"):
        cost_of(PoseFit(BODY, HEIGHT, view()), POSE, np.empty((0, 3)))
