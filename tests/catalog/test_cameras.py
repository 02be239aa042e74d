"""The camera model: what is a camera, and how it changes with the world's axes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from kinedex.catalog.cameras import Camera, observed_rays
from kinedex.ops.errors import ParameterError

MATRIX = [[1000.0, 0, 640], [0, 1000.0, 480], [0, 0, 1]]
CAMERA = Camera("a", np.array(MATRIX), np.zeros(0), np.diag([1.0, -1, -1]), np.array([0, 1.0, 4]), (1280, 960))


def test_a_camera_before_the_world_looks_along_negative_z_with_y_up() -> None:
    assert CAMERA.centre.tolist() == [0, 1, 4]
    pixels, depths = CAMERA.project([[0, 1.0, 0], [0, 2.0, 0], [1.0, 1.0, 0]])
    assert pixels.tolist() == [[640, 480], [640, 230], [890, 480]]
    assert depths.tolist() == [4, 4, 4]


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"matrix": np.eye(3) * [[1], [0], [1]]}, "focal lengths of at least 1 pixel"),
        ({"matrix": np.array(MATRIX).T}, r"\[\[fx, skew, cx\]"),
        ({"rotation": np.diag([1.0, 1, -1])}, "a rotation, without mirroring"),
        ({"rotation": 2 * np.eye(3)}, "a rotation, without mirroring"),
        ({"translation": np.array([0, np.nan, 1])}, "translation must be finite, within"),
        ({"translation": np.zeros(4)}, r"translation must be of shape \(3,\)"),
        ({"distortion": np.zeros(6)}, "0, 4, 5 or 8 numbers"),
        ({"size": (0, 960)}, "size must be width and height"),
    ],
)
def test_what_is_no_camera_is_refused(changed: dict[str, Any], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        replace(CAMERA, **changed)


def test_a_camera_sees_the_same_after_the_world_is_turned_and_scaled() -> None:
    turn = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # Z up to Y up
    point = np.array([0.3, 0.4, 0.5])
    turned = CAMERA.in_world(turn, 0.001)
    assert turned.project(0.001 * turn @ point)[0] == pytest.approx(CAMERA.project(point)[0])
    assert turned.centre == pytest.approx(0.001 * turn @ CAMERA.centre)


def test_pixels_outside_the_image_are_known() -> None:
    inside = CAMERA.contains([[0, 0], [1279, 959], [1280, 5], [-1, 5], [np.nan, np.nan]])
    assert inside.tolist() == [True, True, False, False, False]


def test_rays_of_keypoints_are_those_of_their_cameras() -> None:
    other = replace(CAMERA, name="b", rotation=np.eye(3))
    pixels = np.array([[[[640.0, 480.0]], [[890.0, 480.0]]], [[[np.nan, np.nan]], [[640.0, 480.0]]]])
    rays = observed_rays([CAMERA, other], pixels, np.full((2, 2, 1), 0.8))
    assert rays.centres.shape == (2, 3)
    assert rays.focal_px.tolist() == [1000, 1000]
    assert rays.directions[0, 0, 0] == pytest.approx([0, 0, -1])
    assert rays.directions[0, 1, 0] == pytest.approx(np.array([0.25, 0, 1]) / np.hypot(0.25, 1))
    assert np.isfinite(rays.directions).all(), "a missing keypoint must not spoil sums"
    assert rays.confidence[:, :, 0].tolist() == [[0.8, 0.8], [0, 0.8]]
    with pytest.raises(ParameterError, match="pixels must be of shape"):
        observed_rays([CAMERA], pixels, np.ones((2, 2, 1)))
