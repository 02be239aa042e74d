"""Confidence says how often labels are right, and what was never taught is unlike what was."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.ops.arrays import F64
from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.numeric.recogniser import FEW, ONE_GROUP, Recogniser, TaughtMotion
from kinedex.ops.numeric.segment_confidence import (
    CLASS_PRIOR,
    KNOWN_CENTRES,
    KNOWN_OFFSET,
    KNOWN_SCALES,
    KNOWN_SHARE,
    KNOWN_SLOPES,
    known_chances,
    share_of_known,
)
from tests.ops.numeric.motions import RATE_HZ, in_a_row, motion

NAMES = ("raise left", "raise right", "bow")
TAUGHT = ["bow", "raise left", "raise right", "bow", "raise left", "raise right"]


def recogniser(archive: list[F64], groups: int = 12, count: int = 12) -> Recogniser:
    """Return what has learned raising arms and bowing."""
    examples = [
        TaughtMotion(motion(NAMES[k % 3], 34 + 2 * (k % 5), k), NAMES[k % 3], f"{k % groups}") for k in range(count)
    ]
    return Recogniser.fit(examples, archive, JOINTS, RATE_HZ)


def with_odds(odds: F64) -> F64:
    """Return numbers of segments that show a taught class with certain log odds."""
    found = np.tile([*KNOWN_CENTRES[:3], 5.0, *KNOWN_CENTRES[3:]], (len(odds), 1))
    found[:, 0] += KNOWN_SCALES[0] * (odds - KNOWN_OFFSET) / KNOWN_SLOPES[0]
    assert found.shape[1] == len(CLASS_PRIOR.evidence)
    return found


@pytest.mark.parametrize("share", [0.2, 0.5, 0.9])
def test_the_share_of_taught_motion_follows_from_the_archive(share: float) -> None:
    generator = np.random.default_rng(0)
    middle, spread = np.log(KNOWN_SHARE / (1 - KNOWN_SHARE)), 6.0
    known = generator.random(4000) < share  # normal log odds whose means differ by their variance are true odds
    odds = generator.normal(middle + np.where(known, 0.5, -0.5) * spread, np.sqrt(spread))
    found = share_of_known(with_odds(odds))
    assert found == pytest.approx(share, abs=0.03)
    assert known_chances(with_odds(odds), found).mean() == pytest.approx(share, abs=0.03)


def test_all_is_taught_where_nothing_can_tell() -> None:
    odds = np.array([-5.0, 0.0, 5.0])
    assert known_chances(with_odds(odds), 1.0).tolist() == [1.0, 1.0, 1.0]
    assert np.all(np.diff(known_chances(with_odds(odds), 0.5)) > 0)


def test_what_was_taught_is_probable_and_like_its_class() -> None:
    taught = recogniser([in_a_row(TAUGHT, [36, 38, 40, 42, 44, 40], 300)])
    assert taught.remarks == ()
    found = taught.label(in_a_row(["bow", "raise right"], [40, 40], 700))
    assert [one.label for one in found] == ["bow", "raise right"]
    assert all(one.probability > 0.8 for one in found)
    assert all(one.unlikeness < 0.95 for one in found)


def test_what_was_never_taught_is_improbable_and_unlike() -> None:
    strange = ["walk", "bow", "walk", "raise left", "walk", "raise right", "walk"]
    taught = recogniser([in_a_row(strange, [60, 40, 70, 40, 60, 40, 70], 300)])
    take = in_a_row(["walk", "bow", "walk"], [60, 40, 60], 800)
    assert [one.label for one in taught.label(take)] == ["bow"]
    ready = taught.label(take, readiness=1e4)
    walks = [one for one in ready if one.stop <= 65 or one.start >= 95]
    bows = [one for one in ready if one.start < 90 and one.stop > 70 and one.label == "bow"]
    assert walks
    assert max(one.probability for one in walks) < min(one.probability for one in bows)
    assert min(one.unlikeness for one in walks) > max(one.unlikeness for one in bows)


def test_examples_that_cannot_be_left_out_are_remarked_upon() -> None:
    archive = [in_a_row(TAUGHT, [36, 38, 40, 42, 44, 40], 300)]
    assert recogniser(archive, groups=1).remarks == (ONE_GROUP,)
    one_each = recogniser(archive, count=3)
    assert one_each.remarks == (FEW,)
    assert all(0 <= one.probability <= 1 and 0 <= one.unlikeness <= 1 for one in one_each.label(archive[0]))


def test_the_same_examples_teach_the_same() -> None:
    archive = [in_a_row(["walk", "bow", "stand"], [60, 40, 50], 300)]
    take = in_a_row(["bow", "walk", "raise left"], [40, 50, 40], 900)
    assert recogniser(archive).label(take) == recogniser(archive).label(take)
