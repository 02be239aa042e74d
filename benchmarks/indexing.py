"""Measure the index: words to a published index, its memory, and the cost of ten more takes; on one core."""

from __future__ import annotations

import hashlib
import math
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np

from benchmarks.archive import BUILD
from benchmarks.harness import Figure, seconds, sized
from kinedex.catalog.features import FeatureSet
from kinedex.ops.words import TakeWords
from kinedex.storage.duckdb_sql import connect, quote
from kinedex.storage.index.builder import build_index
from kinedex.storage.store.store import Store, open_store
from tests.storage.made_up import make_word_store

HOURS = sized(20.0, 0.2)


def figures(store: Store) -> list[Figure]:
    """Time the index of the store's words, repeated to twenty hours of motion."""
    large = twenty_hours(store)
    frames = float(large.takes()["frames"].sum()) / 1e6
    whole = seconds(lambda: _build_anew(large), 3)
    return [
        Figure(
            f"words to a published index, {HOURS:g} h", frames, "M frames", whole,
            "word runs alone, by SQL", seconds(lambda: _by_sql(large), 1),
        ),
        Figure("the same in a process of its own", _peak_mb(large) / 1024, "GiB at most", None),
        _ten_more(large, whole),
    ]  # fmt: skip


def twenty_hours(store: Store) -> Store:
    """Return a store of twenty hours of repeated motion; make it if it is missing."""
    words = store.words()
    return store_of_words(_tile(words, math.ceil(HOURS * 3600 * 30 / len(words.words))), store.feature_set)


def _tile(words: TakeWords, copies: int) -> TakeWords:
    return TakeWords(
        np.arange(copies * len(words), dtype=np.int64),
        np.concatenate([[0], np.cumsum(np.tile(words.frames, copies))]),
        np.tile(words.words, copies),
    )


def _build_anew(store: Store) -> Path:
    shutil.rmtree(store.path / "index", ignore_errors=True)
    return build_index(store, threads=1)


def _peak_mb(store: Store) -> float:
    """Return the peak memory of a process that builds the index, in MiB."""
    shutil.rmtree(store.path / "index", ignore_errors=True)
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.indexing", str(store.path)],
        check=True,
        capture_output=True,
        text=True,
        timeout=3600,
    )
    return float(done.stdout)


def _ten_more(store: Store, whole: float) -> Figure:
    """Time ten more takes in an index of many; every run begins with the index of the version before."""
    build_index(store)
    more = BUILD / "index-ten-more"

    def fresh() -> Store:
        shutil.rmtree(more, ignore_errors=True)
        shutil.copytree(store.path, more)
        make_word_store(more, store.feature_set, store.words(store.manifest.live_takes[:10]), "more")
        return open_store(more, at="newest")

    opened = fresh()
    kept = {path.name for path in (more / "index").glob("gen-*")}

    def build() -> None:
        for generation in (more / "index").glob("gen-*"):
            if generation.name not in kept:
                shutil.rmtree(generation)
        build_index(opened, threads=1)

    return Figure("ten takes more in that index", 10.0, "takes", seconds(build, 5), "building it whole", whole)


def _by_sql(store: Store) -> None:
    """Time the runs in SQL: gaps and islands by window functions, for the three sets of words."""
    parts = ", ".join(quote(str(store.path / part.path)) for part in store.manifest.frames)
    file = BUILD / "by-sql.duckdb"
    file.unlink(missing_ok=True)
    with connect(threads=1) as connection:
        connection.execute(f"ATTACH {quote(str(file))} AS by_sql")
        for name, home in store.feature_set.sets.items():
            connection.execute(f"""CREATE TABLE by_sql.{name} AS
                WITH cut AS (SELECT take_id, frame, (word >> {home.first - 1}) & {(1 << home.count) - 1} AS word
                    FROM read_parquet([{parts}])),
                marked AS (SELECT *, frame - row_number() OVER (PARTITION BY take_id, word ORDER BY frame) AS island
                    FROM cut)
                SELECT word, take_id, min(frame) AS start, max(frame) + 1 AS stop FROM marked
                GROUP BY take_id, word, island ORDER BY word, take_id, start""")
    file.unlink()


def store_of_words(words: TakeWords, feature_set: FeatureSet) -> Store:
    """Return a store of takes that have words and no positions; make it if it is missing."""
    path = BUILD / f"words-{hashlib.sha256(words.words.tobytes()).hexdigest()[:12]}"
    if not path.is_dir():
        half = path.with_suffix(".half")
        shutil.rmtree(half, ignore_errors=True)
        make_word_store(half, feature_set, words).rename(path)
    return open_store(path, at="newest")


def own_peak_mb() -> float:
    """Return the peak memory of this process; `getrusage` would include the process that started it."""
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return next(float(line.split()[1]) / 1024 for line in status.splitlines() if line.startswith("VmHWM"))


if __name__ == "__main__":
    build_index(open_store(sys.argv[1], at="newest"), threads=1)
    print(own_peak_mb())
