"""Every command that prints a result prints it as JSON as well, and its errors in one shape."""

from __future__ import annotations

import inspect
import json
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from docs.generators.json_documents import DOCUMENTS
from kinedex.commands.app import COMMON_OPTIONS
from kinedex.commands.cli import app
from kinedex.pipelines.stages.annotate import Annotate
from kinedex.pipelines.stages.evaluate import Evaluate
from kinedex.pipelines.stages.learn_templates import LearnTemplates
from kinedex.storage.index.builder import build_index
from kinedex.storage.store.store import open_store
from tests.every_command import commands
from tests.pipelines.archives import write_archive
from tests.pipelines.labelled import Line, labelled_line

NO_RESULT = {"explore"}
"""Commands that print no result, but show it in a browser."""

OTHER_STAGES = {"track", "stabilise", "reconstruct", "simulate imu"}
"""Commands whose documents are those of `run`, or have one line for each frame."""


def test_every_command_has_json_and_a_document() -> None:
    found = {name: "as_json" in inspect.signature(callback).parameters for name, callback in commands()}
    assert {name for name, has in found.items() if not has} == NO_RESULT
    documented = {name.partition(" --")[0] for name in DOCUMENTS}
    assert {name for name, has in found.items() if has} - documented == OTHER_STAGES
    assert documented <= found.keys()


@pytest.mark.parametrize("name", [name for name, _ in commands() if name not in NO_RESULT])
def test_an_error_of_any_command_is_one_json_object(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    callback = dict(commands())[name]
    given = dict.fromkeys(inspect.signature(callback).parameters, None)
    given |= {option: default for option, (_, default) in COMMON_OPTIONS.items()}
    given |= {"as_json": True, "log_file": Path("s3://bucket/log")}
    with pytest.raises(typer.Exit) as ended:
        callback(**given)
    printed = capsys.readouterr()
    error = json.loads(printed.out)["error"]
    assert (ended.value.exit_code, printed.err) == (1, "")
    assert (list(error), error["exit_code"]) == (["type", "message", "exit_code", "remedy"], 1)


@pytest.fixture(scope="module")
def line(tmp_path_factory: pytest.TempPathFactory) -> Line:
    made = labelled_line(tmp_path_factory.mktemp("json"))
    build_index(open_store(made.store, at="newest"))
    made.run(LearnTemplates)
    made.run(Annotate)
    made.run(Evaluate)
    return made


def run(*words: object, code: int = 0) -> dict[str, Any]:
    done = CliRunner().invoke(app, [*map(str, words), "--json"], prog_name="kinedex", catch_exceptions=False)
    assert done.exit_code == code, done.output
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def test_documents_have_the_keys_of_the_reference(line: Line, tmp_path: Path) -> None:
    store = line.store
    write_archive(tmp_path / "archive", {"x_ann_hop_1.amc": 60, "x_bob_hop_2.amc": 60})
    mapping, labels = tmp_path / "mine.yaml", tmp_path / "labels.csv"
    found = {
        "init": run("init", tmp_path / "archive"),
        "synth": run("synth", tmp_path / "synthetic", "--minutes", "1", "--workers", "1"),
        "sql": run("sql", store, "SELECT 1 AS x, 2 AS x"),
        "sql --path": run("sql", store, "--path"),
        "report compare": run("report", "compare", store, store),
        "labels export": run("labels", "export", store, "-o", labels),
        "labels read": run("labels", "read", labels),
        "labels diff": run("labels", "diff", labels, labels, "--all"),
        "template list": run("template", "list", store),
        "template show": run("template", "show", store, "kick"),
        "template diff": run("template", "diff", store, "kick", "wave"),
        "template from-clip": run("template", "from-clip", store, "ann_kick_001"),
        "query from-clip": run("query", "from-clip", store, "ann_kick_001"),
        "mapping new": run("mapping", "new", tmp_path / "archive" / "x_ann_hop_1.amc", "-o", mapping),
        "mapping nodes": run("mapping", "nodes", tmp_path / "archive" / "x_ann_hop_1.amc"),
        "mapping add": run("mapping", "add", store, mapping),
        "mapping remove": run("mapping", "remove", store, "mine"),
    }
    assert {name: list(keys) for name, keys in found.items()} == {name: list(DOCUMENTS[name]) for name in found}
    assert (found["sql"]["columns"], found["sql"]["rows"]) == (["x", "x_1"], [{"x": 1, "x_1": 2}])
    assert len(found["template show"]["values"][0]) == len(found["template show"]["features"])
    assert found["labels export"]["segments"] == len(found["labels read"]["segments"]) > 0
    assert {"node": "lfemur", "name": "lknee", "reason": "by the mapping 'acclaim'", "joints": ["lknee"]} in found[
        "mapping nodes"
    ]["nodes"]
    assert found["mapping add"]["kept"] == [{"name": "mine", "file": str(mapping)}]


def test_an_error_of_usage_within_a_command_is_json_too(line: Line, tmp_path: Path) -> None:
    error = run("labels", "export", line.store, "-o", tmp_path / "x.csv", "--labels", "--limbs", code=2)["error"]
    assert (error["type"], error["exit_code"]) == ("UsageError", 2)
    assert error["message"].startswith("Invalid value: choose one of --labels and --limbs")
