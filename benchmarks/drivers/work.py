"""The work of each figure of `guarded.yaml`, one function a figure, in terms of what a driver can do at its commit."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from benchmarks.drivers.launcher import Bench, Driver, Measured

_ALONE = "ingest: {params: {source: '${source}'}}"
_INDEXED = f"{_ALONE}, index: "
_PATTERNS = [r"clips/(?P<class>[^/]+)/[^/_]+_(?P<actor>[^/_]+)_.*_(?P<clip>\d+)_\d+\."]
_ASKED = "hour_00"
_TAU = 0.2  # every class has hits below it: for one without, a ranking today looks for the nearest place, too


# ---- reading ---------------------------------------------------------------------------------------------


def read_amc(bench: Bench, driver: Driver) -> Measured:
    """Read a long AMC file with its ASF skeleton, to positions and words."""
    return _read(bench, driver, "long.amc")


def read_bvh(bench: Bench, driver: Driver) -> Measured:
    """Read a long BVH file, to positions and words."""
    return _read(bench, driver, "long.bvh")


def read_c3d(bench: Bench, driver: Driver) -> Measured:
    """Read a long C3D file, to positions and words."""
    return _read(bench, driver, "long.c3d")


def read_trc(bench: Bench, driver: Driver) -> Measured:
    """Read a long TRC file, to positions and words."""
    return _read(bench, driver, "long.trc")


def read_small_bvh(bench: Bench, driver: Driver) -> Measured:
    """Read many short BVH files of a few skeletons."""
    files = sorted((bench.inputs / "short").rglob("*.bvh"))
    return bench.timed(lambda: [driver.read(file) for file in files], len(files))


def memory_read(bench: Bench, driver: Driver) -> Measured:
    """Read a BVH file that is large beside the program."""
    return bench.peak(lambda: driver.read(bench.inputs / "long" / "large.bvh"))


def _read(bench: Bench, driver: Driver, name: str) -> Measured:
    path = bench.inputs / "long" / name
    return bench.timed(lambda: driver.read(path), path.stat().st_size / 1e6)


# ---- ingest ----------------------------------------------------------------------------------------------


def ingest(bench: Bench, driver: Driver) -> Measured:
    """Ingest a folder of AMC files in one process, without an index."""
    return _ingest(bench, driver, _pipeline(bench, "ingest-alone", _ALONE))


def ingest_index(bench: Bench, driver: Driver) -> Measured:
    """Ingest a folder of AMC files in one process, and build the index."""
    return _ingest(bench, driver, "ingest")


def memory_ingest(bench: Bench, driver: Driver) -> Measured:
    """Ingest the folder and build the index, once, in a process that does nothing else."""
    store = bench.fresh("ingested")
    return bench.peak(lambda: driver.run_pipeline("ingest", store, bench.inputs / "archive"))


def _ingest(bench: Bench, driver: Driver, pipeline: str | Path) -> Measured:
    archive, store = bench.inputs / "archive", bench.work / "ingested"
    size = sum(file.stat().st_size for file in archive.rglob("*.amc")) / 1e6
    return bench.timed(
        lambda: driver.run_pipeline(pipeline, store, archive), size, before=lambda: bench.fresh("ingested")
    )


def features(bench: Bench, driver: Driver) -> Measured:
    """Compute the features of joint positions at 30 Hz."""
    positions, orientation = (np.load(bench.inputs / "long" / f"{name}.npy") for name in ("positions", "orientation"))
    return bench.timed(lambda: driver.features(positions, orientation, 30.0), len(positions) / 1e3)


# ---- start-up --------------------------------------------------------------------------------------------


def start_help(bench: Bench, driver: Driver) -> Measured:
    """Print the help, in a process of its own."""
    return bench.command("--help")


def start_takes(bench: Bench, driver: Driver) -> Measured:
    """List the takes of a small store, in a process of its own."""
    return bench.command("takes", str(_learned(bench, driver)))


def start_sql(bench: Bench, driver: Driver) -> Measured:
    """Ask a small store in SQL, in a process of its own."""
    return bench.command("sql", str(_learned(bench, driver)), "SELECT count(*) FROM takes")


def start_search(bench: Bench, driver: Driver) -> Measured:
    """Search a small store for the shipped keyframe queries, in a process of its own."""
    return bench.command("search", str(_learned(bench, driver)), "example")


def start_rank(bench: Bench, driver: Driver) -> Measured:
    """Rank a small store by all learned templates, in a process of its own."""
    return bench.command("rank", str(_learned(bench, driver)), "--all", "--top", "100")


# ---- questions to an open store --------------------------------------------------------------------------


def search(bench: Bench, driver: Driver) -> Measured:
    """Search hours of motion for the shipped keyframe queries."""
    return bench.timed(driver.search(_hours(bench, driver), "example"), 1.0)


def rank(bench: Bench, driver: Driver) -> Measured:
    """Rank hours of motion by all learned templates, the 100 best hits of each."""
    return bench.timed(driver.rank(_hours(bench, driver), _learned(bench, driver), 100, _TAU), 1.0)


def dtw(bench: Bench, driver: Driver) -> Measured:
    """Find all hits of all learned templates in hours of motion, so many that no bound spares distances."""
    return bench.timed(driver.rank(_hours(bench, driver), _learned(bench, driver), None, _TAU), 1.0)


def annotate_thesis(bench: Bench, driver: Driver) -> Measured:
    """Annotate hours of motion by all learned templates, with the thesis's method."""
    return bench.timed(driver.annotate(_hours(bench, driver), _learned(bench, driver), "thesis"), 1.0)


