"""The history of a store: what ran is listed, shown, and written as a pipeline file that makes the same results."""

from __future__ import annotations

import html
import io
import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console
from typer.testing import CliRunner

from kinedex.commands.cli import app
from kinedex.console.run_overview import find_run, previous_runs, run_changes
from kinedex.console.terminal import Terminal
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.engine.run_file import export_run, run_file
from kinedex.pipelines.engine.runner import StageFailed, run_pipeline
from kinedex.pipelines.ingestion.store_repair import repair_store
from kinedex.storage.store.garbage_collection import collect_garbage
from kinedex.storage.store.history import KeptText, list_runs
from kinedex.storage.store.store import open_store
from kinedex.storage.store.verification import verify
from tests.pipelines.archives import write_archive

PIPELINE = """
name: waves
description: a pipeline of my own
settings: {source: , tau: 0.1}
stages:
  bring:
    uses: ingest
    params:
      source: "${source}"
      patterns: ['clips/(?P<class>[^/]+)/[^/]+_(?P<clip>\\d+)\\.amc', 'takes/x_(?P<clip>long\\d+)\\.']
  index:
  learn_templates:
  annotate: {params: {tau: "${tau}", classes: mine.yaml}}
  evaluate:
  report:
"""
CLASSES = "dance: {subclasses: [jig, reel]}\n"


