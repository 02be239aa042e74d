"""The files of docs/howto/nightly.md do what the page says: silent nights, and one that reports a new failure."""

from __future__ import annotations

import configparser
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from tests.pipelines.archives import write_archive

PAGE = (Path(__file__).parents[1] / "docs" / "howto" / "nightly.md").read_text(encoding="utf-8")


def block(kind: str, contains: str) -> str:
    (found,) = (text for text in re.findall(rf"```{kind}\n(.*?)```", PAGE, re.DOTALL) if contains in text)
    return str(found)


@pytest.fixture
def home(tmp_path: Path) -> Path:
    """The folder /srv/motion of the page: an archive, and an environment with kinedex."""
    write_archive(tmp_path / "archive", {"x_1.amc": 60})
    program = tmp_path / ".venv" / "bin" / "kinedex"
    program.parent.mkdir(parents=True)
    program.write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} -m kinedex "$@"\n')
    program.chmod(0o755)
    return tmp_path


def run(command: str, home: Path) -> subprocess.CompletedProcess[str]:
    here = command.replace("/srv/motion", str(home))
    return subprocess.run(["sh", "-c", here], capture_output=True, text=True, check=False, timeout=300)


@pytest.mark.skipif(sys.platform == "win32", reason="cron and systemd are not of Windows")
def test_the_script_is_silent_unless_a_failure_is_new(home: Path) -> None:
    script = block("sh", "home=")
    (home / "archive" / "x_broken.amc").write_text("no motion\n")
    done = run(script, home)
    assert done.returncode == 3, done.stderr
    assert "kinedex ended with exit code 3" in done.stdout
    assert "failed: " in done.stdout
    done = run(script, home)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert "1 file accepted" in (home / "nightly.txt").read_text()


@pytest.mark.skipif(sys.platform == "win32", reason="cron and systemd are not of Windows")
def test_the_commands_of_the_unit_run(home: Path) -> None:
    unit = configparser.ConfigParser()
    unit.optionxform = str  # type: ignore[assignment, method-assign]
    unit.read_string(block("ini", "[Service]"))
    (line,) = re.findall(r"^    kinedex (ingest .*)$", PAGE, re.MULTILINE)
    for command in (
        f"{home}/.venv/bin/kinedex {line}",
        *(unit["Service"][key] for key in ("ExecStart", "ExecStartPost")),
    ):
        done = run(command, home)
        assert done.returncode == 0, done.stderr
    timer = configparser.ConfigParser()
    timer.read_string(block("ini", "[Timer]"))
    assert timer["Timer"]["OnCalendar"] == "*-*-* 02:30"


def test_the_line_of_cron_starts_the_script() -> None:
    line = block("text", "MAILTO").splitlines()[1].split()
    assert line[:5] == ["30", "2", "*", "*", "*"]
    assert f"`{line[-1]}`" in PAGE
