"""Depth recordings for tests: clips of a small archive, filmed by a simulated camera."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml

from kinedex.console.terminal import Terminal
from kinedex.pipelines.simulation.simulated_depth import DepthRequest, simulate_depth
from kinedex.pipelines.stages.index import Index
from kinedex.pipelines.stages.ingest import Ingest
from kinedex.storage.store.store import open_store
from tests.pipelines.archives import context, write_archive

PATTERNS = [r"x_(?P<actor>[a-z]+)_(?P<class>hop|sway)_(?P<clip>\d)"]
FILMED = "x_al_hop_1", "x_bo_hop_1"
FRAMES = 8


def filmed_by_depth(folder: Path) -> None:
    """Make an archive of four clips in a folder, with depth recordings of two of them, whose bodies are known."""
    clips = {f"x_{actor}_{name}_1.amc": 80 for actor in ("al", "bo") for name in ("hop", "sway")}
    source = write_archive(folder / "source", clips)
    Ingest().run(context(folder / "store"), Ingest.parameters(source=str(source), patterns=PATTERNS))
    Index().run(context(folder / "store", "index"), Index.parameters())
    with open_store(folder / "store", at="newest") as store:
        request = DepthRequest(FILMED, None, 3, "tof_small", interval=(0, FRAMES))
        simulate_depth(store, request, folder / "rec", Terminal().progress)
    edit_recordings(folder, lambda entries: [entry.update(body=name) for name, entry in entries.items()])


def edit_recordings(folder: Path, change: Callable[[dict[str, dict[str, Any]]], object]) -> None:
    """Change the entries of the recordings file of a folder."""
    path = folder / "rec" / "recordings.yaml"
    content = yaml.safe_load(path.read_text())
    change(content["recordings"])
    path.write_text(yaml.safe_dump(content))
