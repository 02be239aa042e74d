"""The inside axes are upright however the camera is tilted, and the world is where the pose puts it."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.catalog.depth_cameras import DepthCamera, placement_of
from kinedex.ops.body.axisangle import matrices
from tests.depth_files import camera

TILT = matrices(np.array([[0.3, 0.0, 0.1]]))[0]
LEVEL = np.diag([1.0, -1.0, -1.0])


def tilted_room(seen: DepthCamera, height: float = 1.0) -> np.ndarray:
    """Return the depths of a floor and a wall for a camera that is turned by TILT from a level one."""
    rays = np.concatenate([seen.rays, np.ones((*seen.rays.shape[:2], 1))], axis=2) @ TILT
    with np.errstate(divide="ignore"):
        floor = np.where(rays[..., 1] > 0, height / rays[..., 1], np.inf)
        wall = np.where(rays[..., 2] > 0, 4.0 / rays[..., 2], np.inf)
    z = np.minimum(floor, wall)
    return np.where(z < 20, z, 0).astype(np.float32)


def test_with_a_pose_the_world_is_its_own() -> None:
    posed = camera(rotation=TILT @ LEVEL @ matrices(np.array([[0, 2.0, 0]]))[0], place=[1.0, 1.3, -2.0])
    found = placement_of(posed, None)
    points = np.random.default_rng(0).normal(size=(5, 3))
    seen = (points - posed.place) @ posed.rotation.T
    inside = found.inside(seen)
    assert found.in_world(inside) == pytest.approx(points)
    assert found.floor_height == -1.3
    assert inside[:, 1] == pytest.approx(points[:, 1] - 1.3)
    assert not found.notes


def test_a_floor_that_contradicts_the_pose_is_noted() -> None:
    posed = camera(rotation=TILT @ LEVEL, place=[0.0, 1.0, 0.0])
    room = tilted_room(posed)
    assert placement_of(posed, room).notes == ()
    (note,) = placement_of(posed, 1.5 * room).notes
    assert note.startswith("in the background the floor lies 1.50 m below the camera, and by its `pose` 1.00 m: are fx")


def test_without_a_pose_the_floor_of_the_background_is_level_and_0() -> None:
    for up in (None, TILT @ [0, -9.81, 0]):
        seen = camera(up=up)
        found = placement_of(seen, tilted_room(seen))
        assert found.floor_height == pytest.approx(-1.0, abs=0.005)
        floor = TILT @ np.array([[0.5, 1.0, 3.0], [-1.0, 1.0, 2.0]]).T
        assert found.in_world(found.inside(floor.T))[:, 1] == pytest.approx([0, 0], abs=0.01)
        assert "the floor is 1.00 m below the camera" in found.notes[0]


def test_without_a_floor_up_holds_and_without_it_the_camera_is_level() -> None:
    seen = camera(up=TILT @ [0, -1, 0])
    found = placement_of(seen, np.full((24, 32), 3.0, np.float32))
    assert found.floor_height is None
    assert found.inside(TILT @ [0, -1.0, 0]) == pytest.approx([0, 1, 0])
    bare = placement_of(camera(), None)
    assert bare.turn.tolist() == np.eye(3).tolist()
    assert "the camera is taken as level, without a floor" in bare.notes[0]


def test_turning_camera_and_up_together_changes_nothing() -> None:
    points = np.random.default_rng(1).normal((0, 0, 3), 1, (9, 3))
    level = placement_of(camera(up=[0, -1, 0]), None).inside(points)
    turned = placement_of(camera(up=TILT @ [0, -1, 0]), None).inside(points @ TILT.T)
    assert turned[:, 1] == pytest.approx(level[:, 1])
    assert np.linalg.norm(turned, axis=1) == pytest.approx(np.linalg.norm(level, axis=1))
