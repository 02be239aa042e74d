"""Poses of an archive: clips aligned to a template, mean rotations and spreads, and the actor's own way."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.ops.body.kinematic_chain import Poses
from kinedex.ops.errors import ParameterError
from kinedex.ops.priors.archive_poses import actor_deviation, clip_frames, pose_table, relative_rotations
from kinedex.ops.templates.templates import Template
from kinedex.ops.words import NO_WORD
from tests.oracles import kinematic_chain as oracle

TEMPLATE = Template(np.array([[0.0, 0.0], [1.0, 0.2], [1.0, 1.0]]), np.ones(3))


def exp(vector: list[float]) -> np.ndarray:
    """The rotation of a vector."""
    return oracle.exp(np.array(vector, np.float64))


def test_a_column_goes_with_the_middle_of_its_frames():
    assert clip_frames(TEMPLATE, np.array([0, 0, 0, 1, 3, 3, 3], np.uint64)).tolist() == [1, 3, 5]
    assert clip_frames(TEMPLATE, np.array([0, 3], np.uint64)).tolist() == [0, 1, 1]


def test_features_without_weight_align_nothing():
    weighted = Template(TEMPLATE.values, TEMPLATE.weights, np.array([0.0, 1.0]))
    assert clip_frames(weighted, np.array([1, 0, 1, 0, 2], np.uint64))[2] == 4


@pytest.mark.parametrize("words", [[], [0, NO_WORD]])
def test_a_clip_without_a_valid_word_is_refused(words: list[int]):
    with pytest.raises(ParameterError, match="all valid"):
        clip_frames(TEMPLATE, np.array(words, np.uint64))


def turned(angles: list[float]) -> Poses:
    """Two nodes that turn about Z by the same angles."""
    rotations = np.array([[exp([0, 0, a]), exp([0, 0, a])] for a in angles])
    return Poses(np.zeros((len(angles), 3)), rotations)


def test_the_table_has_mean_spread_and_tilt():
    frames = np.array([0, 1])
    table = pose_table([turned([0.2, 0.1]), turned([0.4, 0.1])], [frames, frames])
    np.testing.assert_allclose(table.means[:, 1], [exp([0, 0, 0.3]), exp([0, 0, 0.1])], atol=1e-12)
    np.testing.assert_allclose(table.spreads[:, 1], [[0, 0, 0.1], [0, 0, 0]], atol=1e-12)
    np.testing.assert_allclose(table.tilts[0], [np.sin(0.3), np.cos(0.3), 0], atol=1e-12)
    with pytest.raises(ParameterError, match="at least one clip"):
        pose_table([], [])


def test_the_own_way_follows_what_is_seen_in_full_after_half_a_second():
    means = np.tile(np.eye(3), (20, 2, 1, 1))
    track = np.tile(exp([0, 0, 0.4]), (20, 2, 1, 1))
    for count, share in ((4, 0.0), (6, 6 / 15), (15, 1.0), (20, 1.0)):
        seen = np.zeros((20, 2), np.bool_)
        seen[:count, 0] = True
        way = actor_deviation(means, track, seen, 30.0)
        np.testing.assert_allclose(way.rotations, [exp([0, 0, 0.4 * share]), np.eye(3)], atol=1e-12)
        left = np.nan if count < 5 else 0.4 * (1 - share)
        assert way.residuals[0, 2] == pytest.approx(left, nan_ok=True)


def test_relative_turns_are_seen_from_the_mean():
    mean, turn = exp([0.3, 0.1, -0.2]), exp([0.1, 0.2, 0.3])
    np.testing.assert_allclose(relative_rotations(mean, mean @ turn), [0.1, 0.2, 0.3], atol=1e-12)
