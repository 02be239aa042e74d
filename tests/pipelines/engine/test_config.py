"""Pipeline files: their content, what the user sets, and how wrong ones are refused."""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np
import pytest

from kinedex.catalog.configs import config_names, config_path, load_yaml
from kinedex.ops.errors import ConfigError, KinedexError
from kinedex.pipelines.engine.config import load_pipeline
from kinedex.pipelines.engine.stage import BUILT_IN, Input, load_stage

GOOD = """
name: small
description: two stages
settings:
  source:
  rate: 120
stages:
  index:
  ingest:
    params:
      source: ${source}
      rate_hz: ${rate}
      patterns: ['${source}/(?P<actor>x)']
"""


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "p.yaml"
    path.write_text(text)
    return path


def test_settings_fill_parameters_and_keep_their_type(tmp_path: Path) -> None:
    pipeline = load_pipeline(write(tmp_path, GOOD), {"source": "/data", "rate": "60"})
    assert [stage.name for stage in pipeline.stages] == ["ingest", "index"]
    params = pipeline.stage("ingest").params.model_dump()
    assert (params["source"], params["rate_hz"], params["patterns"]) == ("/data", 60.0, ["/data/(?P<actor>x)"])
    assert pipeline.stage("index").inputs == {"takes": "ingest"}


def test_a_parameter_can_be_set_from_outside(tmp_path: Path) -> None:
    pipeline = load_pipeline(write(tmp_path, GOOD), {"source": "/data", "ingest.prune": "true"})
    assert pipeline.stage("ingest").params.model_dump()["prune"] is True


@pytest.mark.parametrize(
    ("change", "assignments", "line", "message"),
    [
        (("rate: 120", "rate: fast"), {"source": "x"}, 12, "ingest.params.rate_hz: must be a valid number"),
        (("rate_hz:", "rate_hx:"), {"source": "x"}, 12, "no such key; did you mean 'rate_hz'?"),
        (("${source}\n", "${sauce}\n"), {"source": "x"}, 11, "no setting 'sauce'; did you mean 'source'?"),
        (("  index:", "  indexx:"), {"source": "x"}, 8, "no stage 'indexx'; did you mean 'index'?"),
        (("  index:", "  index: {inputs: {takes: injest}}"), {"source": "x"}, 8, "did you mean 'ingest'?"),
        (("  index:", "  index: {inputs: {take: ingest}}"), {"source": "x"}, 8, "did you mean 'takes'?"),
        (("  index:", "  index: {use: index}"), {"source": "x"}, 8, "no such key; did you mean 'uses'?"),
        (("name: small", ""), {"source": "x"}, None, "name: this key is missing"),
        (("name: small", "nam: small"), {"source": "x"}, 2, "nam: no such key; did you mean 'name'?"),
        (("  rate: 120", "  rate: 120\n  rate: 60"), {"source": "x"}, 7, "stands twice (first in line 6)"),
        (("  rate: 120", "  rate: [120"), {"source": "x"}, 7, "not valid YAML"),
        (("", ""), {}, 5, "the setting 'source' must be given"),
    ],
)
def test_a_fault_in_a_pipeline_file_names_line_key_and_way_out(
    tmp_path: Path, change: tuple[str, str], assignments: dict[str, str], line: int | None, message: str
) -> None:
    path = write(tmp_path, GOOD.replace(*change, 1))
    with pytest.raises(ConfigError) as caught:
        load_pipeline(path, assignments)
    assert message in str(caught.value)
    assert str(path) in str(caught.value)
    if line is not None:
        assert caught.value.line == line


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("sorce", "no setting of that name; did you mean 'source'?"),
        ("injest.prune", "no stage 'injest'; did you mean 'ingest'?"),
        ("ingest.prun", "no parameter 'prun'; did you mean 'prune'?"),
    ],
)
def test_a_wrong_assignment_names_the_nearest(tmp_path: Path, name: str, message: str) -> None:
    with pytest.raises(KinedexError) as caught:
        load_pipeline(write(tmp_path, GOOD), {"source": "x", name: "1"})
    assert message in str(caught.value)


def test_a_parameter_of_one_stage_needs_no_stage_in_front(tmp_path: Path) -> None:
    given = {"source": "x", "metadata": "tags.csv"}
    assert load_pipeline(write(tmp_path, GOOD), given).stage("ingest").params.model_dump()["metadata"] == ["tags.csv"]


def test_a_stage_of_the_wrong_kind_is_no_input(tmp_path: Path) -> None:
    text = "name: x\nstages:\n  a: {uses: index, inputs: {takes: b}}\n  b: {uses: index, inputs: {takes: a}}\n"
    with pytest.raises(ConfigError, match="must be a stage 'ingest', but 'b' is a stage 'index'"):
        load_pipeline(write(tmp_path, text))


@pytest.mark.parametrize("value", ["/a #1 x", "a: b", "2024", "it's", "{x", "null"])
def test_a_text_that_the_user_sets_is_taken_as_it_is(tmp_path: Path, value: str) -> None:
    pipeline = load_pipeline(write(tmp_path, GOOD), {"source": value})
    assert pipeline.stage("ingest").params.model_dump()["source"] == value


