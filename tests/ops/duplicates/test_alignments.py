"""Alignments of takes by equal sequences of runs, beside a twin that compares every pair of places."""

from __future__ import annotations

import math
from collections import Counter
from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.arrays import U64
from kinedex.ops.duplicates.alignments import (
    FEW,
    FEW_RUNS,
    FEWEST_RUNS,
    KEPT,
    LENGTH,
    SHORT,
    Alignments,
    find_alignments,
)
from kinedex.ops.search.runs import WordRuns, word_runs
from kinedex.ops.words import NO_WORD


def alignments(runs: WordRuns, mirrored: U64 | None = None, most_votes: int = 1000) -> Alignments:
    """Return the alignments of all blocks together."""
    none = np.empty(0, np.int64)
    parts = [
        Alignments(none, none, none, none.astype(bool), none, none, none),
        *find_alignments(runs, mirrored, most_votes),
    ]
    first, second, shift, image, *rest = (np.concatenate(own) for own in zip(*parts, strict=True))
    return Alignments(first, second, shift, image, *rest)


def naive_sequences(words: list[int], length: int) -> list[tuple[tuple[int, ...], int]]:
    """Return each sequence of runs of a take with the start of its second run."""
    runs: list[tuple[int, int, int]] = []
    for frame, word in enumerate(words):
        if word == int(NO_WORD):
            continue
        if runs and runs[-1][0] == word and runs[-1][2] == frame:
            runs[-1] = (word, runs[-1][1], frame + 1)
        else:
            runs.append((word, frame, frame + 1))
    found = []
    for i in range(len(runs) - length + 1):
        part = runs[i : i + length]
        if all(one[2] == other[1] for one, other in pairwise(part)):
            found.append((tuple(run[0] for run in part), part[min(1, length - 1)][1]))
    return found


def naive_votes(takes: list[list[int]]) -> Counter[tuple[int, int, int]]:
    """Return how many sequences support each (first take, second take, shift)."""
    votes: Counter[tuple[int, int, int]] = Counter()
    counts = [len(naive_sequences(words, 1)) for words in takes]
    for length in (LENGTH, SHORT, 1):
        for a, first in enumerate(takes):
            for b in range(a + 1, len(takes)):
                if min(counts[a], counts[b]) >= {LENGTH: math.inf, SHORT: FEW_RUNS, 1: FEWEST_RUNS}[length]:
                    continue
                for one, i in naive_sequences(first, length):
                    for other, j in naive_sequences(takes[b], length):
                        votes[a, b, i - j] += one == other
    return +votes


words_of_takes = st.lists(st.lists(st.sampled_from([1, 2, 3, int(NO_WORD)]), max_size=14), min_size=1, max_size=3)


@given(words_of_takes)
def test_alignments_are_those_of_the_twin(takes: list[list[int]]) -> None:
    words = np.array([word for take in takes for word in take], np.uint64)
    offsets = np.cumsum([0, *map(len, takes)])
    found = alignments(word_runs(words, offsets))
    votes = naive_votes(takes)
    frequent = Counter(s for take in takes for length in (1, SHORT, LENGTH) for s, _ in naive_sequences(take, length))
    if frequent and max(frequent.values()) > FEW:
        return
    expected = {}
    for a, b in {(a, b) for a, b, _ in votes}:
        near = {
            shift: sum(votes[a, b, shift + step] for step in (-1, 0, 1)) for x, y, shift in votes if (x, y) == (a, b)
        }
        ranked = sorted(near, key=lambda shift: (-near[shift], abs(shift), shift))
        expected |= {(a, b, shift): near[shift] for shift in ranked[:KEPT]}
    rows = zip(found.first.tolist(), found.second.tolist(), found.shift.tolist(), strict=True)
    assert dict(zip(rows, found.votes.tolist(), strict=True)) == expected
    assert not found.mirrored.any()
    for one, other in zip(found, alignments(word_runs(words, offsets), most_votes=1), strict=True):
        assert np.array_equal(one, other)


def test_a_mirrored_take_is_found_by_mirrored_words() -> None:
    rng = np.random.default_rng(3)
    take = np.repeat(rng.integers(0, 1 << 20, 30).astype(np.uint64) << np.uint64(1), 3)
    mirrored = take + np.uint64(1)  # words of the other side
    runs = word_runs(np.concatenate((take, mirrored[12:])), np.array([0, 90, 168]))
    found = alignments(runs, runs.word ^ np.uint64(1))
    assert (found.first.tolist(), found.second.tolist(), found.shift.tolist()) == ([0], [1], [12])
    assert found.mirrored.tolist() == [True]
    assert len(alignments(runs).first) == 0


def test_many_copies_form_a_chain_and_not_all_pairs() -> None:
    take = np.repeat(np.arange(40, dtype=np.uint64), 2)
    copies = 60
    runs = word_runs(np.tile(take, copies), np.arange(copies + 1) * 80)
    found = alignments(runs)
    assert len(found.first) < 4 * copies
    groups = list(range(copies))
    for one, two in zip(found.first.tolist(), found.second.tolist(), strict=True):
        old, new = groups[two], groups[one]
        groups = [new if group == old else group for group in groups]
    assert len(set(groups)) == 1
