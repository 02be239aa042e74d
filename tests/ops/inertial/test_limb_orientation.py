"""Orientations of limbs from markers and from the joints of a hinge, and jumps of a solver."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinedex.ops.errors import ParameterError
from kinedex.ops.inertial.limb_orientation import (
    hinge_orientation,
    jumps,
    long_axis,
    segment_orientation,
    unit_direction,
)
from kinedex.ops.inertial.rotations import distance_deg, exp, matrix, multiply, rotate
from tests.oracles.limb_orientation import hinge_normals, kabsch

SHAPE = np.array([[0.1, 0.0, 0.0], [-0.08, 0.05, 0.01], [-0.05, -0.06, 0.0], [0.02, 0.01, 0.05]])


def _motion(frames: int = 60) -> np.ndarray:
    t = np.linspace(0.0, 3.0, frames)
    return exp(np.stack([1.2 * np.sin(1.3 * t), 0.9 * np.sin(2.1 * t + 1), 1.5 * np.sin(0.7 * t + 2)], axis=1))


def _markers(rotations: np.ndarray, noise: float = 0.0) -> np.ndarray:
    rng = np.random.default_rng(1)
    positions = rotate(rotations[:, None], SHAPE) + np.linspace(0.0, 1.0, len(rotations))[:, None, None]
    return positions + noise * rng.standard_normal(positions.shape)


def test_markers_turn_as_their_segment() -> None:
    rotations = _motion()
    found = segment_orientation(_markers(rotations))
    fixed = multiply(found.orientation, found.orientation[0] * [1, -1, -1, -1])
    truth = multiply(rotations, rotations[0] * [1, -1, -1, -1])
    assert distance_deg(fixed, truth).max() < 1e-6
    assert found.rms_m.max() < 1e-12
    assert found.spread_m == pytest.approx(np.linalg.svd(SHAPE - SHAPE.mean(axis=0), compute_uv=False)[1])


def test_noisy_markers_are_fitted_as_by_the_twin() -> None:
    rotations = _motion()
    markers = _markers(rotations, 0.003)
    found = segment_orientation(markers)
    twin = np.array([kabsch(found.shape, positions) for positions in markers])
    np.testing.assert_allclose(matrix(found.orientation), twin, atol=1e-9)
    assert 0.001 < np.median(found.rms_m) < 0.006


def test_a_hidden_marker_costs_no_frame_while_three_others_are_seen() -> None:
    rotations = _motion()
    markers = _markers(rotations)
    markers[10:20, 0] = np.nan
    markers[30:35, :2] = np.nan
    found = segment_orientation(markers)
    assert found.valid.tolist() == [not 30 <= t < 35 for t in range(60)]
    assert np.isnan(found.orientation[30:35]).all()
    whole = segment_orientation(_markers(rotations))
    assert distance_deg(found.orientation[found.valid], whole.orientation[found.valid]).max() < 1e-6


def test_markers_on_a_line_are_refused() -> None:
    line = np.array([[0.0, 0.0, 0.0], [0.2, 0.01, 0.0], [0.4, 0.0, 0.0]])
    with pytest.raises(ParameterError, match=r"off one line by 20 mm or more .*8\.\d mm"):
        segment_orientation(rotate(_motion()[:, None], line))
    with pytest.raises(ParameterError, match="seen together in one frame"):
        segment_orientation(np.full((5, 3, 3), np.nan))
    with pytest.raises(ParameterError, match="3 or more markers"):
        segment_orientation(np.zeros((5, 2, 3)))


def _leg(bend_deg: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return hip, knee and ankle of a leg that turns and bends."""
    rotations = _motion(len(bend_deg))
    knee = rotate(rotations, np.array([0.0, -0.4, 0.0]))
    angle = np.radians(bend_deg)
    shank = np.stack([np.zeros_like(angle), -np.cos(angle), -np.sin(angle)], axis=1) * 0.4
    return np.zeros_like(knee), knee, knee + rotate(rotations, shank)


@pytest.mark.parametrize("beyond", [True, False])
def test_a_hinge_carries_its_plane_over_straight_frames(beyond: bool) -> None:
    bend = 30.0 + 40.0 * np.sin(np.linspace(-2.0, 9.0, 80))
    hip, knee, ankle = _leg(bend)
    near, far, third = (hip, knee, ankle) if beyond else (knee, ankle, hip)
    orientation, valid = hinge_orientation(near, far, third, beyond)
    axes, others = unit_direction(near, far), unit_direction(*((knee, ankle) if beyond else (hip, knee)))
    twin = hinge_normals(axes, others, beyond, 15.0)
    assert valid.all()
    np.testing.assert_allclose(matrix(orientation)[:, :, 0], axes, atol=1e-12)
    np.testing.assert_allclose(matrix(orientation)[:, :, 2], twin, atol=1e-9)
    np.testing.assert_allclose(long_axis(orientation, axes), [1.0, 0.0, 0.0], atol=1e-12)


def test_a_bent_hinge_turns_as_its_segment() -> None:
    hip, knee, ankle = _leg(np.full(60, 40.0))
    orientation, _ = hinge_orientation(hip, knee, ankle, True)
    rotations = _motion(60)
    ours = multiply(orientation, orientation[0] * [1, -1, -1, -1])
    assert distance_deg(ours, multiply(rotations, rotations[0] * [1, -1, -1, -1])).max() < 1e-6


def test_a_hinge_that_never_bends_or_is_not_seen_has_no_orientation() -> None:
    hip, knee, ankle = _leg(np.full(20, 5.0))
    orientation, valid = hinge_orientation(hip, knee, ankle, True)
    assert not valid.any()
    assert np.isnan(orientation).all()
    hip, knee, ankle = _leg(np.where(np.arange(20) < 10, 40.0, 5.0))
    knee[12:14] = np.nan
    orientation, valid = hinge_orientation(hip, knee, ankle, True)
    assert np.flatnonzero(~valid).tolist() == [12, 13]
    assert np.isfinite(orientation[14:]).all()


def test_a_fast_turn_is_a_jump() -> None:
    rotations = exp(np.stack([np.zeros(50), np.linspace(0, 3, 50), np.zeros(50)], axis=1))
    assert not jumps(rotations, 100.0).any()
    rotations[20:] = multiply(rotations[20:], exp(np.array([0.0, 0.0, np.radians(40.0)])))
    assert np.flatnonzero(jumps(rotations, 100.0)).tolist() == [19, 20]
    assert not jumps(rotations, 50.0).any()
    rotations[19] = np.nan
    assert not jumps(rotations, 100.0).any()


@pytest.mark.shared
def test_markers_of_real_feet_are_as_spread_and_as_rigid_as_measured(shared: Path) -> None:
    names = (shared / "data/imu/feet/markers.csv").read_text().splitlines()[0].split(",")[1::3]
    rows = np.loadtxt(shared / "data/imu/feet/markers.csv", delimiter=",", skiprows=2)[:, 1:].reshape(-1, 6, 3) / 1000
    spreads = []
    for side in "LR":
        own = [names.index(f"{side}_{one}") for one in ("FCC", "TOE", "FM5")]
        found = segment_orientation(rows[:, own])
        spreads.append(1000 * found.spread_m)
        assert 1000 * np.nanmean(found.rms_m) == pytest.approx(1.3, abs=0.1)
    assert sorted(spreads) == pytest.approx([41, 45], abs=1)
