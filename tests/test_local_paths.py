"""Addresses with a scheme are refused by every command and every public function, before anything is written."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

import kinedex
from kinedex.ops.errors import KinedexError
from kinedex.ops.local_paths import refuse_addresses
from kinedex.pipelines.commands.app import COMMON_OPTIONS, NO_PATHS
from kinedex.pipelines.commands.cli import app
from kinedex.pipelines.engine.config import load_pipeline
from tests.every_command import commands

ADDRESS = "s3://bucket/takes"
SENTENCE = (
    "s3://bucket/takes: kinedex reads and writes files of this machine alone; copy the data to a folder, or mount it "
    "as one, and give the path of that"
)


def command_parameters() -> list[Any]:
    return [
        pytest.param(callback, one.name, str(one.annotation), id=f"{name}:{one.name}")
        for name, callback in commands()
        for one in inspect.signature(callback).parameters.values()
        if ("Path" in str(one.annotation) or "str" in str(one.annotation)) and one.name not in NO_PATHS
    ]


@pytest.mark.parametrize(("callback", "parameter", "annotation"), command_parameters())
def test_every_command_refuses_an_address_for_every_path_and_text(
    callback: Callable[..., None], parameter: str, annotation: str, capsys: pytest.CaptureFixture[str]
) -> None:
    value: object = Path(ADDRESS) if "Path" in annotation else ADDRESS
    given = dict.fromkeys(inspect.signature(callback).parameters, None)
    given |= {name: default for name, (_, default) in COMMON_OPTIONS.items()}
    given[parameter] = [value] if "list[" in annotation else value
    with pytest.raises(typer.Exit) as ended:
        callback(**given)
    assert ended.value.exit_code == 1
    assert capsys.readouterr().err == f"kinedex: {SENTENCE}\n"


def public_parameters() -> Iterator[Any]:
    for name in kinedex.__all__:
        value = getattr(kinedex, name)
        if inspect.isfunction(value):
            members = {name: value}
        elif inspect.isclass(value) and not issubclass(value, Exception):
            own = {method: getattr(value, method) for method in dir(value) if not method.startswith("_")}
            members = {f"{name}.{method}": one for method, one in own.items() if callable(one)}
            members |= {name: value} if value is not kinedex.Outcome else {}  # a result, which nobody makes
        else:
            members = {}
        for words, function in members.items():
            for one in inspect.signature(function).parameters.values():
                if "Path" in str(one.annotation):
                    yield pytest.param(function, one.name, id=f"{words}:{one.name}")


@pytest.mark.parametrize(("function", "parameter"), list(public_parameters()))
def test_every_public_function_refuses_an_address(function: Callable[..., Any], parameter: str) -> None:
    named: dict[str, Any] = {}
    for one in inspect.signature(function).parameters.values():
        if one.name == parameter:
            named[one.name] = ADDRESS
        elif one.default is inspect.Parameter.empty and one.kind not in (one.VAR_POSITIONAL, one.VAR_KEYWORD):
            named[one.name] = None
    with pytest.raises(KinedexError) as refused:
        function(**named)
    assert str(refused.value) == SENTENCE


def test_the_walks_find_what_they_look_for() -> None:
    names = {one.id for one in command_parameters()}
    assert names >= {
        "export:output",
        "labels export:output",
        "synth:directory",
        "ingest:store",
        "run:store",
        "demo:data",
    }
    assert {one.id for one in public_parameters()} >= {"open_store:path", "read:path", "Query.save:path"}


@pytest.mark.parametrize(
    "words",
    [
        ("synth", ADDRESS),
        ("ingest", ADDRESS, "here"),
        ("ingest", "store", ADDRESS),
        ("run", "ingest", "--store", ADDRESS, "--set", "source=here"),
        ("run", "ingest", "--store", "store", "--set", f"source={ADDRESS}"),
        ("run", "ingest", "--store", "store", "--set", "source=here", "--set", f'ingest.metadata=["{ADDRESS}"]'),
        ("demo", ADDRESS),
        ("labels", "export", "store", "--output", ADDRESS),
        ("takes", "store", "--log-file", ADDRESS),
    ],
)
def test_nothing_is_made_in_the_present_folder(
    words: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, words, prog_name="kinedex", catch_exceptions=False)
    assert (done.exit_code, done.stderr) == (1, f"kinedex: {SENTENCE}\n")
    assert list(tmp_path.iterdir()) == []


def test_a_pipeline_in_python_refuses_an_address() -> None:
    with pytest.raises(KinedexError, match="files of this machine alone"):
        load_pipeline("ingest", None, {"source": ADDRESS})


@pytest.mark.parametrize("text", ["gs://b/x", "http://a.b/x.amc", "HTTPS://a", "x://y", "abfs+ssl://c@d/e"])
def test_all_schemes_are_refused(text: str) -> None:
    with pytest.raises(KinedexError, match="files of this machine alone"):
        refuse_addresses({"a": [text]})


@pytest.mark.parametrize(
    ("text", "path"), [("file:///data/x", "/data/x"), ("file://localhost/data", "/data"), ("file:///", "/")]
)
def test_an_address_of_a_file_shows_its_path(text: str, path: str) -> None:
    with pytest.raises(KinedexError, match=f"without a scheme; give {path}$"):
        refuse_addresses(text)


@pytest.mark.parametrize(
    "value",
    ["/data/x", "data/x", "C:/data", Path("C:/data"), Path("a:b/c"), "a:b", "name = 'x://y'", None, 3, "", b"x"],
)
def test_paths_and_other_values_pass(value: object) -> None:
    refuse_addresses(value)
    refuse_addresses([value])
