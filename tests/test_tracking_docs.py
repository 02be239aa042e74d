"""The page of tracking: its commands and its Python run in their order, on an archive of a few clips."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import kinedex
from kinedex.commands.cli import app
from kinedex.storage.store.store import open_store
from tests.pipelines.archives import write_archive
from tests.storage.flipped import flip_bit
from tests.storage.formats.motion.test_positions import trc

PAGE = (Path(__file__).resolve().parents[1] / "docs" / "tracking.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"^    kinedex (.*)$", PAGE, re.MULTILINE)
BLOCKS = re.findall(r"^```python\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
IN_THIS_PROCESS = {"ingest": ("--workers", "1"), "track": ("--executor", "serial"), "run": ("--executor", "serial")}
LOST = "SYN_al_take01_stabilised"


def run(command: str) -> str:
    """Run a command of the page; the archive is here already, and one process serves it."""
    words = shlex.split(command)
    done = CliRunner().invoke(app, [*words, *IN_THIS_PROCESS.get(words[0], ())])
    assert done.exit_code == 0, f"{command}\n{done.output}"
    return str(done.output)


def damage(store: Path) -> str:
    """Flip a bit in the frames of a track; return what `verify` prints."""
    opened = open_store(store)
    part = next(part for part in opened.manifest.frames if opened.take_ids[LOST] in part.live)
    flip_bit(store / part.path, (store / part.path).stat().st_size // 2)
    done = CliRunner().invoke(app, ["verify", str(store)])
    assert done.exit_code == 1
    return str(done.output)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with an archive of the names that the page has; one take is a track with a gap."""
    clips = {"SYN_al_spinLeft_001_120": 192, "SYN_bo_spinLeft_001_120": 160, "SYN_bo_squat1Reps_001_120": 120}
    write_archive(tmp_path / "archive", {f"clips/{name.split('_')[2]}/{name}.amc": n for name, n in clips.items()})
    (tmp_path / "archive" / "x.asf").rename(tmp_path / "archive" / "SYN.asf")
    take = kinedex.read(tmp_path / "archive" / "clips" / "squat1Reps" / "SYN_bo_squat1Reps_001_120.amc")
    points = take.positions.copy()
    points[5:20, take.joints.index("lwrist")] = np.nan
    (tmp_path / "archive" / "takes").mkdir()
    text = trc(1000 * points, tuple(take.joints), rate=f"{take.rate_hz:.2f}", step=1 / take.rate_hz)
    (tmp_path / "archive" / "takes" / "SYN_al_take01.trc").write_text(text)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_commands_and_the_python_of_the_page_run(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert COMMANDS[0] == "synth archive --minutes 3"
    output: dict[str, str] = {}
    for command in COMMANDS[1:]:
        if command == "verify store":
            assert "damaged" in damage(folder / "store")
            continue
        output[command] = output.get(command, "") + run(command)
    assert "SYN_al_spinLeft_001_120_stabilised" in output["stabilise store SYN_al_spinLeft_001_120_tracked --explain"]
    assert "; gaps in 15 frames filled; as SYN_al_take01_stabilised" in " ".join(
        output["stabilise store SYN_al_take01"].split()
    )
    printed = " ".join(output["repair store"].split())
    assert f"take {LOST} is lost: no motion file holds it" in printed
    assert "or `kinedex stabilise store SYN_al_take01`" in printed
    assert (folder / "spin.bvh").is_file()
    assert (folder / "spin.trc").is_file()
    assert "kinedex stabilise" in str(kinedex.open_store(folder / "store").takes()["warnings"].to_list())
    for block in BLOCKS:
        exec(compile(block, "docs/tracking.md", "exec"), {})
    assert "SYN_al_spinLeft_001_120_stabilised" in capsys.readouterr().out
    assert CliRunner().invoke(app, ["verify", "store"]).exit_code == 0
    assert LOST in open_store(folder / "store").take_ids
