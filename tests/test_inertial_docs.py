"""The page of inertial sensors: its commands and its Python run in their order, on an archive of one take."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

import kinedex
from kinedex.commands.cli import app
from tests.pipelines.archives import write_archive

PAGE = (Path(__file__).resolve().parents[1] / "docs" / "inertial.md").read_text(encoding="utf-8")
TUTORIAL = PAGE.partition("## Tutorial\n")[2].partition("\n## ")[0]
COMMANDS = re.findall(r"^    kinedex (.*)$", TUTORIAL, re.MULTILINE)
BLOCKS = re.findall(r"^```python\n(.*?)^```", TUTORIAL, re.DOTALL | re.MULTILINE)
IN_THIS_PROCESS = {"ingest": ("--workers", "1"), "run": ("--executor", "serial")}
TAKE = "SYN_al_take01"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with an archive of the names that the page has."""
    write_archive(tmp_path / "archive", {f"takes/{TAKE}.amc": 1200})
    (tmp_path / "archive" / "x.asf").rename(tmp_path / "archive" / "SYN.asf")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(command: str) -> str:
    """Run a command of the page; the archive is here already, and one process serves it."""
    words = shlex.split(command)
    done = CliRunner().invoke(app, [*words, *IN_THIS_PROCESS.get(words[0], ())])
    assert done.exit_code == 0, f"{command}\n{done.output}"
    return str(done.output)


def test_the_tutorial_runs(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert COMMANDS[0] == "synth archive --minutes 3"
    output = {command: run(command) for command in COMMANDS[1:]}
    plan = next(text for command, text in output.items() if command.startswith("plan"))
    assert "has not run yet" not in plan
    page = (folder / "store" / "results" / "reports" / "limb-errors" / "limb-errors.html").read_text(encoding="utf-8")
    assert page.count('class="limb"') == 5
    errors = kinedex.open_store("store").sql("SELECT median(degrees) AS degrees FROM limb_errors WHERE valid")
    assert errors["degrees"][0].as_py() < 3.0
    for block in BLOCKS:
        exec(compile(block, "docs/inertial.md", "exec"), {})
    assert "lshank" in capsys.readouterr().out
    assert CliRunner().invoke(app, ["verify", "store"]).exit_code == 0
