"""Opening a store is quick: no question loads a library that it does not need."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from kinedex.storage.index.builder import build_index
from kinedex.storage.store.store import open_store
from tests.storage.made_up import make_store


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = make_store(tmp_path_factory.mktemp("imports") / "store", {"a_one": 30, "b_two": 30})
    build_index(open_store(path, at="newest"))
    return path


@pytest.mark.parametrize(
    ("question", "unneeded"),
    [
        ("store.take_rows", "numba dask distributed polars duckdb pyarrow.dataset ezc3d"),
        ("store.takes()", "numba dask distributed duckdb pyarrow.dataset ezc3d"),
        ("store.words()", "numba dask distributed polars duckdb pyarrow.dataset ezc3d"),
        ("store.frames('a_one')", "numba dask distributed polars duckdb pyarrow.dataset ezc3d"),
        ("store.sql('SELECT count(*) FROM word_runs')", "numba dask distributed polars ezc3d"),
        ("store.takes_table('frames > 3')", "numba dask distributed polars ezc3d"),
    ],
)
def test_a_question_loads_no_library_that_it_does_not_need(path: Path, question: str, unneeded: str) -> None:
    code = (
        f"import sys; from kinedex.storage.store.store import open_store; store = open_store({str(path)!r}); "
        f"{question}; print(*(name for name in {unneeded.split()} if name in sys.modules))"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=240)
    assert found.stdout.strip() == ""
