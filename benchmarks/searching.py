"""Words to runs, and keyframe queries over them on one core: warm, cold, from 4 to 400 hours, beside other ways.

The Σ of a query counts the word runs of the lists of all its keyframes, before any are united, and "ns a run" is the
time of queries over their Σ. The search of the product starts from bit slices and not from lists: its time is that of
the whole query, from the pattern to the ranges, and nothing is subtracted for lists that would have been made. The
recursion beside it gets its lists, already united, for nothing.

The queries are the 62 of the papers' authors where `../shared/reference` has them, with motion drawn at random from the
takes there; else the shipped ones, with the takes of the synthetic archive.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pyarrow.parquet as pq

from benchmarks.archive import BUILD
from benchmarks.costplot import write_plot
from benchmarks.harness import Figure, seconds, sized
from benchmarks.indexing import store_of_words
from benchmarks.rivals import recursion, sql
from kinedex.catalog.features import FeatureSet
from kinedex.catalog.queries.keyframe_query import KeyframeQuery, word_pattern
from kinedex.catalog.queries.query_reader import read_queries
from kinedex.catalog.queries.query_writer import write_queries
from kinedex.ops.arrays import I64
from kinedex.ops.search.bit_slice_search import search_slices
from kinedex.ops.search.bit_slices import BitSlices, slice_words
from kinedex.ops.search.inverted_lists import InvertedLists, inverted_lists
from kinedex.ops.search.keyframe_search import keyframe_list, search_lists
from kinedex.ops.search.runs import word_runs
from kinedex.ops.words import TakeWords
from kinedex.pipelines.keyframes.slice_search import sliced_words
from kinedex.storage.index.builder import build_index
from kinedex.storage.store.store import Store
from tests import real_data
from tests.oracles import runs as naive_runs

HOURS = sized(4.0, 0.05)
LARGER = sized((40.0, 400.0), (0.1, 0.2))
REPEATS = sized(15, 1)
SHARED = real_data.SHARED / "reference"

F64 = npt.NDArray[np.float64]


@dataclass(frozen=True)
class _Case:
    """Motion of some hours, and the queries that are searched in it, each with its Σ."""

    words: TakeWords
    feature_set: FeatureSet
    slices: BitSlices
    chains: list[KeyframeQuery]
    runs: F64


def figures(store: Store) -> list[Figure]:
    """Time run building and search on four hours of motion and more."""
    pool, queries, what = _material(store)
    case = _case(pool, HOURS, queries, store.feature_set)
    lists = _lists(case)
    _check(case, lists)
    return [
        _runs(_tile(store.words(), HOURS)),
        *_warm(case, lists, what),
        *_cold(case, queries),
        *_in_sql(store, queries),
        *_larger(pool, queries, store.feature_set, case),
    ]


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


# ---- the material ----------------------------------------------------------------------------------------


def _material(store: Store) -> tuple[TakeWords, list[KeyframeQuery], str]:
    """Return the takes to draw from, the queries, and the name of both."""
    file = SHARED / "keyframe_queries.json"
    if not file.is_file():
        queries = [chain for query in read_queries("example", store.feature_set) for chain in query.chains]
        return store.words(), queries, f"{len(queries)} shipped queries"
    table = pq.read_table(SHARED / "feature_words.parquet")
    sampled = table.column("source_frame").to_numpy() % 4 == 0
    names = table.column("take").to_numpy()[sampled]
    words = table.column("word").to_numpy().astype(np.uint64)[sampled]
    offsets = np.concatenate([[0], np.flatnonzero(names[1:] != names[:-1]) + 1, [len(names)]])
    queries = list(read_queries(file, store.feature_set))
    return TakeWords(np.arange(len(offsets) - 1), offsets, words), queries, f"the authors' {len(queries)} queries"


def _draw(pool: TakeWords, hours: float) -> TakeWords:
    """Draw takes at random until they last some hours."""
    wanted = int(hours * 3600 * 30)
    mean = len(pool.words) / len(pool)
    chosen = np.random.default_rng(0).integers(0, len(pool), int(1.2 * wanted / mean) + 100)
    offsets = np.concatenate([[0], np.cumsum(pool.frames[chosen])])
    takes = int(np.searchsorted(offsets, wanted))
    words = np.concatenate([pool.take(int(one)) for one in chosen[:takes]])
    return TakeWords(np.arange(takes), offsets[: takes + 1], words)


def _case(pool: TakeWords, hours: float, queries: list[KeyframeQuery], feature_set: FeatureSet) -> _Case:
    words = _draw(pool, hours)
    slices = slice_words(words.words, words.offsets, len(feature_set.features))
    return _Case(words, feature_set, slices, queries, _sigma(words, queries, feature_set))


def _sigma(words: TakeWords, chains: list[KeyframeQuery], feature_set: FeatureSet) -> F64:
    """Count the word runs of all lists of each query, set by set, so that only one set's runs are in memory."""
    total = np.zeros(len(chains))
    for name, one in feature_set.sets.items():
        lists = inverted_lists(words.words, words.offsets, one.first, one.count)
        for i, chain in enumerate(chains):
            own = [keyframe for keyframe in chain.keyframes if keyframe.set == name]
            total[i] += sum(lists.runs[lists.matching(keyframe.mask, keyframe.value)].sum() for keyframe in own)
    return total


