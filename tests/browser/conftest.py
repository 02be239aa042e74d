"""A real browser for tests of pages: the Chromium of the system, driven by playwright, and pages of a small store."""

from __future__ import annotations

import io
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, sync_playwright
from rich.console import Console

from kinedex.console.terminal import Terminal
from kinedex.pipelines.engine.runner import run_pipeline
from tests.pipelines.archives import human_amc, write_archive

NAMES = ("chromium", "chromium-browser", "google-chrome")

PIPELINE = """
name: dances
stages:
  ingest:
    params:
      source: "${source}"
      patterns: ['clips/(?P<class>[^/]+)/x_(?P<actor>[a-z]+)_', 'takes/x_(?P<actor>[a-z]+)_']
  index:
  learn_templates:
  annotate: {params: {tau: 0.2}}
  evaluate:
  report:
settings: {source: }
"""


@pytest.fixture(scope="session")
def executable() -> str:
    """The path of Chromium; where there is none the test is skipped, and fails if a browser is required."""
    path = next((found for name in NAMES if (found := shutil.which(name))), None)
    if path is None:
        missing = "no Chromium on this machine (apt-get install chromium): pages are not looked at in a browser"
        if os.environ.get("KINEDEX_BROWSER") == "required":
            pytest.fail(missing)
        pytest.skip(missing)
    return path


@pytest.fixture(scope="session")
def browser(executable: str) -> Iterator[Browser]:
    """Chromium without a window."""
    with sync_playwright() as driver:
        chromium = driver.chromium.launch(
            executable_path=executable, args=["--no-sandbox", "--enable-unsafe-swiftshader"], timeout=60_000
        )
        yield chromium
        chromium.close()


@pytest.fixture(scope="session")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store with three classes of two clips each, two takes that hold one of each, annotations and a report."""
    folder = tmp_path_factory.mktemp("browser")
    clips = {f"clips/{name}/x_{actor}_{name}_1.amc": 90 for name in ("jig", "reel", "waltz") for actor in ("al", "bo")}
    archive = write_archive(folder / "archive", clips)
    (archive / "takes").mkdir()
    for number, actor in enumerate(("al", "bo")):
        lines = [human_amc(90, seed).splitlines()[2:] for seed in (number, 2 + number, 4 + number)]
        frames = [line if " " in line else "" for part in lines for line in part]
        count = iter(range(1, 1000))
        body = [line or str(next(count)) for line in frames]
        text = "\n".join([":FULLY-SPECIFIED", ":DEGREES", *body]) + "\n"
        (archive / "takes" / f"x_{actor}_long_1.amc").write_text(text)
    truth = [f"x_al_long_1,{name},{90 * i},{90 * i + 90}" for i, name in enumerate(("jig", "reel", "waltz"))]
    (archive / "takes" / "ground_truth.csv").write_text("\n".join(["take,class,start,stop", *truth]) + "\n")
    (folder / "dances.yaml").write_text(PIPELINE)
    quiet = Terminal(Console(file=io.StringIO()))
    run_pipeline(folder / "dances.yaml", folder / "store", settings={"source": archive}, terminal=quiet)
    return folder / "store"
