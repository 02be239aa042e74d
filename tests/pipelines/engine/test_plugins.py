"""The examples of docs/extending are distributions that work, and faulty plugins stop only what uses them."""

from __future__ import annotations

import importlib
import io
import json
import logging
import re
import sys
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml
from rich.console import Console

from kinedex.catalog.configs import config_path
from kinedex.catalog.feature_definitions import PRIMITIVES
from kinedex.catalog.features import load_feature_set
from kinedex.catalog.plugins import PluginError
from kinedex.console.terminal import Terminal
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.annotation.methods import METHODS
from kinedex.pipelines.engine import code_digest as digests
from kinedex.pipelines.engine.config import load_pipeline
from kinedex.pipelines.engine.plan import make_plan
from kinedex.pipelines.engine.runner import run_pipeline
from kinedex.pipelines.engine.stage import STAGES
from kinedex.pipelines.stages.annotate import Annotate
from kinedex.pipelines.stages.learn_templates import LearnTemplates
from kinedex.storage.formats.motion.reader_table import READERS
from kinedex.storage.store.store import open_store
from tests.pipelines.archives import write_archive
from tests.pipelines.labelled import labelled_line

DOCS = Path(__file__).resolve().parents[3] / "docs" / "extending"
Install = Callable[..., Path]


def blocks(page: str) -> dict[str, str]:
    """The files on a page by their names."""
    text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
    return dict(re.findall(r"^`([^`\n]+)`:\n\n```\w+\n(.*?)^```", text, re.MULTILINE | re.DOTALL))


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Puts a distribution into a folder that is on the path, as pip does."""
    site = tmp_path / "site"
    site.mkdir()
    monkeypatch.syspath_prepend(str(site))

    def put(files: dict[str, str], version: str | None = None) -> Path:
        project = tomllib.loads(files["pyproject.toml"])["project"]
        name = project["name"].replace("-", "_")
        for old in site.glob(f"{name}-*"):
            old.rename(tmp_path / f"old-{old.name}")
        info = site / f"{name}-{version or project['version']}.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {version or '1.0'}\n")
        lines = [
            f"[{group}]\n" + "".join(f"{key} = {value}\n" for key, value in points.items())
            for group, points in project["entry-points"].items()
        ]
        (info / "entry_points.txt").write_text("".join(lines))
        for file, text in files.items():
            if file.endswith(".py"):
                (site / file).write_text(text, encoding="utf-8")
        forget()
        return site

    yield put
    for module in ("motion_seconds", "joints_reader", "joint_distance", "whole_take", "by_height", "broken"):
        sys.modules.pop(module, None)
    forget()


def forget() -> None:
    """Clear the caches of modules and plugins, as in a new process."""
    from kinedex.catalog import plugins

    importlib.invalidate_caches()
    for cached in (plugins._installed, plugins._warn_once, digests._digest):
        cached.cache_clear()


def silent() -> Terminal:
    return Terminal(Console(file=io.StringIO()))


def test_the_stage_of_the_page_runs_and_has_a_fingerprint(install: Install, tmp_path: Path) -> None:
    files = blocks("stage")
    site = install(files)
    source = write_archive(tmp_path / "source", {"x_walk_1.amc": 30, "x_walk_2.amc": 60, "x_kick_3.amc": 30})
    pipeline = tmp_path / "seconds.yaml"
    pipeline.write_text(files["seconds.yaml"])
    outcome = run_pipeline(pipeline, tmp_path / "store", settings={"source": source}, terminal=silent())
    assert outcome.summaries["count_seconds"]["classes"] == 2
    written = tmp_path / "store" / "results" / "reports" / "seconds" / "seconds.csv"
    assert written.read_text().splitlines()[0] == "class,seconds"

    def reason() -> str | None:
        forget()
        return make_plan(load_pipeline(pipeline, settings={"source": source}), tmp_path / "store")[1].reason

    assert reason() is None
    module = site / "motion_seconds.py"
    module.write_text(files["motion_seconds.py"].replace('"""Write `sec', '"""Put `sec') + "# a remark\n")
    assert reason() is None
    module.write_text(files["motion_seconds.py"].replace("seconds of {table", "duration of {table"))
    assert reason() == "kinedex itself changed"
    module.write_text(files["motion_seconds.py"])
    assert reason() is None
    install(files, version="1.1")
    assert reason() == "kinedex itself changed"


