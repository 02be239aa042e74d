"""Words to runs, and keyframe queries over their lists, on one core."""

from __future__ import annotations

import numpy as np

from benchmarks.harness import Figure, seconds
from ops import keyframes as k
from ops.runs import word_runs
from ops.words import TakeWords, cut
from storage.store import Store
from tests.oracles import runs as naive_runs

HOURS = 4.0


def figures(store: Store) -> list[Figure]:
    """Time run building and search on the store's words, tiled to four hours of motion."""
    words = _tile(store.words(), HOURS)
    return [_runs(words), _search(words)]


def _tile(words: TakeWords, hours: float) -> TakeWords:
    copies = int(np.ceil(hours * 3600 * 30 / len(words.words)))
    return TakeWords(
        np.arange(copies * len(words), dtype=np.int64),
        np.concatenate([[0], np.cumsum(np.tile(words.frames, copies))]),
        np.tile(words.words, copies),
    )


def _runs(words: TakeWords) -> Figure:
    part = 20_000
    naive = seconds(lambda: naive_runs.word_runs([words.words[:part].tolist()]), 1)
    return Figure(
        "words to runs", len(words.words) / 1e6, "M frames", seconds(lambda: word_runs(words.words, words.offsets)),
        "plain Python", naive * len(words.words) / part,
    )  # fmt: skip


def _search(words: TakeWords) -> Figure:
    runs = word_runs(cut(words.words, 15, 12), words.offsets)
    starts, stops = k.to_axis(runs.take, runs.start), k.to_axis(runs.take, runs.stop)
    bent, straight = 0b110000, 0
    lists = [
        k.keyframe_list(starts, stops, runs.word, 0b110000, value)
        for value in (straight, bent, straight, 0b010000, straight)
    ]
    gaps = [k.gap_bounds(15, stiffness) for stiffness in (0.2, 0.4, 0.0, 0.6)]
    total = sum(len(segments) for segments in lists)
    ours = seconds(lambda: k.search(lists, gaps), 9)
    sort = np.concatenate([segments.starts for segments in lists])
    return Figure(
        "keyframe search, K = 5",
        total / 1e6,
        "M segments",
        ours,
        "sorting their starts",
        seconds(lambda: np.sort(sort)),
    )
