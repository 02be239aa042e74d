"""`python -m benchmarks.ranking`: time distance curves and ranking, beside a plain double loop and packages.

`python -m benchmarks` runs this too.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

import numba as nb
import numpy as np
import numpy.typing as npt

from benchmarks.archive import BUILD
from benchmarks.archive import store as synthetic
from benchmarks.harness import SMALL, Figure, calibrate, seconds, show, silent, sized
from benchmarks.ranking_memory import made_up, searched_classes
from kinedex.console.terminal import make_console
from kinedex.ops.distances.costs import column_layout, cost_table, encode
from kinedex.ops.distances.dtw import distance_curves
from kinedex.ops.distances.pruning import CoarseBound, coarse_bounds, fine_bound, pieces_below
from kinedex.ops.distances.recurrence import COARSE_CAP
from kinedex.ops.distances.sweep import BLOCK, CAP
from kinedex.ops.ranking.best_hits import rank, rank_together
from kinedex.ops.templates.templates import QuantisedTemplate, learn_soft, quantise
from kinedex.ops.words import TakeWords, bits
from kinedex.pipelines.engine.runner import run_pipeline
from kinedex.pipelines.templates.ranking import rank_takes
from kinedex.storage.store.store import Store, open_store
from tests.real_data import SHARED

COLUMNS, FRAMES, WORDS = 60, sized(400_000, 8_000), sized(4_000, 400)
"""The size at which a curve is timed."""

DELTA, TAU, TOP = 0.1, 0.1, 100
"""Numbers of templates, thresholds and hits of the rankings."""

THREAD_HOURS = sized(10.0, 0.1)
"""The size at which threads are compared."""

HDM05 = SHARED / "data" / "hdm05"
RUNS = sized(5, 1)

FEW = sized(4_000, 400)
"""Frames at which packages are timed that store the whole matrix, or are slow; times are per cell."""

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]


@nb.njit(nogil=True)
def plain(table: F64, codes: npt.NDArray[np.int32]) -> F64:
    """Fill a whole matrix cell by cell, as the equations are printed."""
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
    """Time curves at a fixed size in three ways, packages, and rankings of takes repeated to that size."""
    return [*_curves(), *_rankings(store), *_threads()]


def _made_up() -> tuple[QuantisedTemplate, npt.NDArray[np.uint64]]:
    random = np.random.default_rng(0)
    vocabulary = random.integers(0, 1 << 40, WORDS).astype(np.uint64)
    words = np.repeat(vocabulary[random.integers(0, WORDS, FRAMES // 2)], 2)
    masks = random.integers(0, 1 << 40, COLUMNS).astype(np.uint64)
    return QuantisedTemplate(masks, vocabulary[:COLUMNS] & masks), words


def _curves() -> list[Figure]:
    """Time curves in float64, which annotation uses, and in float32, codes and costs included."""
    template, words = _made_up()
    coded = encode(words)
    wide = cost_table(column_layout([template]), coded.vocabulary)[:, :COLUMNS].copy()
    loop = seconds(lambda: plain(wide, coded.codes), 3)
    billions = COLUMNS * FRAMES / 1e9
    found = []
    for dtype in (np.float32, np.float64):
        time = seconds(lambda kind=dtype: distance_curves([template], words, dtype=kind))  # type: ignore[misc]
        found.append(
            Figure(f"distance curve, {dtype.__name__}", billions, "G cells", time, "plain loop in numba", loop)
        )
    ours = seconds(lambda: distance_curves([template], words[:FEW])) / FEW * FRAMES
    for name, work in _packages(template, words[:FEW]).items():
        time = seconds(work, 1) / FEW * FRAMES
        found.append(Figure("distance curve of a short take", billions, "G cells", ours, name, time))
    return found


def _packages(template: QuantisedTemplate, words: npt.NDArray[np.uint64]) -> dict[str, Callable[[], object]]:
    """Time other packages: librosa with our costs and steps, the others with their own steps on the 40 bits."""
    rows = cost_table(column_layout([template]), words)[:, :COLUMNS].T.copy()
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


def _archive(store: Store) -> tuple[str, list[str], list[QuantisedTemplate], TakeWords]:
    """Return motion, the templates of its classes, and its takes repeated to 400,000 frames.

    The motion is HDM05, with its clips, where ../shared has it; else the synthetic archive.
    """
    name = "synthetic takes"
    if HDM05.is_dir() and not SMALL:
        name = "HDM05"
        run_pipeline("ingest", BUILD / "hdm05", assignments={"source": str(HDM05)}, terminal=silent())
        store = open_store(BUILD / "hdm05")
    words = store.words()
    times = -(-FRAMES // max(1, len(words.words)))
    offsets = np.concatenate(([0], np.cumsum(np.tile(words.frames, times)))).astype(np.int64)
    many = TakeWords(np.arange(len(offsets) - 1), offsets, np.tile(words.words, times))
    names, templates = [], []
    clips = store.takes("class IS NOT NULL")
    for (label,), group in clips.sort("class", "name").group_by("class", maintain_order=True):
        examples = store.words(group["take_id"].to_list())
        names.append(str(label))
        templates.append(quantise(learn_soft([examples.take(i) for i in range(len(examples))], 40).template, DELTA))
    return name, names, templates, many


def _rankings(store: Store) -> list[Figure]:
    """Time the best hits of all classes below τ, together and one by one, and all hits; in cells of whole curves.

    A frame counts as skipped where only its coarse bound was computed. No bound could skip the blocks of 8 frames with
    a distance below τ and the 2(N − 1) frames before each of them.
    """
    archive, names, templates, words = _archive(store)
    coded, thresholds = encode(words.words), np.full(len(templates), TAU)
    takes = np.stack([words.offsets[:-1], words.offsets[1:]], axis=1)
    frames, columns = len(words.words), np.array([len(template) for template in templates])
    cells = float(columns.sum()) * frames / 1e9
    bounds = coarse_bounds(templates, coded, thresholds, takes)
    shared = seconds(lambda: coarse_bounds(templates, coded, thresholds, takes), RUNS)
    found, alone_in_all, own_in_all = [], 0.0, 0.0
    for name, template, bound in zip(names, templates, bounds, strict=True):
        hits = rank(template, words, TAU, TOP, coded=coded, coarse=bound)
        own = seconds(lambda t=template, b=bound: rank(t, words, TAU, TOP, coded=coded, coarse=b), RUNS)
        alone = seconds(lambda t=template: rank(t, words, TAU, TOP, coded=coded), RUNS)
        own, alone_in_all = own + shared * len(template) / columns.sum(), alone_in_all + alone
        title = f"{archive}, top {TOP} of {name}, {_share(hits.frames, hits.computed)} skipped"
        found.append(Figure(title, len(template) * frames / 1e9, "G cells", own, "the class alone", alone))
        own_in_all += own
    together = seconds(lambda: rank_together(templates, words, thresholds, TOP, coded), RUNS)
    count = len(templates)
    title = f"{archive}, top {TOP} of all {count} classes"
    found.append(Figure(title, cells, "G cells", together, "one by one", alone_in_all))
    computed = possible = 0
    for template, bound in zip(templates, bounds, strict=True):
        computed += len(template) * fine_bound(template, coded, TAU, takes, bound).computed
        exact = fine_bound(template, coded, TAU, takes).units < CAP
        least = np.where(np.logical_or.reduceat(exact, np.arange(0, frames, BLOCK)), 0, COARSE_CAP).astype(np.uint8)
        left = pieces_below(CoarseBound(least, TAU / COARSE_CAP), TAU, takes, 2 * (len(template) - 1))
        possible += len(template) * int((left[:, 2] - left[:, 0]).sum())
    time = seconds(lambda: rank_together(templates, words, thresholds, None, coded), 3)
    plain = seconds(lambda: [distance_curves([t], words.words, takes, np.float32) for t in templates], 1)
    whole = int(columns.sum()) * frames
    title = f"{archive}, all hits, {_share(whole, computed)} of {_share(whole, possible)} skipped"
    return [*found, Figure(title, cells, "G cells", time, "float32 curves alone", plain)]


def _share(frames: int, computed: int) -> str:
    return f"{max(0.0, 1 - computed / frames):.0%}"


def _threads() -> list[Figure]:
    """Time the ranking of ten hours by all classes, reading included, in one thread and in two."""
    searched, many = searched_classes(), made_up(THREAD_HOURS)
    one, two = (seconds(lambda w=workers: rank_takes(many, searched, TAU, TOP, workers=w), 3) for workers in (1, 2))
    cells = sum(len(each.template) for each in searched) * sum(many.takes()["frames"]) / 1e9
    title = f"{THREAD_HOURS:g} hours ranked by {len(searched)} classes, 2 threads"
    return [Figure(title, cells, "G cells", two, "1 thread", one)]


if __name__ == "__main__":
    make_console().print(show([calibrate(), *figures(synthetic()), calibrate()]))
