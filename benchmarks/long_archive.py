"""`python -m benchmarks.long_archive --hours H`: a large synthetic archive annotated on two cores, and a small one.

The archive is made and ingested where that has not been done (an hour of motion takes 370 MB, half of it clips, half
of it long takes). Templates are learned from the first clips of every actor and class, as many in every archive; all
long takes are annotated by worker processes, and compared with their ground truth. Printed are the speed in hours of
motion a minute, the most memory of each process, and F1 and F2.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import yaml

from benchmarks.archive import BUILD
from benchmarks.harness import silent
from benchmarks.scaling import Watched, archive, peak_mib, watched
from pipelines.config import load_pipeline
from pipelines.runner import run_pipeline
from storage.store import open_store

NAME = "long-archive"
CLIPS = 12
"""Clips of each actor and class that templates are learned from."""

METHODS: dict[str, dict[str, Any]] = {
    "thesis": {"method": "thesis"},
    "best": {"method": "best"},
    "thesis, curves kept": {"method": "thesis", "store_curves": True},
    "best, curves kept": {"method": "best", "store_curves": True},
    "thesis, learned queries": {"method": "thesis"},
    "best, learned queries": {"method": "best"},
}
DEFAULT = ("thesis", "best", "thesis, curves kept")


@dataclass(frozen=True)
class Annotated:
    """One annotation of the long takes.

    motion_hours: of the long takes. seconds: of the stage annotate. worker_mib: the most memory of each worker;
    coordinator_mib: of the process that collects and writes. searched: the share of frames that templates were
    matched in.
    """

    method: str
    takes: int
    motion_hours: float
    seconds: float
    worker_mib: list[float]
    coordinator_mib: float
    segments: int
    searched: float
    f1: float
    f2: float

    @property
    def hours_a_minute(self) -> float:
        """Hours of motion annotated in a minute."""
        return self.motion_hours / (self.seconds / 60)


def stages(source: Path, method: str | None, clips: int = CLIPS, runs: int = 8) -> dict[str, Any]:
    """A pipeline as its file says it: up to the templates, or up to the evaluation of one method."""
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


def run(source: Path, store: Path, method: str | None, workers: int, runs: int = 8) -> Annotated | None:
    """Do in this process what is missing of a pipeline, the annotation in any case; None: up to the templates only."""
    file = store.parent / f"{store.name}.yaml"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(yaml.safe_dump(stages(source, method, runs=runs), sort_keys=False), encoding="utf-8")
    force = frozenset() if method is None else frozenset({"annotate"})
    pools: list[Watched] = []
    with watched(pools):
        run_pipeline(file, store, executor="processes", workers=workers, force=force, terminal=silent())
    if method is None:
        return None
    opened = open_store(store)
    record = opened.manifest.stages[f"{NAME}/annotate"]
    scores = opened.manifest.stages[f"{NAME}/evaluate"].summary
    peaks = [peak for pool in pools for process, peak in pool.peaks.items() if process != os.getpid()]
    frames, takes = int(record.summary["frames"]), int(record.summary["takes"])
    return Annotated(
        method, takes, frames / opened.rate_hz / 3600, record.seconds, sorted(peaks), peak_mib(),
        int(record.summary["segments"]), float(record.summary["searched"]),
        float(scores["f1"]), float(scores["f2"]),
    )  # fmt: skip


def in_a_process_of_its_own(source: Path, store: Path, method: str, workers: int, runs: int) -> Annotated | None:
    """Run in a fresh process, whose peak memory no earlier stage has raised."""
    words = [sys.executable, "-m", "benchmarks.long_archive", "--archive", str(source), "--store", str(store)]
    words += ["--workers", str(workers), "--runs", str(runs), "--only", method]
    done = subprocess.run(words, stdout=subprocess.PIPE, text=True, check=True)
    line = done.stdout.splitlines()[-1]
    return None if line == "null" else Annotated(**json.loads(line))


def line(hours: str, one: Annotated) -> str:
    """A line of the table."""
    peaks = " ".join(f"{peak:.0f}" for peak in one.worker_mib) or "–"
    return (
        f"| {hours} | {one.method} | {one.takes} | {one.motion_hours:.2f} | {one.seconds:.1f} | "
        f"{one.hours_a_minute:.1f} | {peaks} | {one.coordinator_mib:.0f} | {one.searched:.1%} | {one.segments} | "
        f"{one.f1:.3f} | {one.f2:.3f} |"
    )


def main() -> None:
    """Annotate both archives with each method, and print the table as Markdown."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.long_archive", description=__doc__)
    parser.add_argument(
        "--hours", type=float, nargs="+", default=[1.0, 20.0], help="sizes of the archives, clips included"
    )
    parser.add_argument("--stores", type=Path, default=BUILD, help="folder for the stores")
    parser.add_argument("--method", action="append", choices=sorted(METHODS), help="may be repeated")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--runs", type=int, default=8, help="runs of keyframe learning, at most")
    parser.add_argument("--archive", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--store", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--only", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.only is not None:
        one = run(given.archive, given.store, given.only or None, given.workers, given.runs)
        print(json.dumps(None if one is None else asdict(one)))
        return
    print(
        "| archive, hours | method | takes | hours of takes | seconds | hours a minute | MiB of each worker | "
        "MiB of the coordinator | frames matched | segments | F1 | F2 |\n|" + "---|" * 12
    )
    for hours in given.hours:
        source, store = archive(hours), given.stores / f"long-store-{hours:g}h"
        in_a_process_of_its_own(source, store, "", given.workers, given.runs)
        for method in given.method or DEFAULT:
            found = in_a_process_of_its_own(source, store, method, given.workers, given.runs)
            assert found is not None
            print(line(f"{hours:g}", found), flush=True)


if __name__ == "__main__":
    main()
