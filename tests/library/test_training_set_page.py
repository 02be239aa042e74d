"""docs/howto/training-set.md: the ten commands and the loading of their clips run, in their order."""

from __future__ import annotations

import json
import re
import shlex
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from kinedex.commands.cli import app

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "howto" / "training-set.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"^ {4}kinedex (.*)$", PAGE.partition("\n## ")[0], re.MULTILINE)
(BLOCK,) = re.findall(r"^```python\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)


def test_there_are_ten_commands() -> None:
    assert len(COMMANDS) == 10


def test_the_commands_make_a_training_set_that_loads(
    demo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    # what the first two commands make is there already
    shutil.copytree(demo / "archive", tmp_path / "archive")
    shutil.copytree(demo / "store", tmp_path / "moves")
    monkeypatch.chdir(tmp_path)
    for line in COMMANDS[2:]:
        result = CliRunner().invoke(app, [*shlex.split(line), *(["--workers", "1"] if "export" in line else [])])
        assert result.exit_code == 0, f"{line}\n{result.output}\n{result.exception}"
    assert (tmp_path / "squats" / "metadata.csv").read_text().count("squat") >= 2
    facts = json.loads((tmp_path / "moves-set" / "dataset.json").read_text())
    assert facts["mirrored_classes"]["kickLeft"] == "kickRight"
    files = {path.relative_to(tmp_path / "moves-set").as_posix() for path in (tmp_path / "moves-set").rglob("*.npz")}
    assert files == {clip["file"] for clip in facts["clips"]}
    actors = [{clip["actor"] for clip in facts["clips"] if clip["split"] == split} for split in ("train", "test")]
    assert all(actors)
    assert not actors[0] & actors[1]
    exec(compile(BLOCK, "docs/howto/training-set.md", "exec"), {})
    assert re.match(r"\(\d+, \d+, 24, 3\) \[", capsys.readouterr().out)
