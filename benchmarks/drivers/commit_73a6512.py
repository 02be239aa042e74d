"""Do the work at commit 73a6512, which had a public API for pipelines alone: the rest is called inside of it."""

# ruff: noqa: TID251
from __future__ import annotations

import io
from pathlib import Path

from pipelines.ingesting.analysis import analyse
from pipelines.terminal import Terminal
from rich.console import Console
from storage.bodies import read_body

import kinedex
from catalog.features import load_feature_set
from catalog.skeletons import load_mappings


def read(path: Path) -> object:
    """Read a motion file to its positions and words, as the ingest read each file."""
    features = load_feature_set()
    mappings = load_mappings("auto", features.joints)
    asf = path.with_suffix(".asf") if path.suffix == ".amc" else None
    return analyse(read_body(path, asf, mappings, features.joints), features, 30.0)


def run_pipeline(pipeline: str | Path, store: Path, source: Path) -> None:
    """Run a pipeline over a folder, in this process."""
    unseen = Terminal(Console(file=io.StringIO()))
    kinedex.run_pipeline(pipeline, store, assignments={"source": str(source)}, terminal=unseen)
