"""Measure the memory of two processes that search an archive at the same time, with mapped slices and with own copies.

Counted is the memory that a process has gained since it opened the store, by `Pss` of `/proc/self/smaps_rollup`: a
page that two processes share counts half for each.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np

from benchmarks.harness import Figure
from benchmarks.indexing import HOURS, twenty_hours
from kinedex.catalog.queries.query_reader import read_queries
from kinedex.ops.words import TakeWords
from kinedex.pipelines.keyframes.slice_search import sliced_store, sliced_words
from kinedex.storage.index.builder import build_index
from kinedex.storage.store.store import Store, open_store

PROCESSES = 2


def figures(store: Store) -> list[Figure]:
    """Measure two processes that search the same twenty hours."""
    large = twenty_hours(store)
    build_index(large)
    mapped, own = (_together(large.path, how) for how in ("mapped", "own"))
    return [
        Figure(
            f"{PROCESSES} processes search {HOURS:g} h, slices mapped", mapped, "MiB in all", None,
            "each its own slices", other_amount=own,
        )
    ]  # fmt: skip


def _together(store: Path, how: str) -> float:
    command = [sys.executable, "-m", "benchmarks.sharing", str(store), how]
    readers = [
        subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) for _ in range(PROCESSES)
    ]
    total = 0.0
    try:
        # each process prints a line after its search; their memory is read when all have
        for reader in readers:
            assert reader.stdout is not None
            reader.stdout.readline()
        for reader in readers:
            assert reader.stdin is not None
            assert reader.stdout is not None
            reader.stdin.write("now\n")
            reader.stdin.flush()
            total += float(reader.stdout.readline())
    finally:
        for reader in readers:
            reader.communicate(timeout=60)
    return total


def _pss_mib() -> float:
    lines = Path("/proc/self/smaps_rollup").read_text(encoding="ascii").splitlines()
    return next(float(line.split()[1]) / 1024 for line in lines if line.startswith("Pss:"))


def main(path: str, how: str) -> None:
    """Search the shipped queries, and print the memory gained since the start."""
    store = open_store(path)
    queries = read_queries("example", store.feature_set)
    few = TakeWords(np.zeros(1, np.int64), np.array([0, 1]), np.zeros(1, np.uint64))
    sliced_words(few, store.feature_set).search(queries)  # compiled before memory is measured
    before = _pss_mib()
    if how == "mapped":
        sliced = sliced_store(store)
    else:
        sliced = sliced_words(store.words(), store.feature_set)
    sliced.search(queries)
    print("searched", flush=True)
    sys.stdin.readline()
    print(_pss_mib() - before, flush=True)
    sys.stdin.read()


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
