"""`python -m studies.long_archive --hours H`: annotate a large and a small synthetic archive on two cores.

The archive is made and ingested if it is missing: hours of long takes, no two alike, and half an hour of clips, the
same in every archive, from which templates are learned (an hour takes some 350 MB, 20 s of a core to make and 10 s to
ingest). All long takes are annotated by worker processes and compared with their ground truth. Printed are the seconds
of the stages before, the speed of annotation in hours of motion a minute, the peak memory of each process, and F
(frames) and F (segments) with their intervals. At last one take is added to the archive, and its cost is printed.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import polars as pl
import yaml

from benchmarks.harness import silent
from benchmarks.scaling import Watched, peak_mib, watched
from kinedex.ops.evaluation.detection import bootstrap
from kinedex.ops.evaluation.metrics import Counts
from kinedex.pipelines.engine.config import load_pipeline
from kinedex.pipelines.engine.runner import run_pipeline
from kinedex.pipelines.simulation.synthetic_archive import RECORD, write_archive
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.writer import StoreWriter
from studies import BUILD

NAME = "long-archive"
CLIP_MINUTES = 30.0
CLIPS = 12
"""The number of clips of each actor and class that templates are learned from."""

METHODS: dict[str, dict[str, Any]] = {
    "thesis": {"method": "thesis"},
    "best": {"method": "best"},
    "thesis, curves kept": {"method": "thesis", "store_curves": True},
    "best, curves kept": {"method": "best", "store_curves": True},
    "thesis, learned queries": {"method": "thesis"},
    "best, learned queries": {"method": "best"},
}
DEFAULT = ("thesis", "best", "thesis, learned queries")


@dataclass(frozen=True)
class Prepared:
    """The stages before annotation: their seconds, and the peak memory of workers and of the coordinator."""

    stages: dict[str, float]
    worker_mib: list[float]
    coordinator_mib: float


@dataclass(frozen=True)
class Annotated:
    """One annotation of the long takes.

    Attributes
    ----------
    motion_hours : float
        The length of the long takes.
    stages : dict
        The seconds of each stage that ran.
    cpu_seconds : float
        The processor time of all processes, their start and the evaluation included.
    worker_mib : list of float
        The peak memory of each worker.
    coordinator_mib : float
        The peak memory of the process that collects, writes and evaluates.
    kept : int
        The number of takes that an earlier run had annotated.
    searched : float
        The fraction of the frames in which templates were matched.
    f1, f2 : list of float
        F (frames) and F (segments), each with its 95 % interval over takes.
    """

    method: str
    takes: int
    kept: int
    motion_hours: float
    stages: dict[str, float]
    cpu_seconds: float
    worker_mib: list[float]
    coordinator_mib: float
    segments: int
    searched: float
    f1: tuple[float, float, float]
    f2: tuple[float, float, float]

    @property
    def hours_a_minute(self) -> float:
        """Return the hours of motion annotated in a minute."""
        return self.motion_hours / (self.stages["annotate"] / 60)


def stages(source: Path, method: str | None, clips: int = CLIPS, runs: int = 8) -> dict[str, Any]:
    """Return a pipeline as in a file: up to the templates, or up to the evaluation of one method."""
    train = f"class IS NOT NULL AND TRY_CAST(clip AS INTEGER) <= {clips}"
    ingest = load_pipeline("annotate", {"source": str(source)}).stage("ingest").params
    found: dict[str, Any] = {
        "ingest": {"params": {"source": str(source), "patterns": getattr(ingest, "patterns", [])}},
        "learn_templates": {"params": {"where": train, "methods": ["soft"]}},
    }
    if method is not None and "queries" in method:
        shipped = load_pipeline("keyframes").stage("learn_keyframes").params
        assert shipped is not None
        found["learn_keyframes"] = {
            "params": {**shipped.model_dump(), "where": train, "classes": "synthetic", "runs": runs}
        }
    if method is not None:
        found["annotate"] = {
            "params": {"where": "class IS NULL", "store_curves": False, "classes": "synthetic", **METHODS[method]}
        }
        found["evaluate"] = {"params": {"source": str(source), "ground_truth": "**/ground_truth.csv"}}
    return {"name": NAME, "stages": found}


def run(
    source: Path, store: Path, method: str | None, workers: int, runs: int = 8, *, anew: bool = True
) -> Annotated | Prepared:
    """Run the missing stages of a pipeline in this process; without a method up to the templates.

    Parameters
    ----------
    source : Path
        The archive.
    store : Path
        The store.
    method : str or None
        The method of annotation.
    workers : int
        The number of worker processes.
    runs : int
        The greatest number of runs of keyframe learning.
    anew : bool
        Annotate every take again.
    """
    file = store.parent / f"{store.name}.yaml"
    file.parent.mkdir(parents=True, exist_ok=True)
    pipeline = stages(source, method, runs=runs)
    file.write_text(yaml.safe_dump(pipeline, sort_keys=False), encoding="utf-8")
    pools: list[Watched] = []
    force = frozenset({"annotate"}) if anew and method is not None else frozenset[str]()
    with watched(pools):
        ran = run_pipeline(file, store, executor="processes", workers=workers, force=force, terminal=silent()).ran
    spent = os.times()  # includes workers that have ended
    cpu = spent.user + spent.system + spent.children_user + spent.children_system
    opened = open_store(store)
    records = {name.split("/")[1]: one for name, one in opened.manifest.stages.items() if name.startswith(f"{NAME}/")}
    seconds = {name: records[name].seconds for name in pipeline["stages"]}
    peaks = sorted(peak for pool in pools for process, peak in pool.peaks.items() if process != os.getpid())
    if method is None:
        return Prepared(seconds, peaks, peak_mib())
    summary = records["annotate"].summary
    f1, f2 = intervals(opened, records["evaluate"].run)
    return Annotated(
        method, int(summary["takes"]), int(summary["kept_takes"]),
        int(summary["frames"]) / opened.rate_hz / 3600, {name: seconds[name] for name in ran}, cpu, peaks, peak_mib(),
        int(summary["segments"]), float(summary["searched"]), f1, f2,
    )  # fmt: skip


def intervals(store: Store, run: str) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Return F (frames) and F (segments) of an evaluation, each with its interval over takes."""
    rows = pl.from_arrow(store.result("metrics", run=run))
    assert isinstance(rows, pl.DataFrame)
    names = list(vars(Counts()))
    counts = [Counts(**row) for row in rows.filter(pl.col("scope") == "take").select(names).iter_rows(named=True)]
    total = sum(counts, Counts())
    return (
        (total.f1, *bootstrap(lambda drawn: drawn.f1, counts)),
        (total.f2, *bootstrap(lambda drawn: drawn.f2, counts)),
    )


