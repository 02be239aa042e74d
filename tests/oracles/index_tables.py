"""The tables of an index the plain way: from the words of every take, frame by frame."""

from __future__ import annotations

from collections import Counter

from tests.oracles.runs import INVALID, feature_runs, word_runs

Row = tuple[object, ...]


def tables(
    takes: dict[int, list[int]], sets: dict[str, tuple[int, int]], features: int, rate_hz: float
) -> dict[str, list[Row]]:
    """The rows of word_runs, feature_runs and vocabulary, sorted.

    takes: id → whole words. sets: name → (first feature, how many).
    """
    ids = sorted(takes)
    words: list[tuple[str, int, int, int, int]] = []
    for name, (first, count) in sets.items():
        cut = [[w if w == INVALID else w >> (first - 1) & (2**count - 1) for w in takes[take]] for take in ids]
        words += [(name, word, ids[take], start, stop) for take, start, stop, word in word_runs(cut)]
    runs = Counter((name, word) for name, word, *_ in words)
    frames: Counter[tuple[str, int]] = Counter()
    for name, word, _, start, stop in words:
        frames[name, word] += stop - start
    return {
        "word_runs": sorted(words),
        "feature_runs": sorted(
            (feature, ids[take], start, stop, (stop - start) / rate_hz)
            for feature, take, start, stop in feature_runs([takes[take] for take in ids], features)
        ),
        "vocabulary": sorted((*key, runs[key], frames[key]) for key in runs),
    }
