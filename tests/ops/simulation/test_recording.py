"""Simulated recordings: where cameras look, how large errors are, and what failures change."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.catalog.kinematics import load_kinematic_chain
from kinedex.ops.body.kinematic_chain import Poses, forward
from kinedex.ops.body.pose_fit import measured_body
from kinedex.ops.cameras.projection import camera_centre, project
from kinedex.ops.errors import ParameterError
from kinedex.ops.simulation.recording import (
    KINDS,
    CameraRing,
    Detector,
    Failure,
    FailureRate,
    Limbs,
    Setup,
    detected_keypoints,
    draw_failures,
    keypoint_positions,
    outside_hidden,
    ring_of_cameras,
    simulated_recording,
    take_generators,
    with_failures,
)
from kinedex.ops.tracking.observations import BodyPoints
from tests.bodies import STANDING

JOINTS = ("lelbow", "lwrist", "relbow", "rwrist", "lhip", "lknee", "lankle", "rhip", "rknee", "rankle")
LIMBS = Limbs((np.array([0, 1]), np.array([2, 3])), (np.array([4, 5, 6]), np.array([7, 8, 9])))
"""Keypoints of these tests, in the order of `JOINTS`."""


CHAIN = load_kinematic_chain()
STILL = np.repeat(np.array([STANDING[joint] for joint in CHAIN.joints], float)[..., None], 30, axis=2)


def _random(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_cameras_stand_evenly_around_the_middle_and_look_at_it() -> None:
    ring = CameraRing(count=5, distance_m=3.0, height_m=2.0, aim_m=1.2)
    roots = np.array([[0.0, 1.0, 0.0], [2.0, 1.0, 1.0], [4.0, 1.0, 2.0]])
    rotations, translations = ring_of_cameras(ring, roots, -0.5, _random())
    centres = np.array([camera_centre(*one) for one in zip(rotations, translations, strict=True)])
    aim = np.array([2.0, 0.7, 1.0])
    assert np.linalg.norm(centres[:, [0, 2]] - aim[[0, 2]], axis=1) == pytest.approx(
        5.0
    )  # 3 m + 2 m that the root goes
    assert centres[:, 1] == pytest.approx(1.5)
    angles = np.unwrap(np.arctan2(*(centres - aim)[:, [0, 2]].T))
    assert np.diff(angles) == pytest.approx(2 * np.pi / 5)
    for turn, move in zip(rotations, translations, strict=True):
        assert turn @ turn.T == pytest.approx(np.eye(3))
        assert np.linalg.det(turn) == pytest.approx(1.0)
        pixel, depth = project(ring.matrix, turn, move, (), aim)
        assert pixel == pytest.approx((640, 480))
        assert depth > 0
        assert project(ring.matrix, turn, move, (), aim + np.array([0, 0.1, 0]))[0][1] < 480  # y points down


def test_noise_confidence_and_outliers_have_the_sizes_they_are_given() -> None:
    true = np.full((4000, 2, 5, 2), 500.0)
    detector = Detector(outliers=0.1)
    pixels, confidence = detected_keypoints(detector, true, _random())
    errors = pixels - true
    far = np.abs(errors).max(axis=-1) > 20
    assert 0.08 < far.mean() < 0.1
    calm, _ = detected_keypoints(Detector(outliers=0.0), true, _random())
    errors = (calm - true)[..., 0]
    assert errors.std() == pytest.approx(4.0, rel=0.03)
    assert np.mean(errors[1:] * errors[:-1]) / errors.var() == pytest.approx(0.7, abs=0.02)
    assert confidence.min() >= 0.3
    assert confidence.max() <= 1.0
    assert confidence[~far].mean() == pytest.approx(0.84, abs=0.02)


def test_what_no_image_shows_is_hidden() -> None:
    pixels = np.array([[[[-1.0, 5.0], [5.0, 5.0], [640.0, 5.0], [np.nan, np.nan]]]])
    positions, confidence = outside_hidden(pixels, np.ones((1, 1, 4)), (640, 480))
    assert confidence[0, 0].tolist() == [0, 1, 0, 0]
    assert positions[0, 0].tolist() == [[0, 0], [5, 5], [0, 0], [0, 0]]


def test_failures_have_the_number_and_the_length_asked_for() -> None:
    rate = FailureRate(per_second=0.5, shortest_s=0.4, longest_s=1.0)
    found = draw_failures(rate, 9000, 30.0, 4, _random())
    assert len(found) == 150
    lengths = np.array([one.stop - one.start for one in found])
    assert lengths.min() >= 12
    assert lengths.max() <= 30
    assert all(one.start >= 0 and one.stop <= 9000 for one in found)
    assert {one.kind for one in found} == {*KINDS}
    sizes = {kind: {len(one.cameras) for one in found if one.kind == kind} for kind in KINDS}
    assert sizes == {"views": {2}, "occluded": {2, 3}, "swapped": {1, 2}, "stuck": {2, 3}}
    assert found == draw_failures(rate, 9000, 30.0, 4, _random())
    assert draw_failures(rate, 0, 30.0, 4, _random()) == []
    for cameras in (1, 2, 3):
        assert all(max(one.cameras) < cameras for one in draw_failures(rate, 9000, 30.0, cameras, _random()))


def test_failures_change_what_they_name_and_nothing_else() -> None:
    pixels = 100.0 * np.arange(10)[None, None, :, None] + np.zeros((6, 3, 10, 2))
    confidence = np.linspace(0.5, 1.0, 10) + np.zeros((6, 3, 10))

    def failed(kind: str, limb: str) -> tuple[np.ndarray, np.ndarray]:
        moved, trusted = with_failures([Failure(2, 4, kind, limb, (1,))], LIMBS, pixels, confidence, _random())
        outside = np.ones((6, 3), bool)
        outside[2:4, 1] = False
        assert (moved[outside] == pixels[outside]).all()
        assert (trusted[outside] == confidence[outside]).all()
        return moved[2:4, 1], trusted[2:4, 1]

    assert (failed("views", "body")[1] == 0).all()
    swapped, trusted = failed("swapped", "legs")
    order = [0, 1, 2, 3, 7, 8, 9, 4, 5, 6]
    assert (swapped == pixels[0, 0, order]).all()
    assert (trusted == confidence[0, 0, order]).all()
    occluded, trusted = failed("occluded", "lleg")
    assert (occluded[:, [0, 1, 2, 3, 4, 7, 8, 9]] == pixels[0, 0, [0, 1, 2, 3, 4, 7, 8, 9]]).all()  # the hip stays
    assert (trusted[:, [5, 6]] <= 0.6).all()
    assert (occluded[:, [5, 6]] != pixels[0, 0, [5, 6]]).all()
    stuck, trusted = failed("stuck", "rarm")
    assert np.abs(stuck[:, [2, 3]] - pixels[0, 0, [0, 1]]).max() < 30
    assert (trusted[:, [2, 3]] == 0.6).all()


def test_a_recording_shows_the_joints_where_they_are_and_comes_again_from_its_seed() -> None:
    body, positions = measured_body(CHAIN, STILL), STILL[..., :4]
    joints = np.array([CHAIN.joint(name) for name in JOINTS])
    nodes = np.array([CHAIN.rest[j].node for j in joints])
    points = BodyPoints(nodes, body.offsets[joints], joints)
    exact = Setup(detector=Detector(offset_m=0.0, noise_px=0.0, outliers=0.0), failures=FailureRate(per_second=0.0))
    found = simulated_recording(exact, body, positions, points, LIMBS, 30.0, take_generators(3, "walk"))
    for v, (turn, move) in enumerate(zip(found.rotations, found.translations, strict=True)):
        true = project(exact.ring.matrix, turn, move, (), positions[joints].transpose(2, 0, 1))[0]
        assert found.pixels[:, v] == pytest.approx(true, abs=1e-9)

    def drawn(seed: int, name: str) -> np.ndarray:
        return simulated_recording(Setup(), body, positions, points, LIMBS, 30.0, take_generators(seed, name)).pixels

    walk = drawn(3, "walk")
    assert (walk == drawn(3, "walk")).all()
    assert (walk != drawn(4, "walk")).any()
    assert (walk != drawn(3, "run")).any()


def test_keypoints_that_are_no_joints_are_carried_by_their_node() -> None:
    body = measured_body(CHAIN, STILL)
    rotations = np.tile(np.eye(3), (1, len(CHAIN.nodes), 1, 1))
    rotations[0, 0] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]  # faces +X
    positions, _ = forward(body, Poses(np.array([[0.0, 1.0, 0.0]]), rotations))
    nose = BodyPoints(np.array([CHAIN.nodes.index("neck")]), np.array([[0.0, 0.06, 0.12]]), np.array([-1]))
    (place,) = keypoint_positions(body, positions, nose, np.zeros((1, 3)))[0]
    assert place - positions[CHAIN.joint("neck"), :, 0] == pytest.approx([0.12, 0.06, 0.0], abs=5e-3)


@pytest.mark.parametrize("wrong", [{"count": 0}, {"distance_m": 0.0}, {"size": (0, 480)}])
def test_a_ring_out_of_range_is_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ParameterError):
        CameraRing(**wrong)  # type: ignore[arg-type]


def test_rates_and_detectors_out_of_range_are_refused() -> None:
    with pytest.raises(ParameterError):
        FailureRate(per_second=-1.0)
    with pytest.raises(ParameterError):
        FailureRate(shortest_s=2.0, longest_s=1.0)
    with pytest.raises(ParameterError):
        Detector(noise_px=-1.0)
    with pytest.raises(ParameterError):
        Detector(outliers=1.5)
