"""The judgement of two takes: copies that were cut, moved, turned or mirrored, and other motions."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from kinedex.ops.duplicates.poses import TakePoses, local_poses
from kinedex.ops.duplicates.same_motion import NEAR_M, SameMotion, _distance, changes_of, same_motion
from tests.oracles.copies import distance

F32 = npt.NDArray[np.float32]
ROOT, LEFT, RIGHT = 0, 1, 2
NAMES = ["root", "lhip", "rhip", "lelbow", "relbow", "head"]


def motion(
    seed: int, seconds: float = 6.0, rate: float = 30.0, begin: float = 0.0, still: float = 1.0, pace: float = 1.0
) -> F32:
    """Return places (T, 6, 3) of a body that walks and waves by sums of sines, the same at every rate."""
    rng = np.random.default_rng(seed)
    t = begin + pace * np.arange(round(seconds * rate)) / rate
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


def mirror_image(positions: F32) -> F32:
    """Return the mirror image of a body; the left hand of the image is the right hand of the body."""
    image: F32 = positions[:, [0, 2, 1, 4, 3, 5]] * np.float32([-1, 1, 1])
    return image


def test_local_poses_do_not_depend_on_place_and_direction() -> None:
    positions = motion(1)
    assert np.allclose(poses(positions), poses(moved(positions, 2.0)), atol=1e-5)
    hips = poses(positions)[:, LEFT] - poses(positions)[:, RIGHT]
    assert np.allclose(hips[:, 2], 0, atol=1e-6)
    assert (hips[:, 0] > 0).all()


def test_local_poses_of_a_mirrored_body_are_those_of_the_body() -> None:
    positions = motion(2)
    image = mirror_image(positions)
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
    assert found.distance_m == pytest.approx(0.0, abs=1e-9)
    lacking[:] = np.nan
    assert same_motion(poses(whole), poses(lacking), 0, 30.0) is None


def test_takes_that_do_not_overlap_are_none() -> None:
    whole = poses(motion(14))
    assert same_motion(whole, whole, len(whole) + 5, 30.0) is None
    assert same_motion(whole, whole[:1], 3, 30.0) is None


coordinates = st.floats(-1, 1, width=32)


@given(
    arrays(np.float32, (5, 4, 3), elements=coordinates),
    arrays(np.float32, (3, 4, 3), elements=coordinates),
    st.floats(-1, 5),
    st.sets(st.integers(0, 3), max_size=2),
)
def test_the_distance_of_poses_is_that_of_the_twin(first: F32, second: F32, moment: float, unknown: set[int]) -> None:
    second[1, list(unknown)] = np.nan
    expected = distance(first.astype(float), second.astype(float), 1, moment)
    found = _distance(first, second, 1, moment)
    if moment < 0 or moment > 4:
        assert math.isnan(expected)
        assert math.isnan(found) or min(abs(moment), abs(moment - 4)) <= 0.02
    else:
        assert found == pytest.approx(expected, abs=2e-4)


changes = st.fixed_dictionaries(
    {
        "seed": st.integers(0, 10_000),
        "begin": st.floats(0.0, 2.5),
        "seconds": st.floats(1.5, 3.5),
        "rate": st.sampled_from([30.0, 25.0, 60.0, 120.0]),
        "pace": st.sampled_from([1.0, 1000 / 1001, 24 / 25, 25 / 24]),
        "noise": st.sampled_from([0.0, 0.001, 0.003]),
        "rounded": st.booleans(),
        "angle": st.floats(0.0, 6.0),
        "size": st.sampled_from([1.0, 0.85, 1.2]),
        "mirrored": st.booleans(),
    }
)


def copy_of(change: dict[str, Any]) -> F32:
    """Return the places at 30 frames a second of a copy with all changes together."""
    rate, pace = change["rate"], change["pace"]
    positions = moved(motion(change["seed"], change["seconds"], rate, change["begin"], pace=pace), change["angle"])
    positions = positions * np.float32(change["size"])
    if change["mirrored"]:
        positions = mirror_image(positions)
    positions += np.random.default_rng(change["seed"]).normal(0, change["noise"], positions.shape).astype(np.float32)
    if change["rounded"]:
        positions = np.round(positions, 3)
    at = np.arange(0, len(positions) - 1, rate / 30.0)  # as ingest samples it
    left = np.floor(at).astype(int)
    share = (at - left)[:, None, None]
    sampled: F32 = (positions[left] * (1 - share) + positions[left + 1] * share).astype(np.float32)
    return sampled


@given(changes)
@settings(max_examples=60, deadline=None)
def test_a_copy_with_any_changes_is_found_and_another_motion_is_not(change: dict[str, Any]) -> None:
    copy = TakePoses(copy_of(change), NAMES, change["mirrored"])
    whole, other = TakePoses(motion(change["seed"]), NAMES), TakePoses(motion(change["seed"] + 1), NAMES)
    shift = round(30 * change["begin"])
    pairs = [(whole.own, copy.own)] if whole.is_on_body_of(copy) else [(whole.on_ordinary_body, copy.on_ordinary_body)]
    (found,) = (same_motion(one, two, shift, 30.0) for one, two in pairs)
    assert found is not None
    assert found.stop - found.start >= 0.9 * len(copy.own)
    assert found.pace == pytest.approx(change["pace"], abs=0.02)
    assert found.shift == pytest.approx(30 * change["begin"] + (change["pace"] - 1) * found.start, abs=0.4)
    assert same_motion(other.own, copy.own, shift, 30.0) is None
    assert same_motion(other.on_ordinary_body, copy.on_ordinary_body, shift, 30.0) is None


def test_two_performances_of_a_motion_are_no_copies() -> None:
    once, again = motion(20), motion(20)
    again[:, 3:] += np.float32(0.008)  # eight millimetres, all the time
    assert same_motion(poses(once), poses(again), 0, 30.0) is None
    noisy = once + np.random.default_rng(0).normal(0, 0.003, once.shape).astype(np.float32)
    found = same_motion(poses(once), poses(noisy), 0, 30.0)
    assert found is not None  # five millimetres, another way in each frame
    assert found.distance_m > 0.004
    assert found.persisting_m < 0.002


def test_a_jump_of_the_motion_does_not_count_against_a_copy() -> None:
    glued = np.concatenate([motion(21, 3.0), motion(22, 3.0)])
    between = np.concatenate([motion(21, 2.99, begin=0.01), motion(22, 3.0, begin=0.01)])
    found = same_motion(poses(glued), poses(between), 0, 30.0)
    assert found is not None
    assert found.stop - found.start > 170


def test_an_alignment_without_near_poses_at_its_support_is_dropped() -> None:
    whole = poses(motion(23))
    assert same_motion(whole, whole[30:], 30, 30.0, support=(10, 20)) is not None
    assert same_motion(whole, whole[30:], 45, 30.0, support=(10, 20)) is None


def test_changes_in_time_are_named() -> None:
    def changes_at(start: int, stop: int, shift: float, pace: float, frames: int, others: int) -> list[str]:
        return changes_of(SameMotion(start, stop, shift, pace, 0.0, 0.0, 1.0, 0.2), frames, others)

    assert changes_at(0, 90, 0.0, 1.0, 90, 90) == []
    assert changes_at(0, 90, 31.0, 1.0, 90, 300) == ["trimmed"]
    assert changes_at(20, 70, -3.0, 1.0, 90, 300) == ["part"]
    assert changes_at(0, 90, 0.4, 1.0, 90, 90) == ["shifted"]
    assert changes_at(0, 90, 0.0, 25 / 24, 90, 94) == ["another clock"]
