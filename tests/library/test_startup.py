"""A command loads what its question needs, and no more: neither what runs pipelines, nor what compiles kernels."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

NEVER = {
    *("kinedex.pipelines.engine.runner", "kinedex.storage.store.writer", "dask", "distributed", "starlette"),
    *("pandas", "polars", "pyarrow.dataset", "jinja2", "ezc3d", "filelock", "typer._adapters", "rich._emoji_codes"),
}
NO_VALIDATORS = {"pydantic", "annotated_types"}
NO_KERNELS = {"numba", "llvmlite", "scipy"}
NO_COMPILER = {"scipy.linalg", "numba.np.linalg", "numba.typed.typeddict", "cffi"}
"""Modules that numba loads to compile a kernel, and not to load a compiled one."""

QUESTIONS = {
    "takes": (["takes", "store"], NO_KERNELS | NO_VALIDATORS | {"duckdb", "pyarrow.compute", "yaml"}),
    "sql": (["sql", "store", "SELECT count(*) FROM takes"], NO_KERNELS | NO_VALIDATORS),
    "search": (["search", "store", "example", "--where", "class IS NULL"], NO_COMPILER),
    "rank": (["rank", "store", "squat1Reps", "--top", "10"], NO_COMPILER | {"duckdb"}),
    "rank a clip": (
        ["rank", "store", "--take", "TAKE", "--start", "0", "--stop", "20", "--top", "10"],
        NO_COMPILER | NO_VALIDATORS | {"duckdb", "pyarrow.compute"},
    ),
}


def loaded(words: list[str], folder: Path) -> set[str]:
    """Run `kinedex WORDS` in a process of its own and return the modules that it has loaded at its end."""
    code = (
        f"import json, sys\nsys.argv = ['kinedex', *{words!r}]\n"
        "from kinedex.commands.cli import main\ntry:\n    main()\nexcept SystemExit as end:\n"
        "    assert not end.code, end.code\nprint(json.dumps([*sys.modules]), file=sys.stderr)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=True, timeout=240
    )
    return set(json.loads(done.stderr.splitlines()[-1]))


@pytest.mark.parametrize("question", QUESTIONS)
def test_a_question_loads_what_it_needs(demo: Path, question: str) -> None:
    words, unneeded = QUESTIONS[question]
    take = min((demo / "archive" / "clips" / "squat1Reps").glob("*.amc")).stem
    words = [take if word == "TAKE" else word for word in words]
    if unneeded >= NO_COMPILER:
        loaded(words, demo)  # its kernels are compiled once, as after every update
    found = loaded(words, demo)
    assert "pyarrow" in found
    assert found & (NEVER | unneeded) == set()


def test_the_help_loads_no_library_of_numbers(demo: Path) -> None:
    assert loaded(["--help"], demo) & {"numpy", "pyarrow", "duckdb", "pydantic", "rich", "yaml"} == set()
