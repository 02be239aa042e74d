"""Makefile, Dockerfile and workflow call commands that there are, and name files that there are."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
import typer
import yaml

from kinedex.commands.cli import app
from tests.attacks.runs import ATTACKS

ROOT = Path(__file__).resolve().parents[1]
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")


def accepted(words: list[str]) -> None:
    """Assert that `kinedex WORDS` names a command and options that it has."""
    root: Any = typer.main.get_command(app)
    command = root.commands[words[0]]
    options = {option for parameter in command.params for option in parameter.opts}
    arguments = sum(parameter.param_type_name == "argument" for parameter in command.params)
    given = [word for word in words[1:] if word.startswith("--")]
    assert set(given) <= options
    values = sum(not word.startswith("--") for word in words[1:])
    assert values <= arguments + len(given)
    if not given:
        assert values <= arguments


def test_the_makefile_calls_commands_that_there_are() -> None:
    lines = re.findall(r"kinedex (demo|verify|version)([^&;\n]*)", MAKEFILE)
    assert {name for name, _ in lines} == {"demo", "verify", "version"}
    for name, rest in lines:
        text = re.sub(r"\$\(if [^)]*\(DATA\)[^)]*\)\S*|\$\(if .*?\"\)", "", rest)
        accepted([name, *re.sub(r'"?\$\(\w+\)"?', "X", text).split()])


def test_the_image_runs_a_command_that_there_is() -> None:
    (command,) = re.findall(r"^CMD (.*)$", (ROOT / "Dockerfile").read_text(encoding="utf-8"), re.MULTILINE)
    accepted(json.loads(command))


@pytest.mark.parametrize(
    ("name", "jobs"),
    [
        ("checks.yml", {"lint", "test", "docs", "release", "publish"}),
        ("audit.yml", {"sbom", "vulnerabilities"}),
        ("speed.yml", {"against"}),
        ("attacks.yml", {"attack"}),
    ],
)
def test_the_workflows_call_targets_and_locks_that_there_are(name: str, jobs: set[str]) -> None:
    text = (ROOT / ".github" / "workflows" / name).read_text(encoding="utf-8")
    assert set(yaml.safe_load(text)["jobs"]) == jobs
    targets = set(re.findall(r"^([\w-]+):", MAKEFILE, re.MULTILINE))
    for words in re.findall(r"run: make ([\w =-]+)", text):
        assert {word for word in words.split() if "=" not in word} <= targets
    for lock in re.findall(r"requirements[\w-]*\.lock", text):
        assert (ROOT / lock).is_file()


def test_the_workflow_of_attacks_runs_each_of_them() -> None:
    text = (ROOT / ".github" / "workflows" / "attacks.yml").read_text(encoding="utf-8")
    assert set(yaml.safe_load(text)["jobs"]["attack"]["strategy"]["matrix"]["attack"]) == set(ATTACKS)


def test_the_locks_name_no_host() -> None:
    for lock in [*ROOT.glob("requirements*.lock"), ROOT / "explorer/page/package-lock.json"]:
        assert "://" not in lock.read_text(encoding="utf-8"), lock.name


def test_version_and_works_are_cited_alike_in_all_forms() -> None:
    version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    page = (ROOT / "docs" / "citing.md").read_text(encoding="utf-8")
    titles = re.findall(r"^  title = \{(.+?)\},$", page, re.MULTILINE)
    assert sorted(titles) == sorted([citation["title"], *(work["title"] for work in citation["references"])])
    assert citation["version"] == version
    assert re.findall(r"version = \{(.+?)\}", page) == [version]


def test_the_text_on_the_package_index_has_no_links_into_the_repository() -> None:
    hook = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["hatch"]["metadata"]["hooks"]
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    for change in hook["fancy-pypi-readme"]["substitutions"]:
        text = re.sub(change["pattern"], change["replacement"], text)
    assert "](" not in text
    assert "<!--" not in text
    assert len(text.split("\n## ")) == len((ROOT / "README.md").read_text(encoding="utf-8").split("\n## "))
