"""Addresses with a scheme are refused by every command and every public function, before anything is written."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
import yaml
from typer.testing import CliRunner

import kinedex
from kinedex.catalog.camera_recordings import load_recordings
from kinedex.catalog.configs import parse_yaml
from kinedex.catalog.depth_recordings import load_depth_recordings
from kinedex.catalog.queries.query_reader import referred_path
from kinedex.commands.app import COMMON_OPTIONS, NO_PATHS
from kinedex.commands.cli import app
from kinedex.ops.errors import ConfigError, KinedexError, SourceError
from kinedex.ops.local_paths import refuse_addresses
from kinedex.pipelines.engine.config import load_pipeline
from kinedex.storage.formats.depth.frame_files import find_frames
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


CAMERAS = {"rate_hz": 60, "cameras": "calib.toml", "keypoints": "pose/*.json"}
DEPTH = {"depth": "frames/*.png"}
PIPELINE = "name: mine\nstages:\n  ingest:\n    params:\n      source: {source}\n      metadata: [{metadata}]\n"
QUERY = "name: kicks\nsequence:\n  - file: {file}\n    query: kick\n"


@pytest.mark.parametrize(
    ("given", "key", "load"),
    [(CAMERAS, key, load_recordings) for key in ("cameras", "keypoints", "silhouettes", "keypoint_set", "truth")]
    + [(DEPTH, key, load_depth_recordings) for key in ("depth", "camera", "background", "truth")],
)  # fmt: skip
def test_files_named_in_recordings_are_refused_with_their_line(
    given: dict[str, object], key: str, load: Callable[[Path], object], tmp_path: Path
) -> None:
    file = tmp_path / "recordings.yaml"
    file.write_text(yaml.safe_dump({"recordings": {"walk": given | {key: ADDRESS}}}, sort_keys=False))
    line = 1 + next(n for n, one in enumerate(file.read_text().splitlines()) if ADDRESS in one)
    with pytest.raises(ConfigError, match=re.escape(SENTENCE)) as refused:
        load(file)
    assert (refused.value.line, refused.value.key) == (line, f"recordings.walk.{key}")


@pytest.mark.parametrize(("source", "metadata", "line"), [(ADDRESS, "a.csv", 5), ("here", ADDRESS, 6)])
def test_paths_in_pipeline_files_are_refused_with_their_line(
    source: str, metadata: str, line: int, tmp_path: Path
) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(PIPELINE.format(source=f'"{source}"', metadata=f'"{metadata}"'))
    with pytest.raises(ConfigError, match=re.escape(SENTENCE)) as refused:
        load_pipeline(str(file))
    assert refused.value.line == line


def test_settings_of_pipeline_files_are_refused_unless_another_value_is_given(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    text = PIPELINE.format(source='"${source}"', metadata="a.csv")
    file.write_text(f'settings:\n  source: "{ADDRESS}"\n{text}')
    with pytest.raises(ConfigError, match=re.escape(SENTENCE)) as refused:
        load_pipeline(str(file))
    assert refused.value.line == 2
    load_pipeline(str(file), {"source": str(tmp_path)})


@pytest.mark.parametrize("pattern", ["s3://bucket/takes/*.csv", "gs://b/**/ground_truth.csv"])
def test_patterns_of_ground_truth_are_refused(pattern: str, tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    stages = "stages:\n  ingest: {params: {source: here}}\n  learn_templates: {}\n  annotate: {}\n"
    file.write_text(f'name: mine\n{stages}  evaluate:\n    params:\n      ground_truth: "{pattern}"\n')
    with pytest.raises(ConfigError, match="files of this machine alone") as refused:
        load_pipeline(str(file))
    assert refused.value.line == 8


def test_query_files_refuse_an_address_of_another_one(tmp_path: Path) -> None:
    located = parse_yaml(QUERY.format(file=f'"{ADDRESS}.yaml"'), tmp_path / "q.yaml")
    with pytest.raises(ConfigError, match="files of this machine alone") as refused:
        referred_path(located, f"{ADDRESS}.yaml", "sequence", 0, "file")
    assert refused.value.line == 3


def test_lists_of_depth_frames_refuse_an_address(tmp_path: Path) -> None:
    (tmp_path / "depth.txt").write_text(f"# time file\n0.5 {ADDRESS}.png\n")
    with pytest.raises(SourceError, match="files of this machine alone") as refused:
        find_frames(tmp_path, "depth.txt")
    assert refused.value.line == 2


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
