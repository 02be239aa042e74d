"""Figures of takes: measured on bodies whose sizes are known, and unknown where joints are."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.body.plausibility import UNKNOWN, Plausibility, plausibility
from tests.bodies import index, standing
from tests.oracles.features import JOINTS


def swinging(frames: int = 120, rate_hz: float = 30.0) -> np.ndarray:
    """The standing figure whose shanks and forearms swing forth and back once a second, left and right in turns."""
    body = standing(frames)
    time = np.arange(frames) / rate_hz
    for near, ends, phase in (
        ("lknee", ("lankle", "ltoes"), 0.0), ("rknee", ("rankle", "rtoes"), np.pi / 2),
        ("lelbow", ("lwrist", "lfingers"), np.pi), ("relbow", ("rwrist", "rfingers"), -np.pi / 2),
    ):  # fmt: skip
        angle = 0.3 * np.sin(2 * np.pi * time + phase)
        for end in ends:
            _, y, z = body[index(end)] - body[index(near)]
            body[index(end), 1] = body[index(near), 1] + np.cos(angle) * y - np.sin(angle) * z
            body[index(end), 2] = body[index(near), 2] + np.sin(angle) * y + np.cos(angle) * z
    return body


def distance(a: str, b: str) -> float:
    body = standing(1)[:, :, 0]
    return float(np.linalg.norm(body[index(a)] - body[index(b)]))


def test_lengths_heights_and_ground_are_those_of_the_body() -> None:
    found = plausibility(standing(9) + np.array([3.0, 0.25, -2.0])[:, None], JOINTS, 30.0)
    trunk = ["root", "belly", "chest", "neck", "head", "headtop"]
    spine = sum(distance(a, b) for a, b in pairwise(trunk))
    height = 1.1 * (distance("lhip", "lknee") + distance("lknee", "lankle") + spine)
    assert found.height_m == pytest.approx(height)
    assert found.thigh_share == pytest.approx(distance("lhip", "lknee") / height)
    assert found.forearm_share == pytest.approx(distance("relbow", "rwrist") / height)
    assert found.neck_share == pytest.approx(0.05 / height)
    assert (found.asymmetry, found.bone_variation) == pytest.approx((0, 0), abs=1e-12)
    assert found.floor_m == pytest.approx(0.25)
    assert (found.up_axis, found.repeated_share, found.speed_m_s, found.fastest_m_s) == ("y", 1.0, 0.0, 0.0)


def test_speeds_are_those_between_frames_and_the_fastest_is_named() -> None:
    body = standing(10)
    body[index("lwrist"), 0, 6:] += 0.5
    found = plausibility(body, JOINTS, 30.0)
    assert found.fastest == ("lwrist", 5)
    assert found.fastest_m_s == pytest.approx(15.0)
    assert found.speed_m_s == pytest.approx(15.0 / (24 * 9))
    assert found.repeated_share == pytest.approx(8 / 9)
    assert plausibility(swinging(), JOINTS, 30.0).tempo_hz == pytest.approx(1.0, rel=0.2)
    assert plausibility(swinging(), JOINTS, 60.0).tempo_hz == pytest.approx(2.0, rel=0.2)


def test_a_longer_limb_and_one_that_stretches_show() -> None:
    body = standing(12)
    body[index("lwrist")] += 0.5 * (body[index("lwrist")] - body[index("lelbow")])
    assert plausibility(body, JOINTS, 30.0).asymmetry == pytest.approx(0.4)
    body = standing(12)
    body[index("rknee"), 1] += np.linspace(-0.1, 0.1, 12)
    assert plausibility(body, JOINTS, 30.0).bone_variation > 0.1


@given(st.sets(st.sampled_from(JOINTS)))
def test_what_joints_do_not_show_is_unknown_and_nothing_else_changes(lost: set[str]) -> None:
    body = swinging(40)
    whole = plausibility(body, JOINTS, 30.0)
    body[[index(joint) for joint in lost]] = np.nan
    found = plausibility(body, JOINTS, 30.0)
    for limb, ends in {"thigh": ("hip", "knee"), "forearm": ("elbow", "wrist")}.items():
        share = getattr(found, f"{limb}_share")
        if {"root", "head"} & lost:
            assert np.isnan(found.height_m)
            assert np.isnan(share)
        elif not lost:
            assert share == getattr(whole, f"{limb}_share")
        elif all({side + end for end in ends} & lost for side in "lr"):
            assert np.isnan(share)


def test_invalid_frames_do_not_count() -> None:
    body, valid = swinging(40), np.ones(40, np.bool_)
    body[:, :, 30:] = np.nan
    valid[30:] = False
    body[3, 0, 35:] = 1000.0
    found, part = plausibility(body, JOINTS, 30.0, valid), plausibility(body[:, :, :30], JOINTS, 30.0)
    assert (found.height_m, found.fastest_m_s, found.repeated_share) == (
        part.height_m, part.fastest_m_s, part.repeated_share
    )  # fmt: skip
    assert plausibility(body, JOINTS, 30.0, np.zeros(40, np.bool_)) == Plausibility()
    assert np.isnan(UNKNOWN)


@pytest.mark.parametrize("frames", [0, 1, 2])
def test_short_takes_have_the_figures_that_they_can_have(frames: int) -> None:
    found = plausibility(standing(3)[:, :, :frames], JOINTS, 30.0)
    assert np.isnan(found.height_m) == (frames == 0)
    assert np.isnan(found.speed_m_s) == (frames < 2)
    assert np.isnan(found.tempo_hz)