def quiet() -> Terminal:
    return Terminal(Console(file=io.StringIO()))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with an archive, a store of three runs, and neither the pipeline file nor the class file any more."""
    folder = tmp_path_factory.mktemp("history")
    clips = {f"clips/{name}/x_{name}_{number}.amc": 80 for name in ("jig", "reel") for number in (1, 2)}
    archive = write_archive(folder / "archive", clips | {"takes/x_long1.amc": 300})
    (archive / "takes" / "ground_truth.csv").write_text("take,class,start,stop\nx_long1,dance,10,90\n")
    (folder / "own.yaml").write_text(PIPELINE)
    (folder / "mine.yaml").write_text(CLASSES)
    before = Path.cwd()
    os.chdir(folder)
    try:
        run_pipeline("own.yaml", "store", assignments={"source": "archive"}, terminal=quiet())
        with pytest.raises(StageFailed):
            run_pipeline(
                "own.yaml", "store", assignments={"source": "archive", "annotate.where": "nonsense"}, terminal=quiet()
            )
        settings = {"source": "archive", "tau": "0.2", "report.title": "it's “ours”"}
        run_pipeline("own.yaml", "store", assignments=settings, terminal=quiet())
        run_pipeline("own.yaml", "store", assignments=settings, terminal=quiet())  # nothing to do: no run
    finally:
        os.chdir(before)
    (folder / "own.yaml").unlink()
    (folder / "mine.yaml").unlink()
    return folder


def call(*words: object) -> Any:
    return CliRunner().invoke(app, [str(word) for word in words])


def results(store: Path) -> dict[str, str]:
    """The rows of all results of a store, without the ids of runs, and its evaluation."""
    opened = open_store(store, at="newest")
    kinds = {}
    for kind, parts in opened.manifest.results.items():
        if parts:
            rows = opened.result(kind)
            kinds[kind] = rows.drop_columns([name for name in ("run",) if name in rows.column_names]).to_pylist()
    kinds["frames"] = opened.answer("SELECT take_id, frame, word, rwrist FROM frames ORDER BY ALL").table.to_pylist()
    return {kind: repr(rows) for kind, rows in kinds.items()}


def test_every_run_that_did_something_is_listed_with_what_it_changed(folder: Path) -> None:
    answer = json.loads(call("history", "list", folder / "store", "--json").stdout)["runs"]
    assert [run["state"] for run in answer] == ["finished", "failed", "finished"]
    assert [run["stages"] for run in answer] == ["6 of 6 ran", "0 of 6 ran", "3 of 6 ran"]
    assert answer[0]["changes"] == "first run"
    assert "annotate.where: class IS NULL → nonsense" in answer[1]["changes"]
    assert "annotate.tau: 0.1 → 0.2" in answer[2]["changes"]
    assert [run["results"] for run in answer][1:] == ["none", "newest version"]
    shown = call("history", "show", folder / "store", answer[1]["run"]).stdout
    assert "failed" in shown
    assert "pattern clips/(?P<class>[^/]+)" in shown
    assert f"source = {folder / 'archive'}" in shown


def test_the_command_of_the_report_makes_the_same_results_in_a_new_store(folder: Path) -> None:
    page = (folder / "store/results/reports/waves/report.html").read_text(encoding="utf-8")
    match = re.search(r'<pre aria-label="Commands"[^>]*>(.*?)</pre>', page, re.DOTALL)
    assert match is not None
    script = html.unescape(re.sub(r"<[^>]+>", "", match[1]))
    place = folder / "elsewhere"
    place.mkdir()
    surroundings = os.environ | {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    done = subprocess.run(
        ["sh", "-e"],
        input=script,
        text=True,
        cwd=place,
        env=surroundings,
        capture_output=True,
        timeout=240,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    again = folder / "store-again"
    assert results(again) == results(folder / "store")
    title = open_store(again, at="newest").manifest.stages["waves/report"].summary["params"]["title"]
    assert title == "it's “ours”"


def test_a_run_whose_results_are_gone_can_still_be_repeated(folder: Path, tmp_path: Path) -> None:
    store = tmp_path / "store"
    subprocess.run(["cp", "-r", folder / "store", store], check=True, timeout=60)
    collect_garbage(store, keep=1)
    first = list_runs(store)[0]
    rows = json.loads(call("history", "list", store, "--json").stdout)["runs"]
    assert rows[0]["results"] == "partly gone"
    export_run(store, first, tmp_path / "again.yaml")
    run_pipeline(tmp_path / "again.yaml", tmp_path / "again", settings={"source": folder / "archive"}, terminal=quiet())
    run = list_runs(tmp_path / "again")[-1]
    assert [stage.params for stage in run.stages if stage.stage != "annotate"] == [
        stage.params for stage in first.stages if stage.stage != "annotate"
    ]
    assert run.stages[3].params["tau"] == 0.1
    assert Path(run.stages[3].params["classes"]).read_text() == CLASSES


def test_runs_are_found_by_id_beginning_and_pipeline(folder: Path) -> None:
    runs = list_runs(folder / "store")
    assert find_run(runs, "waves", folder) == runs[-1]
    assert find_run(runs, runs[0].run, folder) == runs[0]
    with pytest.raises(KinedexError, match="3 runs begin with"):
        find_run(runs, runs[0].run[:4], folder)
    with pytest.raises(KinedexError, match="did you mean 'waves'"):
        find_run(runs, "waved", folder)
    assert run_changes(runs[0], previous_runs(runs)[runs[0].run]) == ["first run"]


def test_a_store_of_somebody_else_writes_nothing_outside_of_the_output(folder: Path, tmp_path: Path) -> None:
    run = replace(
        list_runs(folder / "store")[0],
        mappings={"../../evil": "root: {}"},
        command="kinedex\nstages: {evil: }",
        files=(KeptText("../../evil.yaml", "0" * 64),),
    )
    with pytest.raises(KinedexError, match="no absolute path"):
        run_file(folder / "store", run, tmp_path / "x.yaml")
    made = run_file(folder / "store", replace(run, files=()), tmp_path / "x.yaml")
    assert list(made.files) == [tmp_path / "x-files" / "mappings" / "01-______evil.yaml"]
    assert "\nstages: {evil" not in made.text
    assert call("history", "export", folder / "store", "waves", "-o", tmp_path / "x.txt").exit_code == 1


def test_a_damaged_record_is_reported_and_goes_into_the_quarantine(folder: Path, tmp_path: Path) -> None:
    store = tmp_path / "store"
    subprocess.run(["cp", "-r", folder / "store", store], check=True, timeout=60)
    (record, *_) = sorted((store / "history").glob("*.json"))
    record.write_text(record.read_text().replace("finished", "famished"))
    assert [one.file for one in verify(open_store(store)) if one.fault] == [f"history/{record.name}"]
    assert "does not fit its checksum" in call("history", "list", store).output
    repair_store(store, quiet())
    assert not record.exists()
    assert [one for one in verify(open_store(store)) if one.fault] == []
