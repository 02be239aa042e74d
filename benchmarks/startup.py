"""Start-up: seconds of a whole process, from its start to its end, for the import and for four commands."""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from collections.abc import Iterator

from benchmarks.harness import Figure, sized
from kinedex.storage.store.store import Store

RUNS = sized(7, 1)


def figures(store: Store) -> Iterator[Figure]:
    """Time the best of some runs of each process, beside their median."""
    python = [sys.executable]
    processes = {
        "python -c pass": [*python, "-c", "pass"],
        "import kinedex": [*python, "-c", "import kinedex"],
        "kinedex --help": [*python, "-m", "kinedex", "--help"],
        "kinedex takes": [*python, "-m", "kinedex", "takes", str(store.path)],
        "kinedex sql": [*python, "-m", "kinedex", "sql", str(store.path), "SELECT count(*) FROM takes"],
        "kinedex search": [*python, "-m", "kinedex", "search", str(store.path), "example"],
    }
    for name, command in processes.items():
        times = []
        for _ in range(RUNS + 1):
            begin = time.perf_counter()
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
            times.append(time.perf_counter() - begin)
        # the first run fills the caches of files and of bytecode
        median = statistics.median(times[1:])
        yield Figure(f"start-up: {name}", 1, "processes", min(times[1:]), f"the median of {RUNS} runs", median)
