"""Sines and cosines by our own kernel are those of numpy, to the last digit or so."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.body.kinematics import LARGEST, sincos, sincos_far


def both(angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    sines, cosines = np.empty(len(angles)), np.empty(len(angles))
    sincos(angles, sines, cosines)
    return sines, cosines


def last_digits(ours: np.ndarray, theirs: np.ndarray) -> float:
    """The largest distance in units of the last digit of a double."""
    apart = np.abs(ours.astype(np.longdouble) - theirs)
    return float((apart / np.spacing(np.abs(theirs).astype(np.float64))).max())


PRECISE = np.finfo(np.longdouble).nmant > np.finfo(np.float64).nmant


@pytest.mark.parametrize("largest", [1e-8, 1.0, 7.0, 1e3, LARGEST])
def test_random_angles(largest: float) -> None:
    count = 20_000
    angles = np.random.default_rng(0).uniform(-largest, largest, count)
    exact = angles.astype(np.longdouble)  # numpy's own doubles are off by half a digit and more
    allowed = 0.8 if PRECISE else 1.5
    sines, cosines = both(angles)
    assert last_digits(sines, np.sin(exact)) < allowed
    assert last_digits(cosines, np.cos(exact)) < allowed


def test_whole_degrees_and_their_neighbours() -> None:
    rotations = np.deg2rad(
        np.concatenate([np.arange(-720.0, 721.0, 0.5), np.arange(0.0, np.rad2deg(LARGEST), 9_990.0)])
    )
    angles = np.concatenate([rotations, np.nextafter(rotations, np.inf), np.nextafter(rotations, -np.inf)])
    sines, cosines = both(angles)
    # next to a zero the last digit is a small thing: what is left of the angle must be exact far behind it
    np.testing.assert_array_max_ulp(sines, np.sin(angles), 1)
    np.testing.assert_array_max_ulp(cosines, np.cos(angles), 1)


@given(st.floats(-LARGEST, LARGEST))
def test_any_angle(angle: float) -> None:
    sines, cosines = both(np.array([angle]))
    np.testing.assert_array_max_ulp(sines, np.array([math.sin(angle)]), 1)
    np.testing.assert_array_max_ulp(cosines, np.array([math.cos(angle)]), 1)


def test_zero_has_a_sign_and_nan_stays() -> None:
    sines, cosines = both(np.array([0.0, -0.0, np.nan]))
    assert sines[0] == 0.0
    assert cosines[:2].tolist() == [1.0, 1.0]
    assert np.isnan([sines[2], cosines[2]]).all()


def test_angles_beyond_are_numpys() -> None:
    angles = np.array([1e7, -3e15, 1e300])
    sines, cosines = np.empty(3), np.empty(3)
    sincos_far(angles, sines, cosines)
    np.testing.assert_array_max_ulp(sines, np.sin(angles), 1)
    np.testing.assert_array_max_ulp(cosines, np.cos(angles), 1)
