"""Long tables go through the reader's pager on a terminal, and whole to a file or a pipe."""

from __future__ import annotations

import os
import select
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.storage.made_up import make_store

pytestmark = pytest.mark.skipif(os.name != "posix", reason="terminals of this kind are of POSIX systems")

SECONDS = 60
"""A command that has not ended by then hangs."""


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store of more takes than a terminal of 24 lines, and than 200 rows."""
    return make_store(tmp_path_factory.mktemp("pager") / "store", {f"take_{number:03}": 3 for number in range(250)})


def on_terminal(pager: str, *words: str | Path) -> str:
    """Run a command with a terminal as its input and output, and return what it shows there; its pager has no keys."""
    import pty

    ours, theirs = pty.openpty()
    environment = {**os.environ, "PAGER": pager, "LINES": "24", "COLUMNS": "100", "TERM": "xterm"}
    command = [sys.executable, "-m", "kinedex", *map(str, words)]
    with subprocess.Popen(command, stdin=theirs, stdout=theirs, stderr=theirs, env=environment) as process:
        os.close(theirs)
        shown, end = b"", time.monotonic() + SECONDS
        try:
            while time.monotonic() < end and select.select([ours], [], [], end - time.monotonic())[0]:
                try:
                    part = os.read(ours, 65536)
                except OSError:  # the other side has closed the terminal
                    break
                if not part:
                    break
                shown += part
            assert process.wait(max(0.0, end - time.monotonic())) == 0, shown.decode()
        finally:
            process.kill()
            os.close(ours)
    return shown.decode()


def test_a_terminal_shows_a_long_list_in_the_pager(store: Path, tmp_path: Path) -> None:
    paged = tmp_path / "paged.txt"
    shown = on_terminal(f"cat > {paged}", "takes", store)
    assert paged.read_text().count("take_") == 200
    assert "take_000" not in shown
    assert "the first 200 are shown, --limit 0 shows all" in shown


def test_a_reader_who_leaves_the_pager_early_sees_no_error(store: Path) -> None:
    shown = on_terminal("true", "takes", store, "--limit", "0")
    assert "250 takes" in shown
    assert "Traceback" not in shown
    assert "Broken" not in shown


def test_a_short_list_needs_no_pager(store: Path, tmp_path: Path) -> None:
    paged = tmp_path / "paged.txt"
    assert "take_003" in on_terminal(f"cat > {paged}", "takes", store, "--limit", "5")
    assert not paged.exists()


def test_a_pipe_gets_all_rows_and_no_pager(store: Path, tmp_path: Path) -> None:
    paged = tmp_path / "paged.txt"
    command = [sys.executable, "-m", "kinedex", "takes", str(store)]
    environment = {**os.environ, "PAGER": f"cat > {paged}"}
    done = subprocess.run(
        command, stdin=subprocess.DEVNULL, capture_output=True, text=True, env=environment, timeout=SECONDS, check=True
    )
    assert done.stdout.count("take_") == 250
    assert not paged.exists()
