"""The judgement of two takes: copies that were cut, moved, turned or mirrored, and other motions."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from kinedex.ops.duplicates.same_motion import NEAR_M, local_poses, same_motion

F32 = npt.NDArray[np.float32]
ROOT, LEFT, RIGHT = 0, 1, 2


def motion(seed: int, seconds: float = 6.0, rate: float = 30.0, begin: float = 0.0, still: float = 1.0) -> F32:
    """Return places (T, 6, 3) of a body that walks and waves by sums of sines, the same at every rate."""
    rng = np.random.default_rng(seed)
    t = begin + np.arange(round(seconds * rate)) / rate
    rest = np.array([[0, 1, 0], [0.1, 0.9, 0], [-0.1, 0.9, 0], [0.5, 1.4, 0], [-0.5, 1.4, 0], [0, 1.7, 0]])
    positions = np.broadcast_to(rest, (len(t), 6, 3)).copy()
    for _ in range(4):
        phase, speed = rng.uniform(0, 6, (3, 3)), rng.uniform(1, 9, (3, 3))
        positions[:, 3:] += still * 0.1 * np.sin(speed * t[:, None, None] + phase)
    heading = 0.8 * np.sin(0.7 * t)
    turn = np.stack(
        [np.cos(heading), 0 * t, np.sin(heading), 0 * t, 1 + 0 * t, 0 * t, -np.sin(heading), 0 * t, np.cos(heading)]
    )
    positions = np.einsum("tab,tjb->tja", turn.T.reshape(-1, 3, 3), positions)
    positions[:, :, 2] += t[:, None]
    return positions.astype(np.float32)


def poses(positions: F32, *, mirrored: bool = False) -> F32:
    return local_poses(positions, ROOT, LEFT, RIGHT, mirrored=mirrored)


def moved(positions: F32, angle: float) -> F32:
    """Return the places turned about the vertical axis, and put elsewhere."""
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    return (positions @ turn.T + np.array([3.0, -0.4, 7.0])).astype(np.float32)


def test_local_poses_do_not_depend_on_place_and_direction() -> None:
    positions = motion(1)
    assert np.allclose(poses(positions), poses(moved(positions, 2.0)), atol=1e-5)
    hips = poses(positions)[:, LEFT] - poses(positions)[:, RIGHT]
    assert np.allclose(hips[:, 2], 0, atol=1e-6)
    assert (hips[:, 0] > 0).all()


def test_local_poses_of_a_mirrored_body_are_those_of_the_body() -> None:
    positions = motion(2)
    image = positions.copy()
    image[..., 0] *= -1
    image = image[:, [0, 2, 1, 4, 3, 5]]  # the left hand of the image is the right hand of the body
    assert np.allclose(poses(image[:, [0, 2, 1, 4, 3, 5]], mirrored=True), poses(positions), atol=1e-5)


@pytest.mark.parametrize("begin", [0.0, 0.5, 0.513, 0.7777])
@pytest.mark.parametrize("angle", [0.0, 1.3])
def test_a_cut_is_found_between_frames(begin: float, angle: float) -> None:
    whole, cut = motion(3), moved(motion(3, 3.0, begin=begin), angle)
    found = same_motion(poses(whole), poses(cut), round(30 * begin), 30.0)
    assert found is not None
    assert (found.start, found.stop) == (0, 90)
    assert found.shift == pytest.approx(30 * begin, abs=0.02)
    assert found.distance_m < 0.001


def test_a_part_in_common_has_its_range() -> None:
    one = np.concatenate([motion(4, 4.0), motion(5, 2.0)])
    two = np.concatenate([motion(6, 1.0), motion(4, 3.0, begin=1.0)])
    found = same_motion(poses(one), poses(two), 0, 30.0)
    assert found is not None
    assert (found.start, found.stop) == (30, 120)


def test_another_motion_is_none() -> None:
    assert same_motion(poses(motion(7)), poses(motion(8)), 0, 30.0) is None


def test_a_body_that_stands_is_not_every_body_that_stands() -> None:
    one, other = motion(9, still=0.01), motion(10, still=0.01)
    distance = np.linalg.norm(poses(one) - poses(other), axis=2).mean()
    assert distance < NEAR_M  # the poses alone could be one
    assert same_motion(poses(one), poses(other), 0, 30.0) is None
    assert same_motion(poses(one), poses(one.copy()), 0, 30.0) is not None


def test_short_intervals_count_only_as_nearly_all_of_a_take() -> None:
    whole = motion(11)
    assert same_motion(poses(whole), poses(whole[60:75]), 60, 30.0) is not None
    other = np.concatenate([whole[60:75], motion(12, 2.0)])
    assert same_motion(poses(whole), poses(other), 60, 30.0) is None


def test_joints_without_a_place_do_not_count() -> None:
    whole = motion(13)
    lacking = whole.copy()
    lacking[:, 4] = np.nan
    found = same_motion(poses(whole), poses(lacking), 0, 30.0)
    assert found is not None
    assert found.distance_m == 0.0
    lacking[:] = np.nan
    assert same_motion(poses(whole), poses(lacking), 0, 30.0) is None


def test_takes_that_do_not_overlap_are_none() -> None:
    whole = poses(motion(14))
    assert same_motion(whole, whole, len(whole) + 5, 30.0) is None
    assert same_motion(whole, whole[:1], 3, 30.0) is None
