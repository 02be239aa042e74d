"""The choice between tracks of both directions against all choices, and the height of least cost."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops.depth.low_pass import CHANGE, choose_directions
from kinedex.ops.depth.size_estimate import least_height
from kinedex.ops.errors import ParameterError
from tests.oracles.pose_lookup import best_directions


@settings(max_examples=40)
@given(seed=st.integers(0, 10_000), frames=st.integers(1, 9), ties=st.booleans())
def test_the_choice_is_the_cheapest_of_all(seed: int, frames: int, ties: bool) -> None:
    random = np.random.default_rng(seed)
    forward = random.normal(0, 0.1, (frames, 24, 3))
    backward = forward + random.choice([0.0, 0.1, 1.0], (frames, 1, 1))
    costs = random.integers(0, 3, (frames, 2)) * 0.1 if ties else random.uniform(0, 0.3, (frames, 2))
    chosen = choose_directions(forward, backward, costs)
    apart = np.linalg.norm(forward - backward, axis=2).mean(axis=1)

    def total(choice: np.ndarray) -> float:
        changes = np.flatnonzero(np.diff(choice)) + 1
        return float(costs[np.arange(frames), choice].sum() + CHANGE * apart[changes].sum())

    best = np.array(best_directions(forward, backward, costs, CHANGE))
    assert total(chosen) == pytest.approx(total(best), abs=1e-12)
    if not ties:
        assert chosen.tolist() == best.tolist()


def test_a_track_without_a_pose_is_not_chosen() -> None:
    forward, backward = np.zeros((5, 24, 3)), np.full((5, 24, 3), 0.01)
    forward[1:3], backward[4] = np.nan, np.nan
    costs = np.array([[0.1, 0.2], [np.nan, 9.0], [np.nan, 9.0], [0.1, 0.2], [0.1, np.nan]])
    chosen = choose_directions(forward, backward, costs)
    assert chosen[1:3].tolist() == [1, 1]
    assert chosen[4] == 0


def test_equal_tracks_are_forward() -> None:
    assert not choose_directions(np.zeros((4, 24, 3)), np.zeros((4, 24, 3)), np.ones((4, 2))).any()
    assert len(choose_directions(np.zeros((0, 24, 3)), np.zeros((0, 24, 3)), np.ones((0, 2)))) == 0
    with pytest.raises(ParameterError, match=r"costs must be an array \(4, 2\)"):
        choose_directions(np.zeros((4, 24, 3)), np.zeros((4, 24, 3)), np.ones((3, 2)))


@pytest.mark.parametrize("height", [1.333, 1.45, 1.62, 1.7, 2.0, 2.17])
def test_the_height_is_the_vertex_of_the_costs(height: float) -> None:
    found, tried = least_height(lambda one: 0.05 + 0.1 * (one - height) ** 2)
    assert found == pytest.approx(height, abs=1e-9)
    assert max(tried) >= 2.0 - 1e-9
    assert min(tried) <= 1.45 + 1e-9


def test_heights_beyond_the_limits_are_not_tried() -> None:
    found, tried = least_height(lambda one: one)
    assert found == pytest.approx(1.0)
    assert min(tried) == pytest.approx(1.0)
    assert least_height(lambda one: np.inf)[0] == pytest.approx(1.45)
