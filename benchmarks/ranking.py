"""Distance curves and ranking on one core, beside a plain double loop and beside packages for the same work."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

import numba as nb
import numpy as np
import numpy.typing as npt

from benchmarks.harness import Figure, seconds
from ops.distances.costs import cost_table, encode, lay_out
from ops.distances.dtw import distance_curves
from ops.distances.ranking import rank
from ops.distances.sweep import pieces_of, sweep
from ops.templates.templates import QuantisedTemplate, learn_soft, quantise
from ops.words import TakeWords, bits
from storage.store import Store

COLUMNS, FRAMES, WORDS = 60, 400_000, 4_000
"""The size that a curve is timed at."""

FEW = 4_000
"""Frames that packages are timed at which keep the whole matrix, or are slow; times are per cell."""

F64 = npt.NDArray[np.float64]


@nb.njit(nogil=True)
def plain(table: F64, codes: npt.NDArray[np.int32]) -> F64:
    """Row by row and cell by cell, as the equations stand, on a whole matrix."""
    columns, frames = table.shape[1], len(codes)
    total = np.full((columns, frames), np.inf)
    for n in range(columns):
        for frame in range(frames):
            cost = table[codes[frame], n]
            best = cost if n == 0 else np.inf
            if n > 0 and frame > 0:
                best = total[n - 1, frame - 1] + cost
            if n > 0 and frame > 1:
                best = min(best, total[n - 1, frame - 2] + cost)
            if n > 1 and frame > 0:
                best = min(best, total[n - 2, frame - 1] + 2 * cost)
            total[n, frame] = best
    return total[columns - 1] / columns


def figures(store: Store) -> list[Figure]:
    """Curves at a fixed size in three ways, packages, and ranking of the archive by its classes, tiled to that size."""
    return [*_curves(), *_rankings(store)]


def _made_up() -> tuple[QuantisedTemplate, npt.NDArray[np.uint64]]:
    random = np.random.default_rng(0)
    vocabulary = random.integers(0, 1 << 40, WORDS).astype(np.uint64)
    words = np.repeat(vocabulary[random.integers(0, WORDS, FRAMES // 2)], 2)
    masks = random.integers(0, 1 << 40, COLUMNS).astype(np.uint64)
    return QuantisedTemplate(masks, vocabulary[:COLUMNS] & masks), words


def _curves() -> list[Figure]:
    template, words = _made_up()
    coded, layout = encode(words), lay_out([template])
    pieces = pieces_of(np.array([[0, FRAMES]]), 4096, 2 * (COLUMNS - 1))
    wide = cost_table(layout, coded.vocabulary)[:, :COLUMNS].copy()
    loop = seconds(lambda: plain(wide, coded.codes), 3)
    billions = COLUMNS * FRAMES / 1e9
    found = []
    for name, dtype in (("float32", np.float32), ("float64", np.float64)):
        table, sums = cost_table(layout, coded.vocabulary, dtype), np.empty((1, FRAMES), dtype)
        time = seconds(lambda t=table, s=sums: sweep(t, coded.codes, pieces, layout.firsts, layout.lasts, s))
        found.append(Figure(f"distance curve, {name}", billions, "G cells", time, "plain loop in numba", loop))
    whole = seconds(lambda: distance_curves([template], words, dtype=np.float32))
    ours = seconds(lambda: distance_curves([template], words[:FEW])) / FEW * FRAMES
    found.append(Figure("the same with codes and costs", billions, "G cells", whole, "plain loop in numba", loop))
    for name, work in _packages(template, words[:FEW]).items():
        time = seconds(work, 1) / FEW * FRAMES
        found.append(Figure("distance curve of a short take", billions, "G cells", ours, name, time))
    return found


def _packages(template: QuantisedTemplate, words: npt.NDArray[np.uint64]) -> dict[str, Callable[[], object]]:
    """The same work by others: librosa with our costs and steps; the others with their own steps on the 40 bits."""
    rows = cost_table(lay_out([template]), words)[:, :COLUMNS].T.copy()
    columns, frames = template.values(40), bits(words, 40).astype(np.float64)
    found: dict[str, Callable[[], object]] = {}
    try:
        dtw = import_module("librosa").sequence.dtw
        steps, weights = np.array([[1, 1], [1, 2], [2, 1]]), np.array([1.0, 1.0, 2.0])
        found["librosa, same costs and steps"] = lambda: dtw(
            C=rows, step_sizes_sigma=steps, weights_mul=weights, subseq=True, backtrack=False
        )
    except ImportError:
        print("librosa is not installed: not compared (pip install kinedex[bench])")
    try:
        matrix = import_module("tslearn.metrics").dtw_subsequence_path
        found["tslearn, Euclidean, steps of 1"] = lambda: matrix(columns, frames)
    except ImportError:
        print("tslearn is not installed: not compared (pip install kinedex[bench])")
    try:
        align = import_module("dtaidistance.subsequence.dtw").subsequence_alignment
        found["dtaidistance, Euclidean, steps of 1"] = lambda: align(columns, frames, use_c=True).matching
    except ImportError:
        print("dtaidistance is not installed: not compared (pip install kinedex[bench])")
    return found


def _rankings(store: Store) -> list[Figure]:
    """The hundred best hits of each class at τ = 0.1, takes repeated to 400,000 frames; cells of the whole curve."""
    clips = store.takes("class IS NOT NULL")
    words = store.words()
    times = -(-FRAMES // max(1, len(words.words)))
    offsets = np.concatenate(([0], np.cumsum(np.tile(words.frames, times)))).astype(np.int64)
    many = TakeWords(np.arange(len(offsets) - 1), offsets, np.tile(words.words, times))
    coded = encode(many.words)
    found = []
    for (name,), group in clips.sort("class", "name").group_by("class", maintain_order=True):
        examples = store.words(group["take_id"].to_list())
        template = quantise(learn_soft([examples.take(i) for i in range(len(examples))], 40).template, 0.1)
        hits = rank(template, many, 0.1, 100, coded=coded)
        time = seconds(lambda t=template: rank(t, many, 0.1, 100, coded=coded), 3)
        skipped = max(0.0, 1 - hits.computed / hits.frames)
        cells = len(template) * len(many.words) / 1e9
        found.append(Figure(f"top 100 of {name}, {skipped:.0%} skipped", cells, "G cells", time))
    return found
