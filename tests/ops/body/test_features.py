"""Features: each of the forty turned on and off by a body built by hand, and the naive twin on random motion."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.catalog.features import load_feature_set
from kinedex.ops.body import features
from kinedex.ops.body.features import BLOCK
from kinedex.ops.errors import ParameterError
from kinedex.ops.words import NO_WORD
from tests.bodies import index, standing, turned, upright, x_axes
from tests.oracles import features as oracle

RATE = 30.0
FEATURES = load_feature_set()
HUMERUS = float(np.linalg.norm([0.05, 0.3, 0.0]))


def words(positions: np.ndarray, orientation: np.ndarray | None = None, rate: float = RATE) -> np.ndarray:
    if orientation is None:
        orientation = upright(positions.shape[2])
    return features.words(positions, orientation, rate, FEATURES.rules)


def is_on(number: int, positions: np.ndarray, orientation: np.ndarray | None = None) -> list[bool]:
    return [bool(word >> (number - 1) & 1) for word in words(positions, orientation).tolist()]


def place(joint: str, offset: Callable[[float], tuple[float, float, float]], levels: list[float]) -> np.ndarray:
    """The standing figure with one joint moved, frame by frame, by what a level stands for."""
    body = standing(len(levels))
    for t, level in enumerate(levels):
        body[index(joint), :, t] += offset(level)
    return body


def sway(joint: str, direction: tuple[float, float, float], speeds: list[float]) -> np.ndarray:
    """The standing figure with one joint moving at these speeds (metres a second), a second each."""
    steps = np.repeat(speeds, int(RATE)) / RATE
    body = standing(len(steps))
    body[index(joint)] += np.array(direction)[:, None] * np.concatenate([[0], np.cumsum(steps[:-1])])
    return body


def middles(values: list[bool], parts: int) -> list[bool]:
    size = len(values) // parts
    return [values[i * size + size // 2] for i in range(parts)]


@pytest.mark.parametrize(("number", "joint"), [(3, "rwrist"), (4, "lwrist")])
def test_a_hand_is_above_the_neck_from_a_fifth_of_the_chest_up_and_until_it_sinks_below_the_neck(
    number: int, joint: str
) -> None:
    body = standing(6)
    body[index(joint), 1] = [1.0, 1.48, 1.50, 1.46, 1.44, 1.46]
    assert is_on(number, body) == [False, False, True, True, False, False]


@pytest.mark.parametrize(("number", "side"), [(7, "r"), (8, "l"), (20, "rleg"), (21, "lleg")])
def test_a_joint_is_bent_at_110_degrees_and_until_120(number: int, side: str) -> None:
    upper, middle, lower = ("hip", "knee", "ankle") if "leg" in side else ("shoulder", "elbow", "wrist")
    body = standing(5)
    joint = body[index(side[0] + middle), :, 0]
    body[index(side[0] + upper)] = (joint + np.array([0, 0.4, 0]))[:, None]
    for t, degrees in enumerate([150, 115, 109, 119, 121]):
        angle = np.deg2rad(degrees)
        body[index(side[0] + lower), :, t] = joint + 0.3 * np.array([0, np.cos(angle), np.sin(angle)])
    assert is_on(number, body) == [False, False, True, True, False]


def test_hands_are_far_apart_from_two_and_a_half_shoulder_widths() -> None:
    body = standing(5)
    for t, width in enumerate([0.8, 0.9, 1.02, 0.85, 0.78]):
        body[index("lwrist"), 0, t], body[index("rwrist"), 0, t] = width / 2, -width / 2
    assert is_on(9, body) == [False, False, True, True, False]


@pytest.mark.parametrize(
    ("number", "joint", "direction", "limb", "weak", "strong"),
    [
        (1, "rwrist", (0, 0, 1), HUMERUS, 1.3, 1.8),
        (2, "lwrist", (0, 0, 1), HUMERUS, 1.3, 1.8),
        (5, "rwrist", (0, 1, 0), HUMERUS, 1.3, 1.8),
        (6, "lwrist", (0, 1, 0), HUMERUS, 1.3, 1.8),
        (10, "lwrist", (-1, 0, 0), HUMERUS, 1.2, 1.4),
        (13, "rfingers", (0, 0, 1), HUMERUS, 2.0, 2.5),
        (14, "lfingers", (1, 0, 0), HUMERUS, 2.0, 2.5),
        (23, "lankle", (-1, 0, 0), HUMERUS, 1.3, 1.5),
        (24, "lankle", (1, 0, 0), HUMERUS, 1.3, 1.5),
        (39, "root", (0, 0, 1), HUMERUS, 2.0, 2.3),
    ],
)
def test_a_speed_turns_its_feature_on_at_the_strong_and_off_below_the_weak_threshold(
    number: int, joint: str, direction: tuple[float, float, float], limb: float, weak: float, strong: float
) -> None:
    between, slow, fast = (weak + strong) / 2, weak * 0.8, strong * 1.1
    speeds = [slow, between, fast, between, slow]
    body = sway(joint, direction, [speed * limb for speed in speeds])
    if number == 10:
        body[index("lwrist"), 0] += 5.0
        body[index("lwrist"), 1:] = body[index("rwrist"), 1:]
    assert middles(is_on(number, body), 5) == [False, False, True, True, False]


@pytest.mark.parametrize(("number", "side"), [(11, "r"), (12, "l")])
def test_a_hand_moves_away_from_the_root(number: int, side: str) -> None:
    body = sway(f"{side}wrist", (0, 0, 1), [0.0, 1.3 * HUMERUS, 1.6 * HUMERUS, 1.3 * HUMERUS, 0.5 * HUMERUS])
    body[index(f"{side}wrist"), :2] = body[index("root"), :2]
    assert middles(is_on(number, body), 5) == [False, False, True, True, False]


@pytest.mark.parametrize(("number", "side"), [(25, "r"), (26, "l")])
def test_a_foot_is_fast_only_when_ankle_and_toes_both_are(number: int, side: str) -> None:
    speeds = [speed * HUMERUS for speed in [1.8, 2.2, 2.7, 2.2, 1.8]]
    body = sway(f"{side}toes", (0, 0, 1), speeds)
    assert not any(is_on(number, body))
    body[index(f"{side}ankle")] += body[index(f"{side}toes")] - standing(1)[index(f"{side}toes")]
    assert middles(is_on(number, body), 5) == [False, False, True, True, False]


def test_the_right_foot_is_behind_the_left_leg() -> None:
    levels = [0.2, -0.05, -0.13, -0.05, 0.05]
    assert is_on(15, place("rankle", lambda z: (0, 0, z), levels)) == [False, False, True, True, False]


def test_the_left_foot_is_behind_the_right_leg() -> None:
    levels = [0.2, -0.05, -0.13, -0.05, 0.05]
    assert is_on(16, place("lankle", lambda z: (0, 0, z), levels)) == [False, False, True, True, False]


@pytest.mark.parametrize(("number", "joint"), [(17, "rtoes"), (18, "ltoes")])
def test_a_foot_is_raised_by_its_toes_above_the_lowest_joint(number: int, joint: str) -> None:
    levels = [0.2, 1.1 * HUMERUS, 1.25 * HUMERUS, 1.05 * HUMERUS, 0.9 * HUMERUS]
    assert is_on(number, place(joint, lambda y: (0, y, 0), levels)) == [False, False, True, True, False]


def test_feet_are_far_apart_sideways() -> None:
    levels = [width * HUMERUS - 0.2 for width in [1.0, 1.9, 2.2, 1.9, 1.7]]
    assert is_on(19, place("lankle", lambda x: (x, 0, 0), levels)) == [False, False, True, True, False]


def test_feet_are_crossed_over() -> None:
    # the ankles are 0.2 apart; past each other by an eighth of the hips' width (0.2) counts
    levels = [0.0, -0.21, -0.24, -0.21, -0.19]
    assert is_on(22, place("lankle", lambda x: (x, 0, 0), levels)) == [False, False, True, True, False]


@pytest.mark.parametrize(("number", "side", "sign"), [(27, "r", -1), (28, "l", 1)])
def test_an_upper_arm_is_abducted_below_150_degrees_to_the_spine(number: int, side: str, sign: int) -> None:
    body = standing(5)
    for t, degrees in enumerate([170, 152, 149, 154, 156]):
        angle = np.deg2rad(degrees)
        arm = 0.3 * np.array([sign * np.sin(angle), np.cos(angle), 0])
        body[index(f"{side}elbow"), :, t] = body[index(f"{side}shoulder"), :, t] + arm
    assert is_on(number, body) == [False, False, True, True, False]


@pytest.mark.parametrize(("number", "side"), [(29, "r"), (30, "l")])
def test_a_thigh_is_abducted_above_50_degrees_to_the_spine(number: int, side: str) -> None:
    body = standing(5)
    for t, degrees in enumerate([10, 47, 51, 46, 44]):
        angle = np.deg2rad(degrees)
        thigh = 0.45 * np.array([0, np.cos(angle), -np.sin(angle)])
        body[index(f"{side}knee"), :, t] = body[index(f"{side}hip"), :, t] - thigh
    assert is_on(number, body) == [False, False, True, True, False]


def test_the_root_is_behind_the_frontal_plane_when_the_neck_leans_forwards() -> None:
    body = standing(5)
    for t, z in enumerate([0.0, -0.13, -0.16, -0.12, -0.1]):
        body[index("root"), 2, t] = z
    assert is_on(31, body) == [False, False, True, True, False]


def test_the_spine_is_horizontal_from_70_and_until_60_degrees() -> None:
    body = standing(6)
    for t, degrees in enumerate([0, 65, 90, 62, 59, 119]):
        angle = np.deg2rad(degrees)
        body[index("neck"), :, t] = body[index("root"), :, t] + 0.45 * np.array([0, np.cos(angle), np.sin(angle)])
    assert is_on(32, body) == [False, False, True, True, False, False]


@pytest.mark.parametrize(("number", "side"), [(33, "r"), (34, "l")])
def test_a_hand_is_lowered_whatever_its_own_wrist_and_fingers_do_to_the_floor(number: int, side: str) -> None:
    body = standing(5)
    body[index(f"{side}fingers"), 1] = [level * HUMERUS for level in [2.0, 1.3, 1.1, 1.3, 1.5]]
    assert is_on(number, body) == [False, False, True, True, False]
    body[index(f"{side}fingers"), 1, 0] = -1.0
    assert is_on(number, body)[0]


@pytest.mark.parametrize(("number", "sign"), [(35, 1), (36, -1)])
def test_shoulders_are_rotated_against_the_plane_of_hips_and_neck(number: int, sign: int) -> None:
    body = standing(5)
    for t, level in enumerate([0.1, 0.37, 0.42, 0.36, 0.3]):
        body[index("lshoulder"), 2, t] = sign * level * HUMERUS / 2
        body[index("rshoulder"), 2, t] = -sign * level * HUMERUS / 2
    # The left shoulder moves the left humerus; its length is taken in frame 0 only.
    humerus_l = np.linalg.norm(body[index("lshoulder"), :, 0] - body[index("lelbow"), :, 0])
    assert humerus_l == pytest.approx(HUMERUS, rel=0.01)
    assert is_on(number, body) == [False, False, True, True, False]


def test_the_body_is_low_when_it_extends_over_less_than_four_fifths_of_its_size() -> None:
    size = sum(
        np.linalg.norm(standing(1)[index(a), :, 0] - standing(1)[index(b), :, 0])
        for a, b in ["rankle rknee".split(), "rknee rhip".split(), "root belly".split(), "belly chest".split(),
                     "chest neck".split(), "neck head".split(), "head headtop".split()]
    )  # fmt: skip
    body = standing(5)
    for t, share in enumerate([1.0, 0.85, 0.78, 0.85, 0.95]):
        body[:, 1, t] *= share * size / 1.75 if t else 1.0
    assert is_on(37, body) == [False, False, True, True, False]


def test_the_body_is_wide_when_any_of_six_joints_are_far_apart_in_the_plane() -> None:
    levels = [0.0, 3.1 * HUMERUS, 3.3 * HUMERUS, 3.1 * HUMERUS, 2.8 * HUMERUS]
    assert is_on(38, place("headtop", lambda z: (0, 0, z), levels))[:3] == [False, False, True]
    assert not any(is_on(38, place("lknee", lambda z: (0, 0, z), levels)))


def test_the_root_turns_about_the_upward_axis() -> None:
    rates = np.repeat([20.0, 80.0, 130.0, 80.0, 20.0], 10)
    angles = np.concatenate([[0], np.cumsum(rates[:-1] / RATE)])
    on = is_on(40, standing(len(angles)), turned(angles))
    assert middles(on, 5) == [False, False, True, True, False]
    assert not on[-1]


def test_one_frame_has_no_velocity_and_no_turn() -> None:
    moving = [1, 2, 5, 6, 10, 11, 12, 13, 14, 23, 24, 25, 26, 39, 40]
    word = int(words(standing(1))[0])
    assert all(not word >> (number - 1) & 1 for number in moving)


def test_an_unknown_joint_switches_its_features_off_and_leaves_the_others() -> None:
    body = standing(4)
    body[index("rwrist")] = np.nan
    body[index("lwrist"), 1] = 1.6
    word = int(words(body)[0])
    assert word >> 3 & 1
    assert not word >> 2 & 1
    assert int(words(standing(4))[0]) & 1 << 36 == word & 1 << 36


def test_a_limb_of_no_length_switches_its_feature_off() -> None:
    body = standing(3)
    body[index("relbow")] = body[index("rshoulder")]
    assert not any(is_on(7, body))


@settings(max_examples=40, deadline=None)
@given(
    frames=st.integers(1, 60),
    rate=st.sampled_from([30.0, 60.0, 120.0]),
    seed=st.integers(0, 2**32 - 1),
    restless=st.floats(0.0, 0.2),
)
def test_random_motion_has_the_words_of_the_naive_twin(frames: int, rate: float, seed: int, restless: float) -> None:
    random = np.random.default_rng(seed)
    walk = np.cumsum(random.normal(0, restless, (24, 3, frames)), axis=2)
    positions = standing(frames) + walk + random.normal(0, 0.2, (24, 3, 1))
    orientation = random.normal(0, 1, (4, 1)) + np.cumsum(random.normal(0, 0.05, (4, frames)), axis=1)
    orientation /= np.linalg.norm(orientation, axis=0)
    naive = oracle.Body(positions, x_axes(orientation), rate)
    # A quantity that rounding alone decides may fall on either side.
    if np.nanmin(oracle.margins(naive)) > 1e-9:
        assert words(positions, orientation, rate).tolist() == oracle.words(naive)


@pytest.mark.parametrize("frames", [BLOCK - 1, BLOCK, BLOCK + 1, 2 * BLOCK + 30])
def test_takes_of_several_blocks_have_the_words_of_the_naive_twin(frames: int) -> None:
    random = np.random.default_rng(frames)
    positions = standing(frames) + np.cumsum(random.normal(0, 0.02, (24, 3, frames)), axis=2)
    orientation = turned(np.cumsum(random.normal(0, 4, frames)))
    naive = oracle.Body(positions, x_axes(orientation), 120.0)
    assert np.nanmin(oracle.margins(naive)) > 1e-9
    expected = oracle.words(naive)
    assert sum(word > 0 for word in expected) > 0
    assert words(positions, orientation, 120.0).tolist() == expected


def test_the_least_of_several_speeds_is_unknown_where_one_is() -> None:
    body = sway("rtoes", (0, 0, 1), [3.0 * HUMERUS] * 3)
    body[index("rankle")] += body[index("rtoes")] - standing(1)[index("rtoes")]
    assert is_on(25, body)[45]
    for joint in ("rankle", "rtoes"):
        unknown = body.copy()
        unknown[index(joint), :, 40:50] = np.nan
        assert not is_on(25, unknown)[45]
        assert is_on(25, unknown)[70]


def test_an_invalid_stretch_has_no_word_and_cuts_the_take() -> None:
    random = np.random.default_rng(5)
    positions = standing(60) + np.cumsum(random.normal(0, 0.05, (24, 3, 60)), axis=2)
    orientation = turned(np.cumsum(random.normal(0, 9, 60)))
    valid = np.ones(60, bool)
    valid[[0, 1, 20, 21, 22, 59]] = False
    positions[3, :, ~valid] = np.nan
    found = features.words(positions, orientation, RATE, FEATURES.rules, valid)
    assert (found == NO_WORD).tolist() == (~valid).tolist()
    # the stretch that begins the measuring stands for itself
    alone = features.words(positions[:, :, 2:20], orientation[:, 2:20], RATE, FEATURES.rules)
    assert found[2:20].tolist() == alone.tolist()
    # later stretches take the limb lengths of the first valid frame
    long = positions.copy()
    long[:, :, 23:59] *= 2.0
    doubled = features.words(long, orientation, RATE, FEATURES.rules, valid)
    assert doubled[2:20].tolist() == found[2:20].tolist()
    assert doubled[23:59].tolist() != found[23:59].tolist()


def test_a_take_without_a_valid_frame_has_no_words() -> None:
    found = features.words(standing(3), upright(3), RATE, FEATURES.rules, np.zeros(3, bool))
    assert (found == NO_WORD).all()


@pytest.mark.parametrize(
    ("shape", "rate", "message"),
    [((24, 2, 5), 30.0, "positions must be"), ((24, 3, 5), 0.0, "rate_hz must be"), ((24, 3, 4), 30.0, "orientation")],
)
def test_wrong_shapes_and_rates_are_refused(shape: tuple[int, ...], rate: float, message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        features.words(np.zeros(shape), upright(5), rate, FEATURES.rules)


def test_a_window_is_counted_free_of_float_noise() -> None:
    assert [features.window_samples(w, r) for w, r in [(250, 120), (100, 120), (100, 30), (0, 120), (250, 30)]] == [
        30, 12, 3, 1, 8,
    ]  # fmt: skip
