"""Runs the commands of pages: by bash, in their order, in a new folder of each page."""

from __future__ import annotations

import os
import re
import shutil
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from studies.bounded_process import run_bounded
from studies.small_form import Bench
from tests.claims.outcomes import Outcome
from tests.claims.printed import ROOT
from tests.claims.ways import PageWay

MAX_SECONDS = 240.0
"""A command that takes longer fails: its form is not small."""

_YAML = re.compile(r"^```yaml\n(.*?)^```", re.DOTALL | re.MULTILINE)


def run_page(page: PageWay, bench: Bench, folder: Path) -> Iterator[Outcome]:
    """Run the commands of a page; after one that fails the others are tried, too.

    Parameters
    ----------
    page : PageWay
        How its commands are run.
    bench : Bench
        The prepared folder with data and stores.
    folder : Path
        The folder of the page; it is new.
    """
    if page.takes_real_data and not bench.data.is_dir():
        ways = [step for step in page.steps() if step.run]
        yield from (Outcome(f"{page.name}: {one.printed}", f"no {bench.data}", 0.0, "not run") for one in ways)
        return
    folder.mkdir(parents=True)
    blocks = _YAML.findall((ROOT / page.name).read_text(encoding="utf-8"))
    for place, source in page.given.items():
        to = folder / place
        to.parent.mkdir(parents=True, exist_ok=True)
        shutil.copytree(bench.path(source), to)
    for name, number in page.files.items():
        (folder / name).write_text(blocks[number], encoding="utf-8")
    for line in page.first:
        outcome = _run(f"{page.name}: first", line, line, 0, bench, folder)
        if outcome.failed:
            yield outcome
    for step in page.steps():
        if step.run:
            yield _run(f"{page.name}: {step.printed}", step.run, step.way, step.exit, bench, folder)


def _run(name: str, line: str, way: str, code: int, bench: Bench, folder: Path) -> Outcome:
    for key, path in bench.places.items():
        line = line.replace(f"{{{key}}}", path)
    programs = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = {**os.environ, "PATH": programs, "COLUMNS": "120", "PYTHONPATH": str(ROOT)}
    begin = time.perf_counter()
    ended = run_bounded(["bash", "-ec", line], folder, environment, MAX_SECONDS)
    if ended.code is None:
        result = f"took longer than {MAX_SECONDS:g} s"
    elif ended.code != code:
        result = ended.problem(f"exit code {ended.code}\n$ {line}")
    else:
        result = "ok"
    return Outcome(name, way, time.perf_counter() - begin, result)
