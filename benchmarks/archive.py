"""Make the synthetic archive of the benchmarks, and its store, once in build/."""

from __future__ import annotations

from pathlib import Path

from benchmarks.harness import BUILD, silent, sized
from kinedex.pipelines.engine.runner import run_pipeline
from kinedex.pipelines.simulation.synthetic_archive import write_archive
from kinedex.storage.store.store import Store, open_store

MINUTES = sized(12.0, 2.0)


def archive() -> Path:
    """Return the folder of the synthetic archive; make it if it is missing."""
    folder = BUILD / f"archive-{MINUTES:g}min"
    if not (folder / "takes" / "ground_truth.csv").is_file():
        write_archive(folder, minutes=MINUTES)
    return folder


def store() -> Store:
    """Return a store of that archive with its index."""
    path = BUILD / "store"
    run_pipeline("ingest", path, assignments={"source": str(archive())}, terminal=silent())
    return open_store(path)
