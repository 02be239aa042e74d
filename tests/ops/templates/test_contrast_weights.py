"""Weights of features by what was accepted and what was rejected."""

from __future__ import annotations

import numpy as np

from kinedex.ops.templates.derived_templates import contradicted_shares, contrast_weights
from kinedex.ops.templates.templates import learn_soft
from kinedex.ops.words import NO_WORD

FEATURES = 4
CLIP = np.array([1, 1, 3, 3, 2, 2], np.uint64)
TEMPLATE = learn_soft([CLIP], FEATURES).template


def with_bit(clip: np.ndarray, bit: int) -> np.ndarray:
    return clip ^ np.uint64(1 << bit)


def test_a_feature_that_rejected_clips_contradict_weighs_more_and_more_with_their_number() -> None:
    some = [contrast_weights(TEMPLATE, [CLIP] * n, [with_bit(CLIP, 3)] * n, 0.1) for n in (1, 3, 9)]
    for weights in some:
        assert weights[3] > 1
        np.testing.assert_array_equal(weights[:3], 1)
    assert some[0][3] < some[1][3] < some[2][3]


def test_what_both_sides_contradict_alike_and_what_only_the_accepted_do_weighs_as_before() -> None:
    off = with_bit(CLIP, 3)
    np.testing.assert_allclose(contrast_weights(TEMPLATE, [off, CLIP], [off, CLIP], 0.1), 1)
    np.testing.assert_allclose(contrast_weights(TEMPLATE, [off] * 3, [CLIP] * 3, 0.1), 1)
    np.testing.assert_allclose(contrast_weights(TEMPLATE, [CLIP] * 5, [CLIP], 0.1), 1)
    np.testing.assert_array_equal(contrast_weights(TEMPLATE, [CLIP], [], 0.1), 1)


def test_a_clip_contradicts_by_its_valid_frames_alone() -> None:
    broken = np.concatenate([[NO_WORD], CLIP, [NO_WORD]])
    shares = contradicted_shares(TEMPLATE, [CLIP, broken, with_bit(CLIP, 3), np.full(3, NO_WORD)], 0.1)
    np.testing.assert_array_equal(shares, [[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 1], [0, 0, 0, 0]])
