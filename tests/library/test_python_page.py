"""docs/python.md and docs/ten-tasks.ipynb: every block and every cell runs, in their order."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGE = (DOCS / "python.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```python\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
TASKS = re.findall(r"^## (\d+)\. ", PAGE, re.MULTILINE)


@pytest.fixture
def folder(demo: Path, tmp_path: Path) -> Path:
    """A working folder with the archive of the page in it; a store is made there."""
    shutil.copytree(demo / "archive", tmp_path / "archive")
    return tmp_path


def test_the_page_and_the_notebook_have_ten_tasks() -> None:
    notebook = json.loads((DOCS / "ten-tasks.ipynb").read_text(encoding="utf-8"))
    titles = re.findall(r"## (\d+)\. ", "".join("".join(cell["source"]) for cell in notebook["cells"]))
    assert TASKS == titles == [str(number) for number in range(1, 11)]
    assert all(not cell.get("outputs") for cell in notebook["cells"]), "the notebook is kept without outputs"


@pytest.mark.slow
def test_every_block_of_the_page_runs(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names: dict[str, object] = {}
    for block in BLOCKS:
        exec(compile(block, "docs/python.md", "exec"), names)
    assert (folder / "squat.svg").is_file()
    assert (folder / "squat.yaml").is_file()
    assert names["evaluation"].f_frames > 0.9  # type: ignore[attr-defined]
    assert "contradict each other" in capsys.readouterr().out


@pytest.mark.slow
def test_the_notebook_runs_to_its_end(folder: Path) -> None:
    shutil.copy(DOCS / "ten-tasks.ipynb", folder)
    command = ["-m", "jupyter", "nbconvert", "--to", "html", "--execute", "--ExecutePreprocessor.timeout=240"]
    environment = os.environ | {"JUPYTER_CONFIG_DIR": str(folder), "IPYTHONDIR": str(folder)}
    done = subprocess.run(
        [sys.executable, *command, "ten-tasks.ipynb"],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    page = (folder / "ten-tasks.html").read_text(encoding="utf-8")
    assert "DecompressionStream" in page, "the player is in the page"
    assert "average of the aligned clips" in page, "the picture of a template is in the page"
    assert "Traceback" not in page
    assert "pooled" in page, "the table of the evaluation is in the page"