def test_the_reader_of_the_page_brings_takes_in(install: Install, tmp_path: Path) -> None:
    install(blocks("reader"))
    assert "joints" in READERS
    names = load_feature_set().joints
    random = np.random.default_rng(1)
    joints = {name: random.normal(size=(40, 3)).tolist() for name in names}
    (tmp_path / "source").mkdir()
    (tmp_path / "source" / "a.joints").write_text(json.dumps({"rate_hz": 60, "joints": joints}))
    run_pipeline("ingest", tmp_path / "store", settings={"source": tmp_path / "source"}, terminal=silent())
    assert open_store(tmp_path / "store").takes()["name"].to_list() == ["a"]


def test_the_primitive_of_the_page_makes_a_feature(install: Install, tmp_path: Path) -> None:
    files = blocks("primitive")
    install(files)
    content = yaml.safe_load(config_path("features", "body40").read_text())
    content["name"] = "with-distance"
    content["features"] |= yaml.safe_load(files["feature 40"])
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(content, sort_keys=False))
    assert load_feature_set(path).feature("hands_together").rule.terms[0].primitive == "distance"
    source = write_archive(tmp_path / "source", {"x_1.amc": 30})
    settings = {"source": source, "ingest.features": path}
    run_pipeline("ingest", tmp_path / "store", settings=settings, terminal=silent())
    store = open_store(tmp_path / "store")
    assert store.feature_set.plugin_primitives.keys() == {"distance"}
    plan = make_plan(load_pipeline("ingest", settings=settings), tmp_path / "store")
    assert [step.reason for step in plan] == [None, None]
    install(files, version="2.0")
    plan = make_plan(load_pipeline("ingest", settings=settings), tmp_path / "store")
    assert plan[0].reason is not None


def test_the_method_of_the_page_labels_takes(install: Install, tmp_path: Path) -> None:
    files = blocks("method")
    install(files)
    line = labelled_line(tmp_path)
    line.run(LearnTemplates, methods=["soft"])
    assert line.run(Annotate, method="whole_take")["segments"] == 2
    rows = open_store(line.store).result("annotations").to_pylist()
    assert {row["method"] for row in rows} == {"whole take"}
    assert METHODS.distribution("whole_take") == "whole-take 1.0"
    assert METHODS.distribution("best") == ""


def test_the_method_by_positions_of_the_page_labels_takes(install: Install, tmp_path: Path) -> None:
    files = blocks("method")
    project = files["pyproject.toml"].replace("whole-take", "by-height").replace("whole_take", "by_height")
    install({"pyproject.toml": project.replace("WholeTake", "ByHeight"), "by_height.py": files["by_height.py"]})
    line = labelled_line(tmp_path)
    line.run(LearnTemplates, methods=["soft"])
    assert line.run(Annotate, method="by_height")["segments"] == 2
    rows = open_store(line.store).result("annotations").to_pylist()
    assert {row["method"] for row in rows} == {"height of the root"}


BROKEN = {
    "pyproject.toml": """
[project]
name = "broken"
version = "0.1"
[project.entry-points."kinedex.stages"]
broken = "broken:Broken"
ingest = "broken:Ingest"
[project.entry-points."kinedex.readers"]
broken = "broken:Reader"
[project.entry-points."kinedex.primitives"]
speed = "broken:SPEED"
""",
    "broken.py": "import no_such_module\n",
}


def test_a_plugin_that_cannot_be_imported_stops_only_what_uses_it(
    install: Install, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    install(BROKEN)
    source = write_archive(tmp_path / "source", {"x_1.amc": 30})
    with caplog.at_level(logging.WARNING, logger="kinedex"):
        run_pipeline("ingest", tmp_path / "store", settings={"source": source}, terminal=silent())
    assert "the stage 'ingest' of broken 1.0 is not used, because a built-in stage has this name" in caplog.text
    pipeline = tmp_path / "p.yaml"
    pipeline.write_text("name: p\nstages: {broken: }\n")
    with pytest.raises(PluginError, match=r"the stage 'broken' of broken 1\.0 cannot be imported \(ModuleNotFound"):
        load_pipeline(pipeline)
    assert "'broken' of broken 1.0 cannot be imported" in caplog.text  # the reader
    assert list(STAGES).count("ingest") == 1
    assert PRIMITIVES.distribution("speed") == ""


def test_something_else_than_a_stage_is_refused(install: Install, tmp_path: Path) -> None:
    files = blocks("stage")
    install({**files, "pyproject.toml": files["pyproject.toml"].replace(":CountSeconds", ":Parameters")})
    (tmp_path / "p.yaml").write_text("name: p\nstages: {ingest: {params: {source: x}}, count_seconds: }\n")
    with pytest.raises(KinedexError, match="must be a subclass of kinedex"):
        load_pipeline(tmp_path / "p.yaml")
