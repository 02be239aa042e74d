"""The page of reconstruction from depth: its commands and its Python run in order, on an archive of three clips."""

from __future__ import annotations

import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from kinedex.commands.cli import app
from kinedex.storage.store.store import open_store
from tests.pipelines.archives import write_archive

PAGE = (Path(__file__).resolve().parents[1] / "docs" / "depth.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"^    kinedex (.*)$", PAGE, re.MULTILINE)
BLOCKS = re.findall(r"^```python\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
IN_THIS_PROCESS = {"ingest": ("--workers", "1"), "reconstruct": ("--executor", "serial")}
NAME = "SYN_al_walk4StepsLstart_001_120"
FRAMES = 13


def run(command: str) -> str:
    """Run a command of the page; the archive is here already, one process serves it, and nobody is waited for."""
    words = shlex.split(command.replace("--idle 60", "--idle 0.1"))
    done = CliRunner().invoke(app, [*words, *IN_THIS_PROCESS.get(words[0], ())])
    assert done.exit_code == 0, f"{command}\n{done.output}"
    return " ".join(done.output.split())


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with an archive of the names that the page has."""
    clips = {f"SYN_{one}_001_120": 4 * FRAMES for one in ("al_walk4StepsLstart", "bo_walk4StepsLstart", "bo_squat")}
    write_archive(tmp_path / "archive", {f"clips/{name.split('_')[2]}/{name}.amc": n for name, n in clips.items()})
    (tmp_path / "archive" / "x.asf").rename(tmp_path / "archive" / "SYN.asf")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_commands_and_the_python_of_the_page_run(folder: Path) -> None:
    assert COMMANDS[0] == "synth archive --minutes 3"
    output: dict[str, str] = {}
    for command in COMMANDS[1:]:
        output[command] = run(command)
        if command.startswith("simulate"):
            recording = folder / "recordings" / NAME
            for name in ("camera.yaml", "background.png"):
                shutil.copy(recording / name, folder)
            shutil.copy(recording / "depth" / "000003.png", folder / "frame.png")
            shutil.copytree(recording / "depth", folder / "frames")
    made = next(text for command, text in output.items() if command.endswith("actor <> 'al'\""))
    assert f"{NAME}: {FRAMES} frames as {NAME}_reconstructed" in made
    explained = next(text for command, text in output.items() if "--explain" in command)
    assert "SYN_bo_" in explained
    assert "saved as frames_live" in next(text for command, text in output.items() if "--follow" in command)
    assert (folder / "seen.png").is_file()
    store = open_store(folder / "store", at="newest")
    assert {row["take"] for row in store.sql("FROM reconstructions").to_pylist()} == {
        f"{NAME}_reconstructed",
        "frames_live",
    }
    known = {"depth": np.asarray(Image.open("frame.png"))}
    for block in BLOCKS:
        exec(compile(block, "docs/depth.md", "exec"), known)
    assert CliRunner().invoke(app, ["verify", "store"]).exit_code == 0
