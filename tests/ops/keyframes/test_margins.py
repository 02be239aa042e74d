"""Margins around hits: no frame of a training clip is lost, and what one query covers another need not."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.keyframes.margins import ALONE, clips_hit, margins_of
from kinedex.ops.keyframes.training_task import Individual

FEATURES = 3


def pose(bit: int) -> Individual:
    """A query of one keyframe: this feature is on."""
    mask = np.array([1 << bit], np.uint64)
    return Individual(mask, mask, np.array([4]), np.zeros(0, np.int64), np.zeros(0, np.int64))


def clip(text: str) -> np.ndarray:
    """Frames from letters: `a` has F1 on, `b` F2, `c` both, anything else neither."""
    return np.array([{"a": 1, "b": 2, "c": 3}.get(letter, 0) for letter in text], np.uint64)


def covered(clips: list[np.ndarray], queries: list[Individual], margins: list[tuple[int, int]]) -> list[list[bool]]:
    """The naive twin: every frame against every frame that matches."""
    found = []
    for words in clips:
        hits = [
            (n, margins[i])
            for i, query in enumerate(queries)
            for n, word in enumerate(words.tolist())
            if word & int(query.masks[0])
        ]
        found.append([any(hit - left <= n <= hit + right for hit, (left, right) in hits) for n in range(len(words))])
    return found


def test_a_margin_reaches_as_far_as_any_clip_does() -> None:
    clips = [clip("..a..."), clip("...a."), clip("a.....a"), clip("......")]
    assert margins_of([pose(0)], clips, FEATURES, "learned") == [(3, 3)]
    assert margins_of([pose(0)], clips, FEATURES, "shared") == [(3, 3)]
    assert clips_hit(clips, [pose(0)], FEATURES).tolist() == [True, True, True, False]


def test_what_lies_between_two_hits_is_covered_too() -> None:
    assert margins_of([pose(0)], [clip("a.....a"), clip(".a")], FEATURES, "learned") == [(3, 2)]
    assert margins_of([pose(0)], [clip("a.a")], FEATURES, "shared") == [(0, 1)]


def test_one_query_covers_the_beginning_and_another_the_end() -> None:
    clips = [clip(".a.......b."), clip("..a.....b..")]
    queries = [pose(0), pose(1)]
    assert margins_of(queries, clips, FEATURES, "learned") == [(2, 9), (9, 2)]
    shared = margins_of(queries, clips, FEATURES, "shared")
    # seven frames lie between both, and each query takes about half of them
    assert shared in ([(2, 3), (4, 2)], [(2, 4), (3, 2)])
    assert all(all(frames) for frames in covered(clips, queries, shared))


def test_of_two_queries_that_find_the_same_each_keeps_a_third_of_its_margins() -> None:
    clips = [clip("......c......"), clip("...c...")]
    assert margins_of([pose(0), pose(1)], clips, FEATURES, "shared") == [(2, 2), (6, 6)]


WORDS = st.lists(st.text("abc..", min_size=1, max_size=12).map(clip), min_size=1, max_size=5)


@given(WORDS)
def test_shared_margins_are_never_longer_and_lose_no_frame(clips: list[np.ndarray]) -> None:
    queries = [pose(0), pose(1)]
    learned = margins_of(queries, clips, FEATURES, "learned")
    shared = margins_of(queries, clips, FEATURES, "shared")
    assert all(
        one <= other
        for mine, theirs in zip(shared, learned, strict=True)
        for one, other in zip(mine, theirs, strict=True)
    )
    whole = covered(clips, queries, learned)
    assert covered(clips, queries, shared) == whole
    # a clip that is hit is covered whole; margins of nothing are nothing
    hit = clips_hit(clips, queries, FEATURES).tolist()
    assert [all(frames) for frames in whole] == hit
    for query, index in ((0, 0), (0, 1), (1, 0), (1, 1)):
        shorter = [list(pair) for pair in shared]
        if shorter[query][index] > -(-learned[query][index] // ALONE):
            shorter[query][index] -= 1
            assert covered(clips, queries, [(one[0], one[1]) for one in shorter]) != whole
