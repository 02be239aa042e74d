"""Quaternions: products, logarithms, distances, and streams that are interpolated."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops.errors import ParameterError
from kinedex.ops.inertial import rotations as r
from tests.oracles import inertial as naive


def some(count: int, seed: int = 0) -> np.ndarray:
    """Random unit quaternions (count, 4)."""
    q = np.random.default_rng(seed).normal(size=(count, 4))
    return q / np.linalg.norm(q, axis=1)[:, None]


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1))
def test_products_turns_and_distances_agree_with_one_at_a_time(seed: int) -> None:
    p, q = some(2, seed)
    np.testing.assert_allclose(r.multiply(p, q), naive.product(p, q), atol=1e-15)
    np.testing.assert_allclose(r.matrix(q), naive.matrix(q), atol=1e-14)
    np.testing.assert_allclose(r.rotate(p, np.array([1.0, -2.0, 3.0])), naive.matrix(p) @ [1, -2, 3], atol=1e-13)
    assert r.distance_deg(p, q) == pytest.approx(naive.distance_deg(p, q), abs=1e-5)
    assert r.distance_deg(p, -q) == pytest.approx(r.distance_deg(p, q), abs=1e-12)
    assert r.distance_deg(r.from_matrix(r.matrix(q)), q) < 1e-12
    np.testing.assert_allclose(r.exp(r.log(q)), q * np.sign(q[0]), atol=1e-14)


def test_small_angles_keep_their_digits() -> None:
    for degrees in (1e-9, 1e-5, 179.9999999):
        q = r.exp(np.radians([0.0, degrees, 0.0]))
        assert r.distance_deg(q, np.array([1.0, 0, 0, 0])) == pytest.approx(degrees, rel=1e-12)
        np.testing.assert_allclose(r.log(-q), np.radians([0.0, degrees, 0.0]), rtol=1e-9)
    np.testing.assert_array_equal(r.log(r.exp(np.zeros(3))), np.zeros(3))


def test_signs_of_a_stream_become_continuous_and_unknown_frames_stay() -> None:
    stream = r.exp(np.outer(np.linspace(0, 9, 50), [0.3, 0.2, 0.1]))
    mixed = stream * np.where(np.arange(50) % 3, 1.0, -1.0)[:, None]
    mixed[7] = np.nan
    smooth = r.continuous(mixed)
    known = np.delete(smooth, 7, axis=0)
    assert (np.einsum("ta,ta->t", known[1:], known[:-1]) > 0).all()
    assert np.isnan(smooth[7]).all()
    assert r.distance_deg(known, np.delete(stream, 7, axis=0)).max() < 1e-6


def test_interpolation_is_exact_for_constant_speed_and_stops_at_gaps() -> None:
    times = np.array([0.0, 0.02, 0.04, 0.09, 0.11, 0.12, 0.12])
    stream = r.exp(np.outer(times, [2.0, -1.0, 3.0])) * np.array([1, -1, 1, 1, -1, 1, 1])[:, None]
    at = np.array([-0.001, 0.0, 0.013, 0.04, 0.05, 0.1, 0.12, 0.121])
    found, valid = r.interpolate(times, stream, at, longest_gap_s=0.04)
    assert valid.tolist() == [False, True, True, True, False, True, True, False]
    assert np.isnan(found[~valid]).all()
    assert r.distance_deg(found[valid], r.exp(np.outer(at, [2.0, -1.0, 3.0]))[valid]).max() < 1e-6
    stream[4] = np.nan  # now the gap is from 0.09 to 0.12
    assert r.interpolate(times, stream, at)[1].tolist() == [False, True, True, True, True, True, True, False]
    assert not r.interpolate(times, stream * np.nan, at)[1].any()


def test_angular_speed_is_that_of_the_turn_between_frames() -> None:
    times = np.array([0.0, 0.1, 0.3, 0.3, 0.4])
    stream = r.exp(np.outer([0.0, 0.1, 0.5, 0.5, np.nan], [0.0, 0.0, 1.0]))
    middle, speed = r.angular_speed(times, stream)
    np.testing.assert_allclose(middle, [0.05, 0.2, 0.3, 0.35])
    np.testing.assert_allclose(speed, [1.0, 2.0, np.nan, np.nan])


def test_descending_times_and_wrong_shapes_are_refused() -> None:
    with pytest.raises(ParameterError, match="times must be ascending"):
        r.interpolate(np.array([1.0, 0.0]), some(2), np.zeros(1))
    with pytest.raises(ParameterError, match="one for each time"):
        r.interpolate(np.zeros(3), some(2), np.zeros(1))
