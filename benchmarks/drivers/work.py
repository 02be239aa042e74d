"""The work of each figure of `guarded.yaml`, one function a figure, in terms of what a driver can do at its commit."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from benchmarks.drivers.launcher import Bench, Driver, Measured

_ALONE = "name: ingest-alone\nsettings: {source: }\nstages: {ingest: {params: {source: '${source}'}}}\n"


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
    bench.work.mkdir(parents=True, exist_ok=True)
    alone = bench.work / "ingest-alone.yaml"
    alone.write_text(_ALONE, encoding="utf-8")
    return _ingest(bench, driver, alone)


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
