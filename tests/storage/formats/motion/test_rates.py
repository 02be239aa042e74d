"""Impossible rates: the likely one is taken instead, and whoever states a rate is believed."""

from __future__ import annotations

import math

import numpy as np
import pytest

from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.mapped_body import corrected_rate
from kinedex.storage.formats.motion.reader import DEFAULT_SETTINGS, ReadSettings
from tests.bodies import standing
from tests.oracles.features import JOINTS


def waving(rate_hz: float) -> np.ndarray:
    """A figure whose wrists circle once a second."""
    body = standing(round(4 * rate_hz))
    angle = 2 * np.pi * np.arange(body.shape[2]) / rate_hz
    for joint in ("lwrist", "rwrist"):
        body[JOINTS.index(joint)] += 0.3 * np.stack([np.cos(angle), np.sin(angle), 0 * angle])
    return body


@pytest.mark.parametrize("stated", [1.0, 0.0, -120.0, math.nan, math.inf, 1e9])
def test_an_impossible_rate_gives_way_to_that_of_the_motion(stated: float) -> None:
    warnings: list[str] = []
    assert corrected_rate("a.bvh", stated, waving(120.0), JOINTS, DEFAULT_SETTINGS, warnings, "Frame Time 1.0") == 120.0
    assert warnings == [
        "its rate is wrong: it states Frame Time 1.0, but hands and feet move as they do at about 120 Hz, at which it "
        "is read; if you know the rate, give --rate HZ"
    ]


@pytest.mark.parametrize("stated", [30.0, 120.0, 5.0, 1000.0])
def test_a_possible_rate_stands_whatever_the_motion(stated: float) -> None:
    warnings: list[str] = []
    assert corrected_rate("a.bvh", stated, waving(120.0), JOINTS, DEFAULT_SETTINGS, warnings) == stated
    assert warnings == []


def test_a_slow_camera_is_believed_where_the_motion_is_as_coarse() -> None:
    assert corrected_rate("a.bvh", 4.0, waving(120.0)[:, :, ::30], JOINTS, DEFAULT_SETTINGS, []) == 4.0


def test_the_rate_that_the_user_gives_counts() -> None:
    for stated in (1.0, math.nan, 0.0):
        assert corrected_rate("a.bvh", stated, waving(120.0), JOINTS, ReadSettings(override_rate_hz=60.0), []) == 60.0


def test_without_motion_an_impossible_number_is_refused_and_a_slow_rate_stands() -> None:
    assert corrected_rate("a.bvh", 1.0, standing(9), JOINTS, DEFAULT_SETTINGS, []) == 1.0
    with pytest.raises(SourceError, match=r"a\.bvh.*states 0 Hz, and nothing moves; give --rate HZ"):
        corrected_rate("a.bvh", 0.0, standing(9), JOINTS, DEFAULT_SETTINGS, [])
