"""The tracker on rendered frames: starts, absence, missing frames, hypotheses, and its explanation."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.ops.depth.image_search import depth_view
from kinedex.ops.depth.lookup import TURN_FRAMES, TURNS_DEG
from kinedex.ops.depth.points import Preparation, ray_table
from kinedex.ops.depth.pose_distance import COMPARED
from kinedex.ops.depth.thinned_poses import bone_directions, turn_poses
from kinedex.ops.depth.tracker import FrameResult, Reconstructor, TrackerSettings
from kinedex.ops.errors import ParameterError
from kinedex.ops.simulation.depth_rays import ConeRays, Surface
from tests.ops.depth.cone_bodies import BODY, HEIGHT, POSE, random_pose
from tests.ops.depth.pose_material import BONES, random_directions
from tests.plain_python import slow_as_python

pytestmark = slow_as_python  # each kernel has its own test as plain Python

SIZE, FOCAL, CENTRE = (150, 120), 126.0, (70.0, 59.5)
MATRIX = [[FOCAL, 0, CENTRE[0]], [0, FOCAL, CENTRE[1]], [0, 0, 1]]
DIRECTIONS = np.concatenate([bone_directions(POSE[None]), random_directions(60)])
EMPTY = np.zeros(SIZE[::-1], np.float32)


def image(pose: np.ndarray) -> np.ndarray:
    """The depth image of the tracker's own body."""
    cones = BODY.cones(HEIGHT)
    ends = np.einsum("cem,cemi->cei", cones.shares, pose[cones.joints]) * [1, -1, -1]
    rays = ConeRays(Surface(cones.radii, 0.0, 0.0, np.zeros((len(cones.radii), 3))), FOCAL, CENTRE, SIZE)
    depth = rays.depth(np.ascontiguousarray(ends))
    return np.where(np.isfinite(depth), depth, 0.0).astype(np.float32)


@pytest.fixture(scope="module")
def frames() -> list[np.ndarray]:
    """A person who shifts and raises limbs a little, in six frames."""
    end = random_pose(5, 8)
    return [POSE + k / 5 * (end - POSE) for k in range(6)]


@pytest.fixture(scope="module")
def images(frames: list[np.ndarray]) -> list[np.ndarray]:
    return [image(pose) for pose in frames]


def tracker(**settings: object) -> Reconstructor:
    preparation = Preparation(ray_table(MATRIX, (), SIZE))
    return Reconstructor(BODY, BONES, DIRECTIONS, preparation, depth_view(MATRIX), TrackerSettings(**settings))  # type: ignore[arg-type]


def error(result: FrameResult, pose: np.ndarray) -> float:
    return float(np.linalg.norm(result.pose - pose, axis=1)[COMPARED].mean())


def test_a_person_is_found_and_followed(frames: list[np.ndarray], images: list[np.ndarray]) -> None:
    follow = tracker()
    results = [follow.step(one) for one in images]
    assert [one.started for one in results] == [True, *[False] * 5]
    assert max(error(one, pose) for one, pose in zip(results, frames, strict=True)) < 0.05
    first = results[0]
    assert first.hypothesis == "database"
    assert np.isnan(first.cost_local)
    assert len(first.maps) == 2 * 120 + 6 * 12  # for eight directions
    for one in results:
        rows = [each.row for each in one.candidates]
        assert one.row in rows
        assert len(rows) == len(set(rows)) <= follow.settings.most_candidates
        assert max(each.map for each in one.candidates) < len(one.maps)
    for one in results[1:]:
        assert one.hypothesis == "local" or one.cost_database < one.cost_local
    np.testing.assert_allclose(np.linalg.norm(first.facing), 1.0)
    assert not results[-1].unseen.all()
    assert first.unseen.any() == bool(first.unseen.sum())