def in_a_process_of_its_own(
    source: Path, store: Path, method: str, workers: int, runs: int, *, anew: bool = True
) -> dict[str, Any]:
    """Run in a new process, whose peak memory no earlier stage has raised."""
    words = [sys.executable, "-m", "studies.long_archive", "--archive", str(source), "--store", str(store)]
    words += ["--workers", str(workers), "--runs", str(runs), "--only", method, *([] if anew else ["--on"])]
    done = subprocess.run(words, stdout=subprocess.PIPE, text=True, check=True, timeout=24 * 3600)
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def archive(hours: float, workers: int) -> tuple[Path, float | None]:
    """Return the folder of an archive with hours of long takes, and the seconds of its making if it was made."""
    folder = BUILD / f"long-archive-{hours:g}h"
    begin = time.perf_counter()
    made = write_archive(folder, minutes=60 * hours + CLIP_MINUTES, clip_minutes=CLIP_MINUTES, jobs=workers).made
    return folder, time.perf_counter() - begin if made else None


def one_more(source: Path) -> Path:
    """Add a take to an archive: a copy of its first one under another name, which counts as new motion."""
    first = min((source / "takes").glob("*_take*.amc"))
    added = first.with_name(first.name.split("_take")[0] + "_take99999.amc")
    shutil.copyfile(first, added)
    return added


