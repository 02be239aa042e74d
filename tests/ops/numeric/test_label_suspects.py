"""Labels that are wrong are found by those that are right, with what is wrong about them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pytest

from kinedex.ops.arrays import F64
from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.numeric.label_suspects import Judgement, Place, context_of, judge_labels
from kinedex.ops.numeric.label_windows import Window
from tests.ops.numeric.motions import RATE_HZ, in_a_row, motion

NAMES = ("raise left", "bow", "raise right", "walk")
Label = tuple[int, int, int, str]


def archive() -> tuple[list[F64], list[Label]]:
    """Return twelve takes with four motions each, and their labels."""
    takes, labels = [], []
    for take in range(12):
        names = [NAMES[(take + k) % 4] for k in range(4)]
        frames = [36 + (5 * take + 3 * k) % 11 for k in range(4)]
        takes.append(in_a_row(names, frames, 40 * take))
        edges = np.cumsum([0, *frames]).tolist()
        labels += [(take, edges[k], edges[k + 1], names[k]) for k in range(4)]
    return takes, labels


def judged(takes: Sequence[F64], labels: Sequence[Label]) -> list[Judgement]:
    def windows() -> Iterator[tuple[int, Window]]:
        for number, (take, start, stop, _) in reversed(list(enumerate(labels))):
            first, last = context_of(start, stop, len(takes[take]))
            yield number, Window(takes[take][first:last], start - first, stop - first)

    return judge_labels([Place(take, label) for take, _, _, label in labels], windows, JOINTS, RATE_HZ)


def most_suspect(found: Sequence[Judgement]) -> int:
    return int(np.nanargmax([one.suspicion for one in found]))


def test_right_labels_are_probable() -> None:
    found = judged(*archive())
    assert min(one.probability for one in found) > 0.9
    assert not any(one.kind in ("class", "side") for one in found)


def test_a_label_of_another_class_is_found_with_the_right_one() -> None:
    takes, labels = archive()
    wrong = next(k for k, one in enumerate(labels) if one[3] == "bow" and one[0] == 5)
    labels[wrong] = (*labels[wrong][:3], "walk")
    found = judged(takes, labels)
    assert most_suspect(found) == wrong
    assert (found[wrong].kind, found[wrong].label) == ("class", "bow")
    assert found[wrong].probability < 0.01


def test_a_label_of_the_other_side_is_found() -> None:
    takes, labels = archive()
    wrong = next(k for k, one in enumerate(labels) if one[3] == "raise left" and one[0] == 5)
    labels[wrong] = (*labels[wrong][:3], "raise right")
    found = judged(takes, labels)
    assert most_suspect(found) == wrong
    assert (found[wrong].kind, found[wrong].label) == ("side", "raise left")


def test_the_other_side_is_found_where_no_class_has_it() -> None:
    takes = [motion(NAMES[k % 2], 36 + k, k) for k in range(12)]
    takes[4] = motion("raise right", 40, 4)
    found = judged(takes, [(k, 0, len(take), NAMES[k % 2]) for k, take in enumerate(takes)])
    assert most_suspect(found) == 4
    assert (found[4].kind, found[4].label) == ("side", "")


def test_moved_edges_are_found_with_better_ones() -> None:
    takes, labels = archive()
    wrong = next(k for k, one in enumerate(labels) if one[3] == "bow" and one[0] == 5)
    take, start, stop, label = labels[wrong]
    labels[wrong] = (take, start + 16, stop + 16, label)
    found = judged(takes, labels)
    assert most_suspect(found) == wrong
    assert found[wrong].kind == "edges"
    first = context_of(*labels[wrong][1:3], len(takes[take]))[0]
    np.testing.assert_allclose(found[wrong].interval, [start - first, stop - first], atol=5)


@pytest.mark.parametrize(("every", "factor"), [(2, 0.5), (0.5, 2.0)])
def test_frames_at_a_wrong_rate_are_found(every: float, factor: float) -> None:
    takes = [motion(NAMES[k % 4], 36 + k, k) for k in range(24)]
    times = np.arange(0, len(takes[11]) - 1, every)
    before, share = times.astype(int), (times % 1)[:, None, None]
    takes[11] = (1 - share) * takes[11][before] + share * takes[11][before + 1]
    found = judged(takes, [(k, 0, len(take), NAMES[k % 4]) for k, take in enumerate(takes)])
    assert most_suspect(found) == 11
    assert (found[11].kind, found[11].rate_factor) == ("rate", factor)


def test_labels_that_cannot_be_judged_say_why() -> None:
    takes, labels = archive()
    takes[3] = takes[3].copy()
    takes[3][labels[13][1] + 4, 7] = np.nan
    labels += [(0, 3, 5, "bow"), (2, 4, 30, "nod")]
    found = judged(takes, labels)
    assert found[13].reason == "a label must be of frames in which all joints are known, got 'frames without'"
    assert found[-2].reason == "a label must be of 3 frames or more, got 'fewer'"
    assert found[-1].reason == "no other label of its class can be judged"
    assert all(not one.reason for k, one in enumerate(found[:-2]) if k != 13)
    assert judged(takes, [(2, 4, 30, "nod")])[0].reason == found[-1].reason
    assert judged(takes, []) == []


def test_what_others_label_in_other_takes_is_all_that_counts() -> None:
    takes, labels = archive()
    found, moved = judged(takes, labels), judged(takes[::-1], [(11 - take, *rest) for take, *rest in labels])
    np.testing.assert_allclose([one.probability for one in found], [one.probability for one in moved], atol=1e-9)
