"""`python -m benchmarks.scaling --hours H`: measure an ingest with one and two workers, and the memory of each."""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rich import box
from rich.table import Table

from benchmarks.archive import BUILD
from benchmarks.harness import calibrate, silent
from kinedex.console.terminal import make_console
from kinedex.pipelines.engine.executors import ProcessExecutor
from kinedex.pipelines.engine.runner import run_pipeline
from kinedex.pipelines.simulation.synthetic_archive import write_archive


@dataclass(frozen=True)
class Ingest:
    """One ingest of the archive: the seconds of its stages, and the peak memory of each process in MiB.

    `seconds` runs from the first stage's start to the last one's end, without the start of Python. `peaks` are those of
    the workers; with one worker, of the only process.
    """

    workers: int
    seconds: float
    stages: dict[str, float]
    peaks: list[float]
    coordinator_peak: float


class Watched(ProcessExecutor):
    """Worker processes that report their peak memory with every result."""

    def __init__(self, workers: int) -> None:
        super().__init__(workers)
        self.peaks: dict[int, float] = {}

    def map(self, function: Callable[[Any], Any], items: Iterable[Any]) -> Iterator[Any]:
        """Apply a function to every item, and return the peak memory of the process with the results."""
        for process, peak, result in super().map(_Watching(function), items):
            self.peaks[process] = max(peak, self.peaks.get(process, 0.0))
            yield result


@dataclass(frozen=True)
class _Watching:
    function: Callable[[Any], Any]

    def __call__(self, item: Any) -> tuple[int, float, Any]:
        result = self.function(item)
        return os.getpid(), peak_mib(), result


def peak_mib() -> float:
    """Return the peak memory of this process in MiB."""
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most / (1 << 20) if sys.platform == "darwin" else most / 1024


def ingest(source: Path, store: Path, workers: int) -> Ingest:
    """Bring the archive into a fresh store, in this process; with one worker, on one core."""
    shutil.rmtree(store, ignore_errors=True)
    pools: list[Watched] = []
    with _on_cores(workers), watched(pools):
        begin = time.perf_counter()
        run_pipeline(
            "ingest", store, assignments={"source": str(source)}, executor="processes", workers=workers,
            terminal=silent(),
        )  # fmt: skip
        seconds = time.perf_counter() - begin
    from kinedex.storage.store.store import open_store

    records = open_store(store).manifest.stages
    stages = {name.split("/")[1]: record.seconds for name, record in records.items()}
    # a single item is done in this process; all other processes are workers
    peaks = [peak for pool in pools for process, peak in pool.peaks.items() if process != os.getpid()] or [peak_mib()]
    return Ingest(workers, seconds, stages, sorted(peaks), peak_mib())


@contextmanager
def _on_cores(count: int) -> Iterator[None]:
    """Keep this process and its children on some cores, so that one worker is one core, DuckDB's threads included."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, sorted(before)[:count])
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


@contextmanager
def watched(pools: list[Watched]) -> Iterator[None]:
    """Make runs of several workers use `Watched` ones."""
    from kinedex.pipelines.engine import runner

    really = runner.make_executor

    def make(kind: str, workers: int | None = None, scheduler: str | None = None) -> Any:
        if workers == 1:
            return really(kind, workers, scheduler)
        pools.append(Watched(workers or 1))
        return pools[-1]

    runner.make_executor = make
    try:
        yield
    finally:
        runner.make_executor = really


def _in_a_process_of_its_own(source: Path, workers: int) -> Ingest:
    """Measure in a new process, whose peak memory no earlier run has raised."""
    words = [sys.executable, "-m", "benchmarks.scaling", "--archive", str(source), "--only", str(workers)]
    done = subprocess.run(words, stdout=subprocess.PIPE, text=True, check=True, timeout=6 * 3600)
    return Ingest(**json.loads(done.stdout.splitlines()[-1]))


def main() -> None:
    """Make the archive if it is missing, ingest it with one worker and with two, and print the measurements."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.scaling", description=__doc__)
    parser.add_argument("--hours", type=float, default=1.0, help="of motion in the archive (an hour takes 370 MB)")
    parser.add_argument("--workers", type=int, default=2, help="how many to compare with one")
    parser.add_argument("--repeats", type=int, default=1, help="runs of each; the fastest counts")
    parser.add_argument("--archive", type=Path, help="an archive that is there, in place of a synthetic one")
    parser.add_argument("--only", type=int, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.only is not None:
        _warm_up()
        print(json.dumps(asdict(ingest(given.archive, BUILD / "scaling-store", given.only))))
        return
    source = given.archive or archive(given.hours)
    files = [path for path in source.rglob("*") if path.suffix.lower() in (".amc", ".bvh")]
    for path in files:  # fill the cache of the file system equally for both
        path.read_bytes()
    calibrations = [calibrate().rate]
    runs: list[Ingest] = []
    for _ in range(given.repeats):
        for workers in (1, given.workers):
            runs.append(_in_a_process_of_its_own(source, workers))
            calibrations.append(calibrate().rate)
    _report(given.hours, sum(path.stat().st_size for path in files) / 1e6, len(files), runs, calibrations)
    shutil.rmtree(BUILD / "scaling-store", ignore_errors=True)


def archive(hours: float) -> Path:
    """Return the folder of a synthetic archive of some hours; make it if it is missing."""
    folder = BUILD / f"archive-{60 * hours:g}min"
    write_archive(folder, minutes=60 * hours)
    return folder


def _warm_up() -> None:
    """Compile the kernels of an ingest into the cache before anything is timed."""
    small = BUILD / "archive-1min"
    write_archive(small, minutes=1)
    run_pipeline("ingest", BUILD / "scaling-warm", assignments={"source": str(small)}, terminal=silent())
    shutil.rmtree(BUILD / "scaling-warm")


def _report(hours: float, megabytes: float, files: int, runs: list[Ingest], calibrations: list[float]) -> None:
    best = {run.workers: run for run in sorted(runs, key=lambda run: -run.seconds)}
    one, several = best[1], best[max(best)]
    efficiency = one.seconds / (several.workers * several.seconds)
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for column in ("workers", "seconds", "MB/s", "stages", "peak MiB a worker", "peak MiB of the coordinator"):
        table.add_column(column, justify="left" if column == "stages" else "right", no_wrap=True)
    for run in runs:
        stages = ", ".join(f"{name} {seconds:.1f}" for name, seconds in run.stages.items())
        peaks = " ".join(f"{peak:.0f}" for peak in run.peaks)
        rate = f"{megabytes / run.seconds:.1f}"
        table.add_row(str(run.workers), f"{run.seconds:.1f}", rate, stages, peaks, f"{run.coordinator_peak:.0f}")
    console = make_console()
    console.print(f"{hours:g} hours, {files} files, {megabytes:,.0f} MB")
    console.print(table)
    console.print(
        f"{several.workers} workers reach {100 * efficiency:.0f} % of {several.workers} times one worker's rate"
    )
    console.print("calibration (numpy sort, M numbers/s): " + ", ".join(f"{rate:.1f}" for rate in calibrations))
    moment = datetime.now(UTC)
    content = {
        "moment": moment.isoformat(timespec="seconds"), "python": platform.python_version(),
        "machine": platform.machine(), "cores": os.cpu_count(), "hours": hours, "files": files,
        "megabytes": megabytes, "calibrations": calibrations, "efficiency": efficiency,
        "runs": [asdict(run) for run in runs],
    }  # fmt: skip
    path = BUILD / f"scaling-{moment:%Y%m%d-%H%M%S}.json"
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    console.print(f"written to {path}", markup=False)


if __name__ == "__main__":
    main()
