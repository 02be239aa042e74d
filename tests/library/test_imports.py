"""`import kinedex`: quick, complete, and with an answer where the links to the rooms are missing."""

from __future__ import annotations

import ast
import shutil
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

import kinedex

PACKAGE = Path(kinedex.__file__).parent
HEAVY = ("numba", "polars", "pyarrow", "duckdb", "dask", "distributed", "pydantic", "numpy")


def test_the_table_of_names_is_what_type_checkers_see() -> None:
    tree = ast.parse((PACKAGE / "__init__.py").read_text(encoding="utf-8"))
    (block,) = (
        node
        for node in tree.body
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"
    )
    seen = {
        alias.name: str(node.module).removeprefix("kinedex.")
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert seen == kinedex._HOMES
    assert {*seen, "__version__"} == set(kinedex.__all__)


@pytest.mark.parametrize("name", kinedex.__all__)
def test_every_public_name_can_be_imported(name: str) -> None:
    assert getattr(kinedex, name) is not None
    assert name in dir(kinedex)


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'opn_store'"):
        kinedex.opn_store  # noqa: B018


def test_the_version_is_that_of_the_distribution() -> None:
    assert kinedex.__version__ == version("kinedex")


def run(code: str, folder: Path | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=False, timeout=240
    )


def test_importing_kinedex_loads_no_library() -> None:
    done = run(f"import sys, kinedex; print([name for name in {HEAVY} if name in sys.modules])")
    assert done.stdout.strip() == "[]", done.stderr


def test_opening_a_store_does_not_load_its_database(demo: Path) -> None:
    loaded = "[name for name in ('duckdb', 'dask') if name in sys.modules]"
    code = f"import sys, kinedex; len(kinedex.open_store('store')); print({loaded})"
    assert run(code, demo).stdout.strip() == "[]"


def test_rooms_can_be_imported_below_kinedex() -> None:
    assert run("import kinedex.ops.words; import kinedex.storage.formats").returncode == 0


def test_a_checkout_without_links_names_the_setting_of_git(tmp_path: Path) -> None:
    (tmp_path / "kinedex").mkdir()
    shutil.copy(PACKAGE / "__init__.py", tmp_path / "kinedex")
    for room in ("ops", "catalog", "storage", "pipelines", "reports", "explorer", "configs"):
        (tmp_path / "kinedex" / room).write_text(f"../{room}")  # what git writes where it may not make links
    done = run("import kinedex", tmp_path)
    assert done.returncode != 0
    assert "git config core.symlinks true" in done.stderr
    assert "git checkout -- kinedex" in done.stderr
