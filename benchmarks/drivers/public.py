"""Do the work by the command line and the public API: the driver of every commit that has none of its own."""

from __future__ import annotations

from pathlib import Path

import kinedex


def read(path: Path) -> object:
    """Read a motion file to its positions and words."""
    take = kinedex.read(path)
    return take.positions, take.words


def run_pipeline(pipeline: str | Path, store: Path, source: Path) -> None:
    """Run a pipeline over a folder, in this process."""
    kinedex.run_pipeline(pipeline, store, settings={"source": str(source)})