def _forget(path: Path, take: str) -> None:
    store = open_store(path)
    with StoreWriter.open(path, store.feature_set, store.rate_hz) as writer:
        writer.drop_takes(store.takes().filter(pl.col("name") == take)["take_id"].to_list())
        writer.commit()


def line(hours: str, one: Annotated) -> str:
    """Return a line of the table."""
    return (
        f"| {hours} | {one.method} | {one.takes} | {one.stages['annotate']:.1f} | {one.hours_a_minute:.1f} | "
        f"{one.cpu_seconds:.1f} | {_mib(one.worker_mib)} | {one.coordinator_mib:.0f} | {one.searched:.1%} | "
        f"{one.segments} | {_with_interval(one.f1)} | {_with_interval(one.f2)} |"
    )


def _mib(peaks: list[float]) -> str:
    return " ".join(f"{peak:.0f}" for peak in peaks) or "–"


def _with_interval(value: tuple[float, float, float]) -> str:
    return f"{value[0]:.3f} ({value[1]:.3f}–{value[2]:.3f})"


def _seconds(stages: dict[str, float]) -> str:
    return ", ".join(f"{name} {seconds:.1f} s" for name, seconds in stages.items())


def main() -> None:
    """Annotate both archives with each method, and print the table as Markdown."""
    parser = argparse.ArgumentParser(prog="python -m studies.long_archive", description=__doc__)
    parser.add_argument("--hours", type=float, nargs="+", default=[1.0, 100.0], help="of long takes in each archive")
    parser.add_argument("--stores", type=Path, default=BUILD, help="folder for the stores")
    parser.add_argument("--method", action="append", choices=sorted(METHODS), help="may be repeated")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--runs", type=int, default=8, help="runs of keyframe learning, at most")
    parser.add_argument("--remove", action="store_true", help="remove each archive and its store when it is done")
    parser.add_argument("--archive", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--store", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--only", help=argparse.SUPPRESS)
    parser.add_argument("--on", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.only is not None:
        one = run(given.archive, given.store, given.only or None, given.workers, given.runs, anew=not given.on)
        print(json.dumps(asdict(one)))
        return
    for hours in given.hours:
        _study(hours, given)


def _study(hours: float, given: argparse.Namespace) -> None:
    source, made = archive(hours, given.workers)
    store, about = given.stores / f"long-store-{hours:g}h", json.loads((source / RECORD).read_text())["summary"]
    megabytes, files = about["bytes"] / 1e6, about["takes"] + about["clips"]
    print(f"{hours:g} hours of takes, {about['clips']} clips, {files} files, {megabytes:,.0f} MB", end="")
    print("" if made is None else f", made in {made:.0f} s")
    before = Prepared(**in_a_process_of_its_own(source, store, "", given.workers, given.runs))
    print(f"{_seconds(before.stages)}; workers {_mib(before.worker_mib)} MiB, coordinator {before.coordinator_mib:.0f}")
    print(
        "\n| hours | method | takes | seconds | hours a minute | CPU seconds | MiB of each worker | "
        "MiB of the coordinator | frames matched | segments | F (frames) (95 %) | F (segments) (95 %) |\n|"
        + "---|"
        * 12
    )
    methods = given.method or DEFAULT
    for method in methods:
        if "queries" in method:  # queries are learned in a process of their own
            in_a_process_of_its_own(source, store, method, given.workers, given.runs, anew=False)
        found = Annotated(**in_a_process_of_its_own(source, store, method, given.workers, given.runs))
        print(line(f"{hours:g}", found), flush=True)
    added = one_more(source)
    try:
        more = Annotated(**in_a_process_of_its_own(source, store, methods[-1], given.workers, given.runs, anew=False))
    finally:
        added.unlink()
        _forget(store, added.stem)
    print(f"\none take more ({methods[-1]}), {more.kept} of {more.takes} kept as they were: {_seconds(more.stages)}\n")
    if given.remove:
        shutil.rmtree(source)
        shutil.rmtree(store)


if __name__ == "__main__":
    main()
