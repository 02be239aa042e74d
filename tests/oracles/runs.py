"""Runs the plain way: frame by frame, take by take."""

from __future__ import annotations

from itertools import groupby

INVALID = 2**64 - 1


def word_runs(takes: list[list[int]]) -> list[tuple[int, int, int, int]]:
    """(take, start, stop, word) of every run."""
    runs = []
    for take, words in enumerate(takes):
        start = 0
        for word, group in groupby(words):
            stop = start + len(list(group))
            if word != INVALID:
                runs.append((take, start, stop, word))
            start = stop
    return runs


def feature_runs(takes: list[list[int]], features: int) -> list[tuple[int, int, int, int]]:
    """(feature, take, start, stop) of every run where the feature is on."""
    runs = []
    for feature in range(1, features + 1):
        flags = [[word != INVALID and word >> (feature - 1) & 1 for word in words] for words in takes]
        runs += [(feature, take, start, stop) for take, start, stop, on in word_runs(flags) if on]
    return runs
