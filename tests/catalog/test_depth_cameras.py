"""A depth camera: its rays, the unit of its images, and what is none."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from kinedex.catalog.depth_cameras import DepthCamera
from kinedex.ops.errors import ParameterError

MATRIX = np.array([[200.0, 0, 3.5], [0, 200.0, 2], [0, 0, 1]])
SIZE = (8, 5)


def camera(**changed: Any) -> DepthCamera:
    return DepthCamera(**({"matrix": MATRIX, "distortion": np.zeros(0), "size": SIZE} | changed))


def test_integers_are_units_and_floats_metres_and_nothing_measured_is_0() -> None:
    values = np.zeros((5, 8), np.uint16)
    values[0, :3] = 2000, 65535, 65534
    assert camera(depth_unit_m=0.0002).depths(values)[0, :4].tolist() == pytest.approx([0.4, 0, 13.1068, 0])
    metres = np.zeros((5, 8), np.float32)
    metres[0, :5] = 2.5, np.nan, np.inf, -1, 0
    assert camera(depth_unit_m=0.0002).depths(metres)[0, :5].tolist() == [2.5, 0, 0, 0, 0]


def test_a_table_of_16_bits_gives_the_depths_of_wider_integers() -> None:
    values = np.random.default_rng(0).integers(0, 1 << 16, (5, 8))
    values[0, :2] = 0, 65535
    seen = camera(depth_unit_m=0.00025)
    assert seen.depths(values.astype(np.uint16)).tolist() == seen.depths(values).tolist()


def test_distances_along_the_ray_become_depths() -> None:
    point = np.array([0.3, -0.2, 2.0])
    turned = camera(matrix=np.array([[4.0, 0, 3.5], [0, 4.0, 2], [0, 0, 1]]), is_range=True)
    u, v = (round(float(x)) for x in turned.project(point)[0])
    ray = np.array([*turned.rays[v, u], 1.0])
    depths = turned.depths(np.full((5, 8), np.linalg.norm(2.0 * ray)))
    assert depths[v, u] == pytest.approx(2.0)


@pytest.mark.parametrize("count", [4, 5, 8])
def test_rays_are_projected_onto_their_pixels_whatever_the_lens(count: int) -> None:
    lens = np.array([0.2, -0.1, 0.001, -0.002, 0.03, 0.1, -0.05, 0.01])[:count]
    seen = camera(distortion=lens, matrix=np.array([[8.0, 0, 3.5], [0, 8.0, 2], [0, 0, 1]]))
    points = np.concatenate([seen.rays, np.ones((5, 8, 1))], axis=2)
    pixels = seen.project(points)[0]
    assert pixels[..., 0] == pytest.approx(np.broadcast_to(np.arange(8), (5, 8)), abs=1e-8)
    assert pixels[..., 1] == pytest.approx(np.broadcast_to(np.arange(5)[:, None], (5, 8)), abs=1e-8)


def test_a_pose_or_an_accelerometer_tells_where_up_is() -> None:
    assert camera().upwards is None
    assert camera(up=[0, -9.81, 0]).upwards.tolist() == [0, -1, 0]
    posed = camera(rotation=np.diag([1.0, -1, -1]), place=[0, 1.1, 3])
    assert posed.upwards.tolist() == [0, -1, 0]
    assert posed.camera.centre.tolist() == [0, 1.1, 3]


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"matrix": -MATRIX}, "focal lengths"),
        ({"distortion": np.zeros(3)}, "distortion must be of 0, 4, 5 or 8 numbers"),
        ({"size": (0, 5)}, "size must be width and height"),
        ({"size": (100_000, 100_000)}, "size must be of at most 4,194,304 pixels"),
        ({"depth_unit_m": 0}, "depth_unit_m must be above 0"),
        ({"depth_unit_m": 1000.0}, "depth_unit_m must be above 0 and at most 1"),
        ({"rate_hz": np.nan}, "rate_hz must be above 0"),
        ({"up": [0, 0, 0]}, "up must be a finite direction"),
        ({"up": [0, np.inf, 0]}, "up must be a finite direction"),
        ({"rotation": np.eye(3)}, "place must be given with `rotation`"),
        ({"rotation": np.eye(3), "place": [0, 0]}, r"place must be of shape \(3,\)"),
        ({"rotation": 2 * np.eye(3), "place": [0, 0, 0]}, "rotation must be a rotation"),
        ({"rotation": np.eye(3), "place": [0, 0, 0], "up": [0, -1, 0]}, "up must be absent beside a pose"),
    ],
)
def test_what_is_no_camera_is_refused(changed: dict[str, Any], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        camera(**changed)


def test_images_of_another_size_or_kind_are_refused() -> None:
    for wrong in (np.zeros((8, 5), np.uint16), np.zeros((5, 8), np.bool_)):
        with pytest.raises(ParameterError, match="values must be numbers of shape"):
            camera().depths(wrong)
