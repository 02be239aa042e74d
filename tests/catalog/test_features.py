"""The shipped features in the mirror, and the errors about wrong pairs."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.catalog.configs import config_path
from kinedex.catalog.features import FeatureSet, load_feature_set
from kinedex.ops.body import features
from kinedex.ops.errors import ConfigError
from kinedex.ops.words import NO_WORD, bits
from tests.bodies import index, standing

BODY = load_feature_set()


def reflected(feature_set: FeatureSet, positions: np.ndarray, orientation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A motion in a mirror at the plane x = 0: every joint is its twin, on the other side."""
    names = feature_set.joints
    twin = {"l": "r", "r": "l"}
    order = [names.index(other) if (other := twin.get(name[0], "") + name[1:]) in names else i
             for i, name in enumerate(names)]  # fmt: skip
    mirrored = positions[order].copy()
    mirrored[:, 0] *= -1
    return mirrored, orientation * np.array([1.0, 1.0, -1.0, -1.0])[:, None]


def dance(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Every joint sways by itself, the hips alike; the first frame, in which the limbs are measured, is symmetric."""
    random = np.random.default_rng(seed)
    time = np.arange(240) / 30
    phase, pace = random.uniform(0, 6, (24, 3, 1)), random.uniform(0.5, 4, (24, 3, 1))
    sway = random.uniform(0, 0.9, (24, 1, 1)) * np.sin(phase + pace * time)
    sway[index("rhip")] = sway[index("lhip")]  # F1 and F2 measure both hands against the left hip
    sway[:, :, 0] = 0
    turn = 2 * np.sin(time)
    orientation = np.stack([np.cos(turn / 2), 0 * turn, np.sin(turn / 2), 0 * turn])
    return standing(len(time)) + sway, orientation


def test_the_words_of_a_motion_in_the_mirror_are_the_mirrored_words():
    seen = np.zeros((2, len(BODY.features)), bool)
    for seed in range(6):
        motion = dance(seed)
        words = features.words(*motion, 30.0, BODY.rules)
        mirrored = features.words(*reflected(BODY, *motion), 30.0, BODY.rules)
        assert np.array_equal(BODY.mirrored(words), mirrored)
        matrix = bits(words, len(BODY.features))
        seen |= [(matrix == value).any(axis=0) for value in (0, 1)]
    paired = [number - 1 for pair in BODY.mirror for number in pair]
    assert seen[:, paired].all()  # the above proves nothing about a feature that never changes


@given(st.lists(st.integers(0, (1 << 40) - 1) | st.just(int(NO_WORD)), max_size=20))
def test_mirrored_twice_is_the_same(words: list[int]):
    given_words = np.array(words, np.uint64)
    assert np.array_equal(BODY.mirrored(BODY.mirrored(given_words)), given_words)


def test_twins_are_named_after_their_sides():
    for one, other in BODY.mirror:
        first, second = BODY.feature(one).name, BODY.feature(other).name
        assert second == "l" + first[1:] or (first, second) == ("shoulders_right", "shoulders_left")
        assert (BODY.mirrored_number(one), BODY.mirrored_number(other)) == (other, one)
    assert BODY.mirrored_number(40) == 40


@pytest.mark.parametrize(
    ("pairs", "message"), [("[[1, 2], [2, 3]]", "feature 2 stands twice"), ("[[1, 41]]", "no feature 41"),
                        ("[[7, 7]]", "feature 7 stands twice")]
)  # fmt: skip
def test_wrong_pairs_are_refused_with_their_line(tmp_path: Path, pairs: str, message: str):
    text = config_path("features", "body40").read_text()
    start = text.index("mirror:")
    path = tmp_path / "mine.yaml"
    path.write_text(text[:start] + f"mirror: {pairs}\n" + text[text.index("features:\n", start) :])
    with pytest.raises(ConfigError, match=rf"mine.yaml:\d+: mirror\[\d\]: {message}"):
        load_feature_set(path)


def test_the_words_digest_does_not_depend_on_the_mirror(tmp_path: Path):
    text = config_path("features", "body40").read_text()
    start = text.index("mirror:")
    path = tmp_path / "mine.yaml"
    path.write_text(text[:start] + text[text.index("features:\n", start) :])
    plain = load_feature_set(path)
    assert plain.digest == BODY.digest
    assert plain.mirror == ()


@pytest.mark.parametrize(
    ("window", "message"),
    [("-", "must be a number"), ("[]", "must be a number"), ("-5", "must be"), ("1e999", "must be")],
)
def test_a_window_that_is_no_time_is_refused_with_its_line(tmp_path: Path, window: str, message: str):
    text = config_path("features", "body40").read_text()
    path = tmp_path / "mine.yaml"
    path.write_text(re.sub(r"window_ms: \w+", f"window_ms: {window}", text, count=1))
    with pytest.raises(ConfigError, match=rf"mine.yaml:\d+: .*window_ms {message}"):
        load_feature_set(path)


def test_noise_hardly_changes_steady_features() -> None:
    unsteady = BODY.named(BODY.every_bit & ~BODY.steady)
    assert unsteady == [
        "rhand_from_root", "lhand_from_root", "rhand_fast", "lhand_fast", "rfoot_fast", "lfoot_fast", "root_fast",
        "root_turning",
    ]  # fmt: skip
    words = np.array([BODY.steady], np.uint64)
    assert np.array_equal(BODY.mirrored(words), words)  # mirrored copies have the same features
