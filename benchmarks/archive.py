"""The archive that benchmarks work on: synthetic, made once into build/, brought into a store once."""

from __future__ import annotations

from pathlib import Path

from benchmarks.harness import silent
from kinedex.pipelines.engine.runner import run_pipeline
from kinedex.pipelines.synth.archive import write_archive
from kinedex.storage.store.store import Store, open_store

BUILD = Path(__file__).resolve().parents[1] / "build" / "bench"
MINUTES = 12.0


def archive() -> Path:
    """The folder of the synthetic archive."""
    folder = BUILD / f"archive-{MINUTES:g}min"
    if not (folder / "takes" / "ground_truth.csv").is_file():
        write_archive(folder, minutes=MINUTES)
    return folder


def store() -> Store:
    """A store of that archive with its index."""
    path = BUILD / "store"
    run_pipeline("ingest", path, assignments={"source": str(archive())}, terminal=silent())
    return open_store(path)
