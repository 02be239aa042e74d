"""Points of depth images: as the definitions give them, whatever the image, the stride and the frames before."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops.cameras.projection import distort
from kinedex.ops.depth.nearest_pixels import nearest_pixels
from kinedex.ops.depth.points import FrameCloud, Preparation, choose_stride, ray_table
from kinedex.ops.errors import ParameterError
from tests.ops.depth.depth_images import random_cloud, random_image
from tests.oracles import depth_points as oracle

MATRIX = np.array([[50.0, 0, 15.5], [0, 50.0, 11.5], [0, 0, 1]])


def assert_cloud(cloud: FrameCloud, depth: np.ndarray, rays: np.ndarray) -> None:
    rows, columns = np.nonzero(depth)
    z = depth[rows, columns]
    np.testing.assert_array_equal(cloud.pixels, np.stack([columns, rows], axis=1))
    np.testing.assert_array_equal(cloud.depth, depth)
    np.testing.assert_array_equal(cloud.numbers[rows, columns], np.arange(len(rows)))
    assert (cloud.numbers[depth == 0] == -1).all()
    expected = np.stack([z * rays[rows, columns, 0], -z * rays[rows, columns, 1], -z], axis=1)
    np.testing.assert_allclose(cloud.points, expected, atol=1e-15)
    box = (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1) if len(rows) else (0, 0, 0, 0)
    assert cloud.box == box


@settings(max_examples=40)
@given(seed=st.integers(0, 2**32 - 1))
def test_points_are_those_of_the_definition(seed: int) -> None:
    random = np.random.default_rng(seed)
    image, rays = random_image(seed)
    other = np.where(random.random(image.shape) < 0.8, image + random.choice([0.0, 0.05, 0.1, 0.3]), 0)
    background = None if seed % 3 == 0 else other.astype(np.float32)
    floor = None if seed % 2 else random.uniform(-0.4, -0.02)
    preparation = Preparation(rays, background, None, floor, 0.4, 1.7)
    kept = oracle.foreground(image, background, rays, floor, 0.4, 1.7)
    for depths in (random.permutation(image.ravel()).reshape(image.shape), image):  # nothing is left of a frame before
        cloud = preparation.prepare(depths)
    assert cloud.foreground == (kept > 0).sum()
    assert_cloud(cloud, oracle.cleaned(kept).astype(np.float32), rays)


def test_a_depth_at_the_limit_passes_as_the_definition_says() -> None:
    """All depths around the limits of a wall, in steps of float32."""
    wall = np.float32(2.0)
    z = np.float32((2.0 - 0.06) / 1.015)
    rays = np.zeros((5, 5, 2))
    for bits in range(-20, 21):
        depth = np.full((5, 5), (z.view(np.int32) + bits).view(np.float32))
        expected = oracle.foreground(depth, np.full((5, 5), wall), rays, None, 0.4, 8.0)
        assert Preparation(rays, np.full((5, 5), wall)).prepare(depth).foreground == (expected > 0).sum()


def test_what_was_not_measured_is_no_foreground() -> None:
    image = np.array([[np.nan, np.inf, -1.0], [0.0, 0.4, 8.0], [9.0, 1e30, 0.3]], np.float32)
    assert Preparation(np.zeros((3, 3, 2))).prepare(image).foreground == 1  # 0.4 in float32 is above 0.4


def test_a_pixel_that_no_ray_falls_on_is_no_foreground() -> None:
    rays = np.zeros((5, 5, 2))
    rays[0] = np.nan
    assert Preparation(rays).prepare(np.full((5, 5), 2.0, np.float32)).foreground == 20


def test_every_other_pixel_is_used_at_stride_two() -> None:
    image = np.random.default_rng(1).uniform(1.0, 1.01, (23, 31)).astype(np.float32)
    rays, small = ray_table(MATRIX, (), (31, 23)), ray_table(MATRIX, (), (31, 23), 2)
    np.testing.assert_array_equal(small, rays[::2, ::2])
    cloud = Preparation(small, stride=2).prepare(image)
    assert_cloud(cloud, oracle.cleaned(image[::2, ::2].astype(np.float64)).astype(np.float32), small)


def test_a_lens_is_undone() -> None:
    numbers = (-0.2, 0.05, 0.001, -0.002)
    rays = ray_table(MATRIX, numbers, (32, 24))
    pixels = distort(numbers, rays) @ MATRIX[:2, :2].T + MATRIX[:2, 2]
    np.testing.assert_allclose(pixels, np.stack(np.meshgrid(np.arange(32), np.arange(24)), axis=-1), atol=1e-9)


def test_a_tilted_camera_gives_the_same_points_turned() -> None:
    image, rays = random_image(5)
    angle = 0.4
    turn = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
    level, tilted = Preparation(rays).prepare(image), Preparation(rays, None, turn).prepare(image)
    np.testing.assert_allclose(tilted.points, level.points @ turn.T, atol=1e-12)


def test_the_stride_brings_the_median_frame_below_the_most_points() -> None:
    images = [np.full((24, 32), depth, np.float32) for depth in (1.0, 1.0, 9.0)]
    assert choose_stride(images, MATRIX) == 1
    inner = 24 * 32 - 4
    assert choose_stride(images, MATRIX, most=inner) == 1
    assert choose_stride(images, MATRIX, most=inner - 1) == 2
    assert choose_stride([], MATRIX) == 1


def test_an_image_of_another_size_is_refused() -> None:
    with pytest.raises(ParameterError, match=r"image must be of shape \(24, 32\) at stride 1, got \(24, 31\)"):
        Preparation(ray_table(MATRIX, (), (32, 24))).prepare(np.zeros((24, 31), np.float32))


def test_a_floor_above_the_camera_is_refused() -> None:
    with pytest.raises(ParameterError, match=r"floor_height must be below −0.01, .* got 1.1"):
        Preparation(ray_table(MATRIX, (), (32, 24)), floor_height=1.1)


@settings(max_examples=25)
@given(seed=st.integers(0, 2**32 - 1))
def test_nearest_pixels_are_the_nearest(seed: int) -> None:
    cloud = random_cloud(seed)
    nearest, (left, top, right, bottom) = nearest_pixels(cloud.numbers, cloud.box, cloud.buffers), cloud.box
    for v in range(top, bottom):
        for u in range(left, right):
            assert nearest[v, u] == oracle.nearest(cloud.pixels, u, v)
    outside = np.ones(nearest.shape, bool)
    outside[top:bottom, left:right] = False
    assert (nearest[outside] == -1).all()
