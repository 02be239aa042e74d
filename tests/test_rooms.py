"""The rooms of the house: imports go pipelines → storage → catalog → ops, and never back."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("ops", "catalog", "storage", "pipelines")
FILES = sorted(path for room in ROOMS for path in (ROOT / room).rglob("*.py"))


def imported_rooms(path: Path) -> set[str]:
    """The rooms of kinedex and the other packages that a module imports, `kinedex` itself for the public API."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module == "kinedex":
            names |= {f"kinedex.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.add(node.module)
    rooms = {name.split(".")[1] for name in names if name.startswith("kinedex.")}
    return rooms | {name.split(".")[0] for name in names if not name.startswith("kinedex.")}


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_imports_go_one_way(path: Path) -> None:
    room = ROOMS.index(path.relative_to(ROOT).parts[0])
    above = {*ROOMS[room + 1 :], "kinedex", "tests", "benchmarks", "studies"}
    assert not imported_rooms(path) & above


@pytest.mark.parametrize("path", [f for f in FILES if "ops" in f.parts], ids=lambda path: path.stem)
def test_the_numbers_know_no_files_no_sql_and_no_config(path: Path) -> None:
    assert not imported_rooms(path) & {"duckdb", "polars", "pyarrow", "yaml", "pydantic", "logging", "rich", "typer"}


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_no_room_is_imported_by_its_bare_name(path: Path) -> None:
    bare = {
        node.lineno
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if (isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in ROOMS)
        or (isinstance(node, ast.Import) and any(alias.name.split(".")[0] in ROOMS for alias in node.names))
    }
    assert not bare


def test_stages_are_imported_by_nobody() -> None:
    for path in FILES:
        source = path.read_text(encoding="utf-8")
        assert "kinedex.pipelines.stages" not in source or (path.name == "stage.py" and path.parent.name == "engine"), (
            path
        )
