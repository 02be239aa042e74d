"""A small synthetic archive with its store, built once for all tests of the Python interface."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

import kinedex
from kinedex.pipelines.simulation.synthetic_archive import write_archive

PATIENCE_S = 600


def public_members(one: type) -> dict[str, Any]:
    """The public methods and properties of a class and of its bases in kinedex, and `__getitem__`."""
    bases = [base for base in reversed(one.__mro__) if base.__module__.startswith("kinedex")]
    found = {name: value for base in bases for name, value in vars(base).items()}
    return {name: value for name, value in found.items() if not name.startswith("_") or name == "__getitem__"}


@pytest.fixture(scope="session")
def demo(tmp_path_factory: pytest.TempPathFactory, worker_id: str) -> Path:
    """A folder with `archive` (three minutes of motion) and `store` (after a whole run of the pipeline annotate)."""
    shared = tmp_path_factory.getbasetemp().parent if worker_id != "master" else tmp_path_factory.getbasetemp()
    folder, done = shared / "api-demo", shared / "api-demo.done"
    try:
        folder.mkdir()
    except FileExistsError:
        _wait_for(done)
        return folder
    write_archive(folder / "archive", minutes=3, actors=2, jobs=1)
    kinedex.run_pipeline("annotate", folder / "store", {"source": folder / "archive", "classes": "synthetic"})
    done.touch()
    return folder


def _wait_for(done: Path) -> None:
    begin = time.monotonic()
    while not done.exists():
        assert time.monotonic() - begin < PATIENCE_S, "another test process did not finish the archive"
        time.sleep(0.1)


@pytest.fixture
def store(demo: Path) -> Iterator[kinedex.Store]:
    with kinedex.open_store(demo / "store") as opened:
        yield opened


@pytest.fixture
def motion_file(demo: Path) -> Path:
    """An AMC file at 120 frames per second, of which the store has the take."""
    return min((demo / "archive" / "clips" / "squat1Reps").glob("*.amc"))


@pytest.fixture(scope="session")
def squats(demo: Path) -> tuple[kinedex.Template, pl.DataFrame]:
    """The template of all squats, and its annotations of the long takes."""
    with kinedex.open_store(demo / "store") as opened:
        clips = [opened[name] for name in opened.takes("class = 'squat1Reps'")["name"]]
        template = kinedex.Template.learn(clips, name="squat")
        return template, kinedex.annotate(opened, template, where="class IS NULL")


@pytest.fixture
def names(
    demo: Path,
    store: kinedex.Store,
    squats: tuple[kinedex.Template, pl.DataFrame],
    motion_file: Path,
    tmp_path: Path,
) -> dict[str, object]:
    """The names that examples of docstrings use; `tests/library/test_doctests.py` lists them for readers."""
    template, annotations = squats
    return {
        "kinedex": kinedex,
        "np": np,
        "pl": pl,
        "Take": kinedex.Take,
        "Template": kinedex.Template,
        "store": store,
        "store_path": demo / "store",
        "archive": demo / "archive",
        "motion_file": motion_file,
        "take": store[motion_file.stem],
        "clips": [store[name] for name in store.takes("class = 'squat1Reps'")["name"]],
        "template": template,
        "annotations": annotations,
        "folder": tmp_path,
    }


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path) -> Iterator[None]:
    before = Path.cwd()
    os.chdir(tmp_path)
    yield
    os.chdir(before)