@pytest.mark.parametrize("yaw", [150.0, 180.0, -45.0])
def test_a_person_who_faces_elsewhere_is_found_at_a_start(yaw: float) -> None:
    pose = POSE - POSE[0]
    turn_poses(pose, np.sin(np.deg2rad(yaw)), np.cos(np.deg2rad(yaw)))
    pose += POSE[0]
    frame = image(pose)
    assert error(tracker().step(frame), pose) < 0.05
    assert len(tracker(form="printed", candidates=1).step(frame).maps) == 12


def test_a_lost_pose_is_replaced_within_a_round_of_directions(images: list[np.ndarray]) -> None:
    follow = tracker()
    follow.step(images[0])
    wrong = POSE - POSE[0]
    turn_poses(wrong, -1.0, 0.0)  # to the right
    follow._pose, follow._before = wrong + POSE[0] + [0.0, 0.0, -0.3], None
    results = [follow.step(images[0]) for _ in range(TURN_FRAMES * len(TURNS_DEG))]
    assert error(results[-1], POSE) < 0.05


def test_the_same_frames_give_the_same_bytes(images: list[np.ndarray]) -> None:
    runs = [[one.step(each).pose.tobytes() for each in images[:2]] for one in (tracker(), tracker())]
    assert runs[0] == runs[1]


def test_a_frame_without_a_person_has_no_pose_and_a_short_one_is_bridged(images: list[np.ndarray]) -> None:
    follow = tracker(rate_hz=4.0)
    follow.step(images[0])
    for _ in range(2):  # half a second
        nobody = follow.step(EMPTY)
        assert nobody.hypothesis is None
        assert np.isnan(nobody.pose).all()
        assert np.isnan(nobody.cost)
    assert not follow.step(images[1]).started
    for _ in range(3):
        follow.step(EMPTY)
    assert follow.step(images[1]).started


def test_missing_frames_are_skipped_up_to_a_fifth_of_a_second(images: list[np.ndarray]) -> None:
    follow = tracker(rate_hz=10.0)
    follow.step(images[0])
    follow.skip(2)
    assert not follow.step(images[1]).started
    follow.skip(3)
    assert follow.step(images[2]).started


def test_the_person_in_the_middle_is_found_and_then_followed(frames: list[np.ndarray]) -> None:
    follow = tracker()
    other = [0.95, 0.0, -0.6]
    images = []
    for pose in frames[:3]:
        both = np.stack([image(pose), image(pose + other)])
        near = np.where(both > 0, both, np.inf).min(axis=0)
        images.append(np.where(np.isfinite(near), near, 0.0).astype(np.float32))
    results = [follow.step(one) for one in images]
    assert [one.people for one in results] == [2, 2, 2]
    assert max(error(one, pose) for one, pose in zip(results, frames, strict=False)) < 0.05


def test_one_hypothesis_alone(images: list[np.ndarray]) -> None:
    local, database = tracker(hypotheses=("local",)), tracker(hypotheses=("database",))
    assert [local.step(one).hypothesis for one in images[:3]] == ["database", "local", "local"]
    results = [database.step(one) for one in images[:3]]
    assert all(one.hypothesis == "database" and one.local is None for one in results)


def test_the_printed_form_tries_one_candidate_of_five_extrema(images: list[np.ndarray]) -> None:
    follow = tracker(form="printed")
    results = [follow.step(one) for one in images[:3]]
    assert all(len(one.candidates) == 1 and one.maps.max() < 5 for one in results)


def test_wrong_settings_are_named() -> None:
    with pytest.raises(ParameterError, match="form must be 'best' or 'printed', got 'x'"):
        TrackerSettings(form="x")  # type: ignore[arg-type]
    with pytest.raises(ParameterError, match="hypotheses must be one or both"):
        TrackerSettings(hypotheses=())
    with pytest.raises(ParameterError, match="rate_hz must be positive"):
        TrackerSettings(rate_hz=0)
    with pytest.raises(ParameterError, match="image must be of shape"):
        tracker().step(EMPTY[:-1])
