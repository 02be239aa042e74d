"""Contours of capsules: the worked example, the twin that samples the surface, and boundaries that are found."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops.arrays import F64
from kinedex.ops.body.capsules import Capsules
from kinedex.ops.errors import ParameterError
from kinedex.ops.tracking.contours import add_contours, contour_buffers, contour_normals, contour_sums, find_contours
from kinedex.ops.tracking.views import View, camera_view, mask_pixel, render_mask
from tests.ops.tracking.scene import CAPSULES, JOINTS, cameras, looking_at
from tests.oracles import contours as oracle

POSE = np.ascontiguousarray(JOINTS[:, :, 0])
ONE, OTHER = np.array([0.0, 1.0, 0.0]), np.array([0.3, 1.4, 0.2])


def contour_points(one: F64, other: F64, radius: float, centre: F64, share: float) -> F64:
    """Return the two contour points of a capsule at a position on its axis."""
    normals = np.empty((2, 3))
    if not contour_normals(one, other, radius, centre, share, normals):
        return np.full((2, 3), np.nan)
    return one + share * (other - one) + radius * normals


def constant(mask: np.ndarray) -> np.ndarray:
    """Make a mask read-only, as those of files are: the kernels are compiled for these."""
    mask.flags.writeable = False
    return mask


def mask_of(joints: np.ndarray, view: View, capsules: Capsules = CAPSULES) -> np.ndarray:
    return constant(render_mask(capsules, joints, view).view(np.uint8) * np.uint8(255))


def test_the_worked_example() -> None:
    found = contour_points(ONE, OTHER, 0.1, np.array([2, 2.2, 3.5]), 0.4)
    np.testing.assert_allclose(found, [(0.03747, 1.20452, 0.11475), (0.20299, 1.11177, 0.05197)], atol=5e-6)


@settings(max_examples=5)
@given(seed=st.integers(0, 2**32 - 1))
def test_contour_points_are_those_of_the_sampled_surface(seed: int) -> None:
    random = np.random.default_rng(seed)
    one, other, centre = random.normal(0, 0.5, (3, 3))
    centre *= 6
    expected = oracle.contour(one, other, 0.07, centre, 5)
    for share, points in zip(np.linspace(0, 1, 5), expected, strict=True):
        found = contour_points(one, other, 0.07, centre, share)
        if len(points) != 2:
            assert np.isnan(found).all()
            continue
        apart = np.sqrt(((found[:, None] - points) ** 2).sum(axis=2))
        assert apart.min(axis=1).max() < 1e-4


def test_a_camera_inside_the_cylinder_sees_no_contour() -> None:
    assert np.isnan(contour_points(ONE, OTHER, 0.1, ONE - 2 * (OTHER - ONE), 0.4)).all()
    assert np.isnan(contour_points(ONE, ONE, 0.1, np.array([2.0, 2, 2]), 0.4)).all()


@pytest.mark.parametrize("distortion", [(), (-0.12, 0.05, 0.001, -0.002)])
@pytest.mark.parametrize("share", [1, 2])
def test_contours_of_the_true_pose_lie_on_the_boundary(share: int, distortion: tuple[float, ...]) -> None:
    for view in cameras(2, share=share, distortion=distortion):
        found = contour_buffers(CAPSULES, POSE)
        count, visible = find_contours(view, mask_of(POSE, view), POSE, CAPSULES, found)
        assert count > 100
        assert count == visible
        # the boundary of the raster is half a pixel of the mask off at most, and further where it is not smooth
        assert np.quantile(np.abs(found.shifts[:count]), 0.9) < 0.75 * share
        assert abs(found.shifts[:count].mean()) < 0.25 * share
        to = found.points[:count] - view.centre
        along = np.einsum("ni,ni->n", to, found.directions[:count])
        apart = np.sqrt(((to - along[:, None] * found.directions[:count]) ** 2).sum(axis=1))
        pixels = apart * view.matrix[0, 0] / along
        assert np.quantile(np.abs(pixels - np.abs(found.shifts[:count])), 0.9) < 0.2


def test_the_boundary_of_a_probability_is_a_half() -> None:
    (view,) = cameras(1)
    column, _ = mask_pixel(view, *(view.rotation @ POSE[0] + view.translation)[:2] / 4.7)
    ramp = np.clip(127.5 - 4 * (np.arange(640) - column - 30), 0, 255)
    mask = constant(np.broadcast_to(ramp, (480, 640)).astype(np.uint8, order="C"))
    found = contour_buffers(CAPSULES, POSE)
    count, _ = find_contours(view, mask, POSE, CAPSULES, found)
    assert count > 30
    seen = found.directions[:count] @ view.rotation.T
    columns = [mask_pixel(view, x, y)[0] for x, y in seen[:, :2] / seen[:, 2:]]
    np.testing.assert_allclose(columns, column + 30, atol=0.2)


def test_masks_without_a_boundary_within_reach_give_nothing() -> None:
    (view,) = cameras(1)
    found = contour_buffers(CAPSULES, POSE)
    mask = mask_of(POSE, view)
    for empty in (np.zeros_like(mask), np.full_like(mask, 255), np.roll(mask, 200, axis=1)):
        assert find_contours(view, constant(empty), POSE, CAPSULES, found)[0] == 0
    behind = POSE + 3 * (view.centre - POSE)
    assert find_contours(view, mask, behind, CAPSULES, found)[0] == 0


def test_the_sums_of_a_camera_are_the_squares_of_its_correspondences() -> None:
    (view,) = cameras(1)
    moved = POSE + np.array([-0.016, 0.0, 0.037])  # across the view
    found = contour_buffers(CAPSULES, POSE)
    count, _ = find_contours(view, mask_of(POSE, view), moved, CAPSULES, found)
    sums = contour_sums(CAPSULES, len(POSE))
    cost = add_contours(view, found, count, sums)

    def squares(moves: np.ndarray) -> float:
        """Return the squares after moves (J, 3) of the joints."""
        total = 0.0
        for c in range(count):
            n, y, s = found.directions[c], found.points[c], found.shares[c]
            start, end = (ends[found.capsules[c]] for ends in (CAPSULES.starts, CAPSULES.ends))
            depth = (y - view.centre) @ n
            apart = y + (1 - s) * moves[start] + s * moves[end] - view.centre
            apart = apart - (apart @ n) * n
            total += 0.15 * (apart @ apart) * (view.matrix[0, 0] / depth / 3) ** 2
        return total

    assert cost == pytest.approx(squares(np.zeros_like(POSE)))
    moves = np.random.default_rng(1).normal(0, 0.02, POSE.shape)
    expected = cost + 2 * (sums.vectors * moves).sum() + np.einsum("ji,jik,jk->", moves, sums.matrices, moves)
    expected += 2 * np.einsum("ni,nik,nk->", moves[CAPSULES.starts], sums.mixed, moves[CAPSULES.ends])
    assert expected == pytest.approx(squares(moves))
    assert squares(np.full_like(POSE, POSE - moved)) < 0.5 * cost


def test_masks_are_exact_at_every_pixel() -> None:
    capsule = Capsules(np.array([0]), np.array([1]), np.array([0.1]))
    joints = np.stack([ONE, OTHER])
    rotation, translation = looking_at(np.array([0.8, 1.5, 1.0]), ONE)
    matrix = [[60.0, 0, 32], [0, 60, 24], [0, 0, 1]]
    for distortion in ((), (-0.2, 0.08, 0.01, -0.01)):
        view = camera_view(matrix, rotation, translation, distortion, (64, 48))
        mask = render_mask(capsule, joints, view)
        seen = joints @ rotation.T + translation
        rays = np.concatenate([view.plane, np.ones((48, 64, 1))], axis=2)
        expected = [[oracle.hits(*seen, 0.1, ray) for ray in row] for row in rays]
        assert 60 < mask.sum() < 2000
        assert (mask != np.array(expected)).sum() == 0


def test_a_body_around_or_behind_the_camera_is_drawn_as_it_is() -> None:
    rotation, translation = looking_at(np.array([0.0, 1.0, 3.0]), np.array([0.0, 1.0, 0.0]))
    view = camera_view([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]], rotation, translation, [], (64, 48))
    assert not render_mask(CAPSULES, POSE + np.array([0, 0, 4.0]), view).any()
    assert render_mask(CAPSULES, POSE + np.array([0, 0, 2.9]), view).mean() > 0.3
    assert render_mask(CAPSULES, POSE, view).any()
    assert not render_mask(CAPSULES, np.full_like(POSE, np.nan), view).any()
    with pytest.raises(ParameterError, match=r"joints must be of shape \(J, 3\)"):
        render_mask(CAPSULES, POSE[:5], view)


def test_masks_are_a_whole_fraction_of_the_image() -> None:
    with pytest.raises(ParameterError, match="mask_size must be 640 × 480 or a whole fraction of it, got '400 × 300'"):
        camera_view(np.eye(3), np.eye(3), np.zeros(3), [], (640, 480), (400, 300))
    half, whole = cameras(1, share=2)[0], cameras(1)[0]
    # a pixel of the smaller mask lies in the middle of four
    np.testing.assert_allclose(half.plane[10, 20], whole.plane[20:22, 40:42].mean(axis=(0, 1)), rtol=1e-4)
    assert half.reach == 0.5 * whole.reach == 12
