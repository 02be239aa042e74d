"""Bone lengths of a recording: medians, the mean body where nothing is seen, and what is reported or refused."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.ops.body.kinematic_chain import ChainBody, forward
from kinedex.ops.errors import KinedexError, ParameterError
from kinedex.ops.tracking.body_estimate import estimate_body, mean_body
from tests.ops.body.test_kinematic_chain import BODY, CHAIN, random_poses

LIMBS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle", "toes")
NAMES = [f"{side}{joint}" for joint in LIMBS for side in "lr"]
JOINTS = np.array([*(CHAIN.joint(name) for name in NAMES), -1])


def recorded(body: ChainBody = BODY, frames: int = 200) -> tuple[np.ndarray, np.ndarray]:
    """Points (T, P, 3) of the limbs' joints and of a nose, off by a centimetre, and the cameras that they are from."""
    positions, _ = forward(body, random_poses(2, frames, 0.05))
    points = np.concatenate([positions[JOINTS[:-1]].transpose(2, 0, 1), np.zeros((frames, 1, 3))], axis=1)
    points += np.random.default_rng(1).normal(0, 0.01, points.shape)
    return points, np.full(points.shape[:2], 4)


def length(body: ChainBody, name: str) -> float:
    return float(np.linalg.norm(body.offsets[CHAIN.joint(name)]))


def test_a_large_person_is_measured_where_seen_and_scaled_where_not() -> None:
    person = ChainBody(CHAIN, 1.1 * BODY.offsets)
    person.offsets[[CHAIN.joint("lknee"), CHAIN.joint("rknee")]] *= 1.05
    points, cameras = recorded(person)
    points[:50, NAMES.index("lknee")] += 0.5  # where only two cameras see it, which may be wrong together
    cameras[:50, NAMES.index("lknee")] = 2
    found = estimate_body(CHAIN, points, cameras, JOINTS, BODY)
    for joint in CHAIN.joints:
        assert length(found.body, joint) == pytest.approx(length(person, joint), rel=0.03, abs=0.003), joint
    assert length(found.body, "lknee") == length(found.body, "rknee")
    assert [bone.joint for bone in found.sides] == ["elbow", "wrist", "knee", "ankle", "toes"]
    assert found.sides[2].frames == 150
    assert found.cameras == 3
    assert not found.uneven
    assert {"belly", "neck", "headtop", "lfingers"} <= set(found.scaled)


def test_sides_that_differ_are_reported_and_the_likely_one_is_taken() -> None:
    points, cameras = recorded()
    toes, ankle = points[:, NAMES.index("rtoes")], points[:, NAMES.index("rankle")]
    toes += 1.8 * (toes - ankle)
    found = estimate_body(CHAIN, points, cameras, JOINTS, BODY)
    (uneven,) = found.uneven
    assert (uneven.joint, round(uneven.ratio, 1)) == ("toes", 2.8)
    assert length(found.body, "rtoes") == pytest.approx(0.15, abs=0.01)


def test_what_is_missing_is_in_proportion_to_its_limb() -> None:
    points, cameras = recorded(ChainBody(CHAIN, 1.2 * BODY.offsets))
    missing = [NAMES.index(name) for name in ("lwrist", "rwrist", "rtoes")]
    cameras[:, missing] = 0
    points[:, missing] = np.nan
    found = estimate_body(CHAIN, points, cameras, JOINTS, BODY)
    assert length(found.body, "lwrist") == pytest.approx(1.2 * 0.25, rel=0.02)
    assert length(found.body, "rtoes") == pytest.approx(1.2 * 0.15, rel=0.05)
    assert "rwrist" in found.scaled
    assert "rtoes" not in found.scaled


def test_two_cameras_serve_where_there_are_no_more() -> None:
    points, cameras = recorded()
    assert estimate_body(CHAIN, points, np.minimum(cameras, 2), JOINTS, BODY).cameras == 2
    with pytest.raises(
        ParameterError, match="seen together by two cameras in a frame at least, got 'none; give `body:"
    ):
        estimate_body(CHAIN, points, np.minimum(cameras, 1), JOINTS, BODY)
    with pytest.raises(ParameterError, match="both hips and both shoulders, got 'none that is lshoulder'"):
        estimate_body(CHAIN, points, cameras, np.where(np.arange(len(JOINTS)) == 0, -1, JOINTS), BODY)


@pytest.mark.parametrize(("factor", "unit"), [(1000, "mm"), (100, "cm"), (3.281, "ft"), (0.001, "km")])
def test_a_body_in_another_unit_is_refused_with_a_guess(factor: float, unit: str) -> None:
    points, cameras = recorded()
    with pytest.raises(KinedexError, match=f"m apart, and 0.2 to 0.9 m on a person; .* set `unit: {unit}`"):
        estimate_body(CHAIN, factor * points, cameras, JOINTS, BODY)
    with pytest.raises(KinedexError, match="no usual unit explains it"):
        estimate_body(CHAIN, 1e-7 * points, cameras, JOINTS, BODY)


def test_the_mean_body_is_as_long_on_both_sides() -> None:
    uneven = ChainBody(CHAIN, BODY.offsets.copy())
    uneven.offsets[CHAIN.joint("lknee")] *= 1.2
    mean = mean_body(CHAIN, [BODY, uneven])
    assert length(mean, "lknee") == length(mean, "rknee") == pytest.approx(0.42 * 1.05)
    np.testing.assert_allclose(mean_body(CHAIN, [BODY]).offsets, BODY.offsets)
    with pytest.raises(ParameterError, match="bodies must be those of one actor at least"):
        mean_body(CHAIN, [])
