"""Start-up: seconds of a whole process, from its start to its end, beside the import of the libraries that it needs.

All processes take turns, round after round, so that a machine that slows down slows all of them; the figures are
medians. A question of tables needs numpy, PyArrow and DuckDB, a search of motion polars and numba as well.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator

from benchmarks.harness import Figure, sized
from kinedex.storage.store.store import Store

RUNS = sized(11, 1)

TABLES = "import numpy, pyarrow, duckdb"
MOTION = f"{TABLES}, polars, numba"


def figures(store: Store) -> Iterator[Figure]:
    """Time processes by turns, each beside the import of the libraries that it is compared with."""
    path, (take, take_id) = str(store.path), next(iter(store.take_ids.items()))
    stop = str(min(store.take_frames[take_id], 30))
    kinedex = [sys.executable, "-m", "kinedex"]
    processes = {
        TABLES: [sys.executable, "-c", TABLES],
        MOTION: [sys.executable, "-c", MOTION],
        "import kinedex": [sys.executable, "-c", "import kinedex"],
        "kinedex --help": [*kinedex, "--help"],
        "kinedex takes": [*kinedex, "takes", path],
        "kinedex sql": [*kinedex, "sql", path, "SELECT count(*) FROM takes"],
        "kinedex search": [*kinedex, "search", path, "example"],
        "kinedex rank": [*kinedex, "rank", path, "--take", take, "--start", "0", "--stop", stop, "--top", "10"],
    }
    # as installed, with bytecode; the first round fills its caches, and those of files and kernels
    environment = {name: text for name, text in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    times: dict[str, list[float]] = {name: [] for name in processes}
    for _ in range(RUNS + 1):
        for name, command in processes.items():
            begin = time.perf_counter()
            # into pipes: a wait with a bound for a process without one looks every 50 ms
            subprocess.run(command, check=True, capture_output=True, env=environment, timeout=300)
            times[name].append(time.perf_counter() - begin)
    median = {name: statistics.median(found[1:]) for name, found in times.items()}
    for name in processes:
        if name not in (TABLES, MOTION):
            beside = MOTION if name in ("kinedex search", "kinedex rank") else TABLES
            text = f"{beside}: {median[name] / median[beside]:.2f} of it"
            yield Figure(f"start-up: {name}", 1, "processes", median[name], text, median[beside])