def annotate_best(bench: Bench, driver: Driver) -> Measured:
    """Annotate hours of motion by all learned templates, all frames of a take together."""
    return bench.timed(driver.annotate(_hours(bench, driver), _learned(bench, driver), "best"), 1.0)


def genetic(bench: Bench, driver: Driver) -> Measured:
    """Learn keyframe queries from the clips of a small store: four genetic runs a class."""
    learned = _learned(bench, driver)
    pipeline = _pipeline(bench, "genetic", "learn_keyframes: {params: {where: class IS NOT NULL, runs: 4}}")
    store = bench.work / "genetic-store"
    return bench.timed(
        lambda: driver.run_pipeline(pipeline, store, bench.inputs / "archive"),
        1.0,
        before=lambda: shutil.copytree(learned, bench.fresh("genetic-store")),
    )


def _learned(bench: Bench, driver: Driver) -> Path:
    """Return a store of the archive with its index and templates; it is made once."""
    stages = f"ingest: {{params: {{source: '${{source}}', patterns: {json.dumps(_PATTERNS)}}}}}, index: , "
    pipeline = _pipeline(bench, "learned", stages + "learn_templates: {params: {where: class IS NOT NULL}}")
    return _stored(bench, driver, pipeline, bench.inputs / "archive")


def _hours(bench: Bench, driver: Driver) -> Path:
    """Return a store of hours of motion with its index; it is made once."""
    return _stored(bench, driver, _pipeline(bench, "hours", _INDEXED), bench.inputs / "hours")


def _pipeline(bench: Bench, name: str, stages: str) -> Path:
    path = bench.work / f"{name}.yaml"
    path.write_text(f"name: {name}\nsettings: {{source: }}\nstages: {{{stages}}}\n", encoding="utf-8")
    return path


def _stored(bench: Bench, driver: Driver, pipeline: Path, source: Path) -> Path:
    done, store = pipeline.with_suffix(".made"), pipeline.with_suffix("")
    if not done.is_file():
        bench.fresh(store.name)
        driver.run_pipeline(pipeline, store, source)
        done.touch()
    return store


# ---- recordings ------------------------------------------------------------------------------------------


def track(bench: Bench, driver: Driver) -> Measured:
    """Track a take of a minute that four simulated cameras film."""
    return _recorded(bench, driver, "cameras", driver.track, ())


def reconstruct(bench: Bench, driver: Driver) -> Measured:
    """Reconstruct two seconds that a simulated depth camera films."""
    return _recorded(bench, driver, "depth", driver.reconstruct, ("--frames", "0:60"))


def limb_errors(bench: Bench, driver: Driver) -> Measured:
    """Judge the limbs of a take by five simulated inertial sensors."""
    limbs = [word for limb in ("torso", "lthigh", "rthigh", "lshank", "rshank") for word in ("--limb", limb)]
    return _recorded(bench, driver, "imu", driver.limb_errors, limbs)


def _recorded(
    bench: Bench, driver: Driver, kind: str, work: Callable[[Path, Path], object], options: Sequence[str]
) -> Measured:
    """Time work on a recording of the longest take, each time in a copy of the store."""
    learned, made = _learned(bench, driver), bench.work / kind
    if not made.is_dir():
        driver.simulate(kind, learned, made, options)
    store = bench.work / "recorded-store"
    return bench.timed(lambda: work(store, made), 1.0, before=lambda: shutil.copytree(learned, bench.fresh(store.name)))


# ---- the explorer ----------------------------------------------------------------------------------------


def explore_example(bench: Bench, driver: Driver) -> Measured:
    """Ask the explorer's server for what is like two seconds of a take, on both sides of the body."""
    question = {"positives": [{"take": _ASKED, "start": 300, "stop": 360}], "mirror": True, "top": 60}
    return _answered(bench, driver, "/api/ask/examples", question)


def explore_keyframes(bench: Bench, driver: Driver) -> Measured:
    """Ask the explorer's server by keyframes."""
    query = {"name": "asked", "poses": [{"on": ["lknee_bent"], "off": []}, {"on": ["rknee_bent"], "off": []}]}
    return _answered(bench, driver, "/api/ask/keyframes", {"query": {**query, "gaps": [{"low": 0, "high": 1}]}})


def _answered(bench: Bench, driver: Driver, path: str, question: dict[str, object]) -> Measured:
    with driver.explorer(_hours(bench, driver)) as ask:
        return bench.timed(lambda: ask(path, question), 1.0)