def _lists(case: _Case) -> dict[str, InvertedLists]:
    sets = case.feature_set.sets
    return {
        name: inverted_lists(case.words.words, case.words.offsets, one.first, one.count) for name, one in sets.items()
    }


def _keyframe_lists(lists: dict[str, InvertedLists], chain: KeyframeQuery) -> list[I64]:
    return [keyframe_list(lists[one.set], one.mask, one.value) for one in chain.keyframes]


def _check(case: _Case, lists: dict[str, InvertedLists]) -> None:
    """Check that slices, lists and the recursion find the same."""
    for chain in case.chains:
        made = _keyframe_lists(lists, chain)
        expected = search_lists(made, chain.bounds)
        np.testing.assert_array_equal(_answer(case, chain), expected)
        np.testing.assert_array_equal(recursion(made, chain.bounds), expected)


# ---- warm ------------------------------------------------------------------------------------------------


def _best(work: Callable[[], object], repeats: int = REPEATS) -> float:
    """Return the shortest time of several runs; other work of the machine disturbs times of microseconds."""
    times = []
    for _ in range(repeats + 1):
        began = time.perf_counter()
        work()
        times.append(time.perf_counter() - began)
    return min(times[1:])


def _each(chains: Iterable[KeyframeQuery], work: Callable[[KeyframeQuery], object], repeats: int = REPEATS) -> F64:
    return np.array([_best(lambda chain=chain: work(chain), repeats) for chain in chains])  # type: ignore[misc]


def _warm(case: _Case, lists: dict[str, InvertedLists], what: str) -> list[Figure]:
    million = float(case.runs.mean()) / 1e6
    made = {chain.name: _keyframe_lists(lists, chain) for chain in case.chains}

    def from_lists(chain: KeyframeQuery) -> object:
        return search_lists(_keyframe_lists(lists, chain), chain.bounds)

    warm = _each(case.chains, lambda chain: _answer(case, chain))
    naive = _each(case.chains, lambda chain: recursion(made[chain.name], chain.bounds), 3)
    repeated = _each(case.chains, lambda chain: search_lists(made[chain.name], chain.bounds))
    slope = _slope(case.runs, warm)
    write_plot(BUILD / "search-cost.svg", case.runs, warm, f"{what}, {HOURS:g} hours: slope {slope:.2f}")
    worst = int(warm.argmax())
    return [
        *_asked(
            f"warm query to its ranges, mean of {what}", million, float(warm.mean()), 0.15, float(naive.mean())
        ),
        *_asked(
            f"the worst of them ({case.chains[worst].name})", float(case.runs[worst]) / 1e6, float(warm.max()), 1.0,
            float(naive.max()),
        ),
        _a_run("their time over their Σ, nothing taken off", case.runs, warm, "asked of the core: at most 1.5", 1.5),
        _a_run("the same", case.runs, warm, "the recursion, from its lists to ranges", _ns(case.runs, naive)),
        Figure(
            "inverted lists and two passes, mean", million, "M runs", float(_each(case.chains, from_lists, 3).mean()),
            "its lists made before", float(repeated.mean()),
        ),
        _a_slope("slope of log time over log Σ", slope),
    ]  # fmt: skip


def _asked(name: str, million: float, took: float, most_ms: float, naive: float) -> list[Figure]:
    return [
        Figure(name, million, "M runs", took, f"asked for: {most_ms:g} ms", most_ms / 1e3),
        Figure("the same", million, "M runs", took, "the recursion, compiled, on lists made before", naive),
    ]


def _a_run(name: str, runs: F64, times: F64, other: str = "", other_amount: float | None = None) -> Figure:
    return Figure(name, _ns(runs, times), "ns a run", None, other, other_amount=other_amount)


def _ns(runs: F64, times: F64) -> float:
    return float(times.sum() / runs.sum()) * 1e9


def _a_slope(name: str, slope: float) -> Figure:
    return Figure(name, slope, "", None, "asked for: at most 1", other_amount=1.0)