@pytest.mark.parametrize("line", ["{{train}}", "2001-99-99", "!x y", "&a [*a]", "!!float ''", "!!timestamp x"])
def test_values_that_yaml_stumbles_over_are_refused_with_the_file(tmp_path: Path, line: str) -> None:
    path = write(tmp_path, GOOD.replace("rate: 120", f"rate: {line}"))
    with pytest.raises(ConfigError, match=r"is not valid YAML|contains itself"):
        load_pipeline(path, {"source": "x"})


def test_a_parameter_of_several_stages_is_named_with_each() -> None:
    several = r"--set where: several stages have this parameter; name one: learn_templates\.where or annotate\.where"
    with pytest.raises(KinedexError, match=several):
        load_pipeline("annotate", {"source": "x", "where": "true"})


def test_an_unknown_pipeline_names_the_nearest() -> None:
    with pytest.raises(ConfigError, match=r"^anotate: no pipeline is called that; did you mean 'annotate'"):
        load_pipeline("anotate")
    with pytest.raises(ConfigError, match=r"^anotate.yaml: no such file; expected a pipeline$"):
        load_pipeline("anotate.yaml")


@pytest.mark.parametrize("name", config_names("pipelines"))
def test_every_shipped_pipeline_loads(name: str) -> None:
    settings = load_yaml(config_path("pipelines", name)).mapping()["settings"]
    assert load_pipeline(name, {key: "/data" for key, value in settings.items() if value is None}).stages


@pytest.mark.parametrize("name", BUILT_IN)
def test_every_stage_documents_each_of_its_parameters(name: str) -> None:
    stage = load_stage(name)
    assert type(stage).__doc__
    for key, field in stage.parameters.model_fields.items():
        assert field.description, f"{name}.{key}"


def test_yaml_remembers_lines_of_nested_keys(tmp_path: Path) -> None:
    located = load_yaml(write(tmp_path, "a:\n  - b: 1\n    c: 2\n  - {d: 3}\n"))
    assert [located.line("a", 0, "c"), located.line("a", 1, "d"), located.line("a", 7), located.line()] == [3, 4, 1, 1]
    assert located.data == {"a": [{"b": 1, "c": 2}, {"d": 3}]}


def test_python_values_set_settings_and_parameters(tmp_path: Path) -> None:
    settings = {"source": Path("/data"), "rate": np.int64(60), "prune": True, "ingest.name": "path"}
    pipeline = load_pipeline(write(tmp_path, GOOD), settings=settings)
    params = pipeline.stage("ingest").params.model_dump()
    assert (params["source"], params["rate_hz"], params["prune"], params["name"]) == ("/data", 60.0, True, "path")
    tau = load_pipeline("annotate", settings={"source": "/x", "tau": 0.06}).stage("annotate").params.model_dump()["tau"]
    assert tau == 0.06


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({}, "the setting 'source' must be given: settings={'source': …}"),
        ({"sorce": "x"}, "settings['sorce']: "),
        ({"source": "x", "rate_hs": 1}, "no setting of that name"),
        ({"source": "x", "ingest.prun": True}, "settings['ingest.prun']: stage 'ingest' has no parameter 'prun'"),
        ({"source": "x", "prune": "perhaps"}, "settings['prune'] = 'perhaps': must be a valid boolean"),
        ({"source": "x", "injest.prune": True}, "no stage 'injest'; did you mean 'ingest'?"),
    ],
)
def test_errors_for_callers_in_python_do_not_mention_options(
    tmp_path: Path, settings: dict[str, object], message: str
) -> None:
    with pytest.raises(KinedexError) as caught:
        load_pipeline(write(tmp_path, GOOD), settings=settings)
    assert message in str(caught.value)
    assert "--set" not in str(caught.value)


def test_a_parameter_of_several_stages_needs_its_stage() -> None:
    with pytest.raises(KinedexError, match=r"several stages have this parameter; name one: learn_templates\.where or "):
        load_pipeline("annotate", settings={"source": "x", "where": "true"})


def test_stages_that_need_each_other_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(type(load_stage("ingest")), "inputs", {"index": Input("index")})
    with pytest.raises(KinedexError, match="the stages index, ingest need each other"):
        load_pipeline(write(tmp_path, GOOD), {"source": "x"})


@pytest.mark.parametrize(
    ("text", "value"),
    [
        (r'["\d+_(?P<actor>\w+)"]', [r"\d+_(?P<actor>\w+)"]),
        (r'["it is \d$"]', [r"it is \d$"]),
        (r'["(?P<x>\d)", "y"]', [r"(?P<x>\d)", "y"]),
    ],
)
def test_a_backslash_in_double_quotes_is_told_to_stand_in_single_ones(text: str, value: list[str]) -> None:
    with pytest.raises(KinedexError, match="use single ones: --set ") as fault:
        load_pipeline("ingest", {"source": "x", "ingest.patterns": text})
    assert "quote it" not in str(fault.value)
    words = shlex.split(str(fault.value).rpartition("--set ")[2])
    name, _, way_out = words[0].partition("=")
    assert (len(words), name) == (1, "ingest.patterns")
    params = load_pipeline("ingest", {"source": "x", name: way_out}).stage("ingest").params
    assert params.patterns == value  # type: ignore[attr-defined]
    with pytest.raises(KinedexError, match="quote it"):
        load_pipeline("ingest", {"source": "x", "ingest.patterns": "[a: b: c"})
