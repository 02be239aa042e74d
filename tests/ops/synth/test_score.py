"""Keys become movements without jumps, overshoot or haste."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops.synth.body import draw_actor
from kinedex.ops.synth.performance import coloured
from kinedex.ops.synth.score import INDEX, Score, curves


def blank() -> Score:
    score = Score(draw_actor(0, 1), np.random.default_rng(0))
    score.manner, score.late = {}, {}
    return score


def curve(score: Score, name: str, stop: float) -> np.ndarray:
    return curves(score, 120.0, stop)[:, INDEX[name]]


@settings(max_examples=40)
@given(st.lists(st.tuples(st.floats(0.05, 0.6), st.floats(-90.0, 90.0)), min_size=1, max_size=8))
def test_a_movement_never_leaves_the_range_of_its_keys(steps: list[tuple[float, float]]) -> None:
    score = blank()
    score.place(bend=0.0)
    for span, target in steps:
        score.move(0.0, span, bend=target)
        score.after(span)
    values = curve(score, "bend", score.now + 0.5)
    targets = [0.0, *(target for _, target in steps)]
    assert values.min() >= min(targets) - 1e-9
    assert values.max() <= max(targets) + 1e-9


def test_a_movement_begins_where_the_last_one_ended_and_when_it_is_told_to() -> None:
    score = blank()
    score.place(look=0.0)
    score.move(1.0, 1.5, look=30.0)
    values = curve(score, "look", 3.0)
    np.testing.assert_allclose(values[: int(0.85 * 120)], 0.0, atol=1e-6)
    np.testing.assert_allclose(values[int(1.65 * 120) :], 30.0, atol=1e-6)


def test_a_movement_that_is_interrupted_turns_round_on_its_way() -> None:
    score = blank()
    score.place(look=0.0)
    score.move(0.0, 1.0, look=60.0)
    score.move(0.5, 1.0, look=0.0)
    values = curve(score, "look", 1.5)
    assert 20.0 < values.max() < 40.0
    assert abs(values[-1]) < 1e-6


def test_who_has_turned_a_wheel_stands_upright_at_the_full_turn() -> None:
    score = blank()
    score.wound = -360.0
    score.move(0.0, 0.5, roll=0.0)
    assert score.value("roll") == -360.0


def test_places_are_seen_from_where_the_performer_stands() -> None:
    score = blank()
    score.anchor = (1.0, 2.0, 90.0)
    x, z = score.room(0.0, 1.0)
    np.testing.assert_allclose((x, z), (2.0, 2.0), atol=1e-12)


def test_coloured_noise_has_unit_spread_and_no_mean() -> None:
    noise = coloured(np.random.default_rng(1), 20000, 8, 120.0, 1.0, 2.0)
    assert noise.shape == (20000, 8)
    np.testing.assert_allclose(noise.std(axis=0), 1.0, atol=0.1)
    np.testing.assert_allclose(noise.mean(axis=0), 0.0, atol=0.15)
