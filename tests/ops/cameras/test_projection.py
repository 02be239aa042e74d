"""Projection into a camera and the rays of its pixels."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops.body.axisangle import matrices
from kinedex.ops.cameras.projection import camera_centre, distort, pixel_directions, project, undistort
from kinedex.ops.errors import ParameterError

MATRIX = np.array([[1681.244873, 0.0, 532.973694], [0.0, 1681.075440, 948.137390], [0.0, 0.0, 1.0]])
ROTATION = matrices(np.array([[1.68827548, 1.04832205, -0.41955852]]))[0]
TRANSLATION = np.array([0.32110489, 0.95633206, 2.89071305])

LENSES = {
    "none": [],
    "slight": [-0.0007, 0.0022, 9.5e-06, 1.08e-05],
    "barrel": [-0.3, 0.12, 0.001, -0.002, -0.02],
    "pincushion": [0.18, 0.05, -0.003, 0.002, 0.01],
    "rational": [0.6, -2.4, 0.0005, -0.0003, 1.4, 0.5, -2.2, 1.3],
}


def test_the_worked_example_has_this_centre_and_this_ray() -> None:
    centre = camera_centre(ROTATION, TRANSLATION)
    assert centre == pytest.approx([1.460232, -1.909159, 1.896506], abs=2e-6)
    direction = pixel_directions(MATRIX, ROTATION, [], [600.0, 1000.0])
    assert direction == pytest.approx([-0.674067, 0.620192, -0.401243], abs=1e-6)
    assert np.cross(centre, direction) == pytest.approx([-0.410162, -0.692464, -0.381276], abs=2e-6)


def test_a_point_on_the_axis_falls_on_the_principal_point_and_one_to_the_right_and_below_has_larger_pixels() -> None:
    matrix = np.array([[1000.0, 0, 640], [0, 900.0, 480], [0, 0, 1]])
    points = [[0, 0, 4.0], [1.0, 0, 4.0], [0, 1.0, 4.0], [0, 0, -4.0], [0, 0, 0]]
    pixels, depths = project(matrix, np.eye(3), np.zeros(3), [], points)
    assert pixels[:3].tolist() == [[640, 480], [890, 480], [640, 705]]
    assert depths.tolist() == [4, 4, 4, -4, 0]
    assert np.isnan(pixels[3:]).all(), "points behind the camera have no pixel"


@pytest.mark.parametrize("lens", LENSES)
def test_a_ray_of_a_pixel_projects_onto_the_pixel(lens: str) -> None:
    numbers = LENSES[lens]
    across, down = np.meshgrid(np.linspace(0, 1087, 23), np.linspace(0, 1919, 31))
    pixels = np.stack([across, down], axis=-1)
    directions = pixel_directions(MATRIX, ROTATION, numbers, pixels)
    assert np.linalg.norm(directions, axis=-1) == pytest.approx(1.0)
    points = camera_centre(ROTATION, TRANSLATION) + 3.7 * directions
    back, depths = project(MATRIX, ROTATION, TRANSLATION, numbers, points)
    assert (depths > 0).all()
    assert np.abs(back - pixels).max() < 1e-6


@given(
    st.tuples(*[st.floats(-0.05, 0.05)] * 2, *[st.floats(-0.002, 0.002)] * 2, st.floats(-0.05, 0.05)),
    st.tuples(*[st.floats(-0.6, 0.6)] * 2),
)
@settings(max_examples=60, deadline=None)
def test_undistorting_undoes_the_lens(numbers: tuple[float, ...], place: tuple[float, float]) -> None:
    plane = np.array([place])
    assert undistort(numbers, distort(numbers, plane)) == pytest.approx(plane, abs=1e-10)


def test_a_pixel_that_no_ray_falls_on_has_no_direction() -> None:
    barrel = [-0.3, 0, 0, 0]  # r (1 − 0.3 r²) never exceeds 0.703
    directions = pixel_directions([[1000, 0, 0], [0, 1000, 0], [0, 0, 1]], np.eye(3), barrel, [[690, 0], [720, 0]])
    assert np.isfinite(directions[0]).all()
    assert np.isnan(directions[1]).all()


def test_a_missing_pixel_has_no_direction() -> None:
    for numbers in ([], LENSES["barrel"]):
        directions = pixel_directions(MATRIX, ROTATION, numbers, np.array([[np.nan, np.nan], [600.0, 1000.0]]))
        assert np.isnan(directions[0]).all()
        assert np.isfinite(directions[1]).all()


def test_skew_moves_pixels_and_their_rays_alike() -> None:
    matrix = [[1000.0, 30.0, 640], [0, 1000.0, 480], [0, 0, 1]]
    pixels, _ = project(matrix, np.eye(3), np.zeros(3), [], [0.1, 0.2, 1.0])
    assert pixels.tolist() == pytest.approx([746, 680])
    assert pixel_directions(matrix, np.eye(3), [], pixels) == pytest.approx(np.array([0.1, 0.2, 1]) / np.sqrt(1.05))


@pytest.mark.parametrize("count", [1, 3, 6, 12])
def test_other_numbers_of_coefficients_are_refused(count: int) -> None:
    with pytest.raises(ParameterError, match="0, 4, 5 or 8 numbers"):
        project(MATRIX, ROTATION, TRANSLATION, np.full(count, 0.1), [0.0, 0.0, 1.0])
