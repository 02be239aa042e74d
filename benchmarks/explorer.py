"""`python -m benchmarks explorer`: time what the explorer asks of 100 hours, beside the same work by SQL or Python.

Searches run in this process as the server runs them, on two threads and warm; `benchmarks.explorer_archive` describes
the archive.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from benchmarks.explorer_archive import hundred_hours
from benchmarks.harness import Figure, calibrate, seconds, show, sized
from benchmarks.rivals import sql
from kinedex.catalog.queries.keyframe_query import KeyframeQuery
from kinedex.catalog.queries.query_reader import read_queries
from kinedex.console.terminal import make_console
from kinedex.ops.distances.dtw import distance_curves
from kinedex.ops.intervals import Hit, Interval
from kinedex.ops.templates.templates import quantise
from kinedex.pipelines.keyframes.proposed_query import propose_query
from kinedex.pipelines.keyframes.slice_search import stored_words
from kinedex.pipelines.keyframes.store_search import search_store
from kinedex.pipelines.templates.example_ranking import rank_by_examples
from kinedex.pipelines.templates.store_ranking import DELTA, EXAMPLE_TAU, RankingQuestion
from kinedex.pipelines.templates.stored_templates import template_from_clip
from kinedex.storage.store.store import Store

RUNS, THREADS, TOP = sized(5, 1), 2, 60
EXAMPLE_SECONDS, QUERY_SECONDS = 0.5, 0.15
"""The times that are asked for, of a search by example and of one by keyframes."""

LENGTHS = (30, 60, 120)
"""The frames of the examples."""

PLAIN_TAKES = sized(20, 4)
"""The curves of so many takes are timed for the comparison, and counted for all frames."""


ASKED = RankingQuestion(tau=EXAMPLE_TAU, top=TOP, mirror=True, workers=THREADS)


def figures(_: Store | None = None) -> list[Figure]:
    """Time searches by example and by keyframes over 100 hours."""
    store = hundred_hours()
    hours = sum(store.take_frames.values()) / store.rate_hz / 3600
    return [*_examples(store, hours), *_keyframes(store, hours), *_words(store, hours)]


def _examples(store: Store, hours: float) -> list[Figure]:
    """Time searches by examples, mirror images included, beside all distance curves and the time asked for."""
    take = store.takes("class IS NULL").sort("take_id")["name"][0]
    found = []
    for length in LENGTHS:
        example = template_from_clip(store, take, 300, 300 + length)
        hit = Hit(Interval(take, 300, 300 + length))
        took = seconds(lambda one=example, at=hit: rank_by_examples(store, one, [at], ASKED), RUNS)  # type: ignore[misc]
        title = f"{TOP} best of {hours:.0f} h by an example of {length / store.rate_hz:g} s, both sides"
        found.append(Figure(title, hours, "hours", took, f"asked for: {EXAMPLE_SECONDS:g} s", EXAMPLE_SECONDS))
        template = quantise(example.template, DELTA)
        some = stored_words(store, sorted(store.take_frames)[-PLAIN_TAKES:])
        ranges = np.stack([some.offsets[:-1], some.offsets[1:]], axis=1)
        curves = seconds(lambda t=template, w=some.words, r=ranges: distance_curves([t], w, r, np.float32), 2)  # type: ignore[misc]
        whole = 2 * curves * sum(store.take_frames.values()) / len(some.words) / THREADS
        found.append(Figure("the same", hours, "hours", took, "float32 curves of all frames", whole))
    return found


def _keyframes(store: Store, hours: float) -> list[Figure]:
    """Time keyframe queries with their tables of hits, beside one statement of SQL and the time asked for."""
    queries = read_queries("example", store.feature_set)
    times = [seconds(_searching(store, [query]), RUNS) for query in queries]
    slowest = int(np.argmax(times))
    take = store.takes("class IS NULL").sort("take_id")["name"][0]
    chain = queries[0].chains[0]
    with store.connect(threads=THREADS) as connection:
        by_sql = seconds(lambda: connection.sql(sql(chain)).to_arrow_table(), 1)
    return [
        Figure(
            f"keyframe query over {hours:.0f} h with its hits, mean of {len(queries)}", 1.0, "queries",
            float(np.mean(times)), f"asked for: {QUERY_SECONDS:g} s", QUERY_SECONDS,
        ),
        Figure(
            f"the slowest of them ({queries[slowest].name})", 1.0, "queries", times[slowest],
            f"asked for: {QUERY_SECONDS:g} s", QUERY_SECONDS,
        ),
        Figure(
            f"one of them ({chain.name})", 1.0, "queries", seconds(_searching(store, [chain]), RUNS),
            "one SQL statement", by_sql,
        ),
        Figure(
            "keyframes proposed from two seconds", 1.0, "proposals",
            seconds(lambda: propose_query(store, take, 300, 360), 2),
        ),
    ]  # fmt: skip


def _searching(store: Store, queries: Sequence[KeyframeQuery]) -> Callable[[], object]:
    return lambda: search_store(store, queries, threads=THREADS)


def _words(store: Store, hours: float) -> list[Figure]:
    """Measure the memory of this process, and time the words of all takes from the index, beside the Parquet parts."""
    memory = _own_mib()
    ids = sorted(store.take_frames)
    mapped = seconds(lambda: stored_words(store, ids), RUNS)
    return [
        Figure("memory of this process, without mapped files", memory, "MiB", None, "asked for: at most 500 MiB",
               other_amount=500.0),
        Figure(f"words of {hours:.0f} h from the index", hours, "hours", mapped, "from the parts",
               seconds(lambda: store.words(ids), 2)),
    ]  # fmt: skip


def _own_mib() -> float:
    """Return the memory that belongs to this process alone; pages of mapped files are not among it."""
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return next(float(line.split()[1]) / 1024 for line in status.splitlines() if line.startswith("RssAnon"))


if __name__ == "__main__":
    make_console().print(show([calibrate(), *figures(), calibrate()]))
