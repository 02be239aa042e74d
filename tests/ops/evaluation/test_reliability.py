"""Reliability of confidences, against plain loops."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.errors import ParameterError
from kinedex.ops.evaluation.reliability import EDGES, auroc, brier, reliability, wilson

judged = st.lists(st.tuples(st.sampled_from([0.0, 0.1, 0.2, 0.35, 0.4, 0.79, 0.8, 1.0]), st.booleans()), max_size=12)


@given(judged)
def test_auroc_is_the_share_of_pairs_in_order(rows: list[tuple[float, bool]]) -> None:
    scores, right = np.array([one[0] for one in rows]), np.array([one[1] for one in rows], bool)
    pairs = [(a > b) + 0.5 * (a == b) for a, good in rows for b, bad in rows if good and not bad]
    assert auroc(scores, right) == pytest.approx(np.mean(pairs) if pairs else math.nan, nan_ok=True)
    squares = [(score - good) ** 2 for score, good in rows]
    assert brier(scores, right) == pytest.approx(np.mean(squares) if squares else math.nan, nan_ok=True)


@given(judged)
def test_every_segment_is_in_the_bucket_of_its_confidence(rows: list[tuple[float, bool]]) -> None:
    found = reliability(np.array([one[0] for one in rows]), np.array([one[1] for one in rows], bool))
    assert [(one.low, one.high) for one in found] == list(pairwise(EDGES))
    for one in found:
        own = [row for row in rows if one.low <= row[0] < one.high or row[0] == one.high == 1.0]
        assert (one.count, one.right) == (len(own), sum(good for _, good in own))
        assert one.interval == wilson(one.right, one.count)
        if own:
            assert (one.confidence, one.share) == pytest.approx(tuple(np.mean(own, axis=0)))


def test_wrong_arguments_are_named() -> None:
    with pytest.raises(ParameterError, match="right"):
        auroc(np.ones(2), np.ones(1, bool))