def _slope(runs: F64, times: F64) -> float:
    kept = runs > 0
    return float(np.polyfit(np.log(runs[kept]), np.log(times[kept]), 1)[0])


# ---- cold, in SQL, and larger ----------------------------------------------------------------------------


def _cold(case: _Case, queries: list[KeyframeQuery]) -> list[Figure]:
    """Time a process that opens a store and answers one query: the one of median Σ, and the largest."""
    store = store_of_words(case.words, case.feature_set)
    build_index(store)
    order = np.argsort(case.runs)
    found = []
    for which, at in (("median", order[len(order) // 2]), ("largest", order[-1])):
        file = BUILD / f"query-{which}.yaml"
        file.write_text(write_queries([queries[at]], store.feature_set), encoding="utf-8")
        command = [sys.executable, "-m", "benchmarks.cold", str(store.path), str(file)]
        runs = [_process(command) for _ in range(3)]
        inside, whole = (min(times) for times in zip(*runs, strict=True))
        name = f"cold: open {HOURS:g} hours, answer the query of {which} Σ"
        found.append(Figure(name, 1.0, "queries", inside, "asked for: 0.5 s", 0.5))
        found.append(Figure("its whole process", 1.0, "processes", whole))
    return found


def _process(command: list[str]) -> tuple[float, float]:
    began = time.perf_counter()
    done = subprocess.run(command, check=True, capture_output=True, text=True, timeout=600)
    return float(done.stdout.split()[-1]), time.perf_counter() - began


def _in_sql(store: Store, queries: list[KeyframeQuery]) -> list[Figure]:
    """Time the same queries as one SQL statement each on twelve minutes; both must find the same."""
    chosen = queries[:: max(len(queries) // 6, 1)]
    ids = store.takes().sort("take_id")["take_id"].to_numpy().astype(np.int64)
    sliced = sliced_words(store.words(ids.tolist()), store.feature_set)
    connection = store.connect(threads=1)
    try:
        slow, fast = [], []
        for chain in chosen:
            text = sql(chain)
            rows = connection.sql(text).to_arrow_table()
            (ours,) = sliced.search([chain])
            takes = np.repeat(ids, np.diff(ours.offsets))
            for name, column in (("take_id", takes), ("start", ours.starts), ("stop", ours.stops)):
                np.testing.assert_array_equal(rows.column(name).to_numpy(), column)
            slow.append(_best(lambda text=text: connection.sql(text).to_arrow_table(), 2))  # type: ignore[misc]
            fast.append(_best(lambda chain=chain: sliced.search([chain])))  # type: ignore[misc]
    finally:
        connection.close()
    minutes = float(sliced.shards[0].slices.frames.sum()) / 1800
    return [
        Figure(
            f"{len(chosen)} of these queries on {minutes:.0f} minutes", float(len(chosen)), "queries", sum(fast),
            "one SQL statement each", sum(slow),
        )
    ]  # fmt: skip


def _larger(pool: TakeWords, queries: list[KeyframeQuery], feature_set: FeatureSet, small: _Case) -> list[Figure]:
    found = [_memory(small, HOURS)]
    runs, times = [small.runs], [_each(small.chains, lambda chain: _answer(small, chain), 3)]
    for hours in LARGER:
        case = _case(pool, hours, queries, feature_set)
        spent = _each(case.chains, lambda chain, case=case: _answer(case, chain), 2)  # type: ignore[misc]
        mean, worst = float(case.runs.mean()) / 1e6, float(case.runs[spent.argmax()]) / 1e6
        found.append(Figure(f"warm query at {hours:g} hours, mean", mean, "M runs", float(spent.mean())))
        found.append(Figure(f"warm query at {hours:g} hours, worst", worst, "M runs", float(spent.max())))
        found.append(_a_run(f"their time over their Σ at {hours:g} hours", case.runs, spent))
        found.append(_memory(case, hours))
        runs.append(case.runs)
        times.append(spent)
    slope = _slope(np.concatenate(runs), np.concatenate(times))
    return [*found, _a_slope(f"slope from {HOURS:g} to {LARGER[-1]:g} hours", slope)]


def _answer(case: _Case, chain: KeyframeQuery) -> I64:
    pattern = word_pattern(chain, case.feature_set)
    return search_slices(case.slices, pattern.masks, pattern.values, pattern.gaps)


def _memory(case: _Case, hours: float) -> Figure:
    words = float(case.words.words.nbytes) / 2**20
    return Figure(
        f"bit slices of {hours:g} hours", case.slices.bytes / 2**20, "MiB", None, "their words", other_amount=words
    )
