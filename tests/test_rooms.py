"""The rooms of the house: imports go one way, never back, and in no circle.

commands → explorer → library → console → reports → pipelines → storage → catalog → ops; each may skip.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Container
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("ops", "catalog", "storage", "pipelines", "reports", "console", "library", "explorer", "commands")
"""The rooms from the lowest on."""

OWN = ("console", "library", "commands")
"""Those of them that are folders of `kinedex/`; the others lie beside it, and are links there."""

TERMINAL = ("console", "commands")
"""The rooms that print, and that know how a terminal looks."""

PROGRAMS = {"storage/formats/imu/hdf5_child.py", "explorer/warm_process_main.py"}
"""Programs of their own: one prints for the process that started it, the other becomes a command."""


def files_of(room: str) -> list[Path]:
    """Return the modules of a room."""
    folder = ROOT / "kinedex" / room if room in OWN else ROOT / room
    return sorted(path for path in folder.rglob("*.py") if "node_modules" not in path.parts)


FILES = [path for room in ROOMS for path in files_of(room)]


@cache
def imports(path: Path) -> list[ast.Import | ast.ImportFrom]:
    """Return the imports of a module, which is parsed once for all tests."""
    nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    return [node for node in nodes if isinstance(node, (ast.Import, ast.ImportFrom))]


def imported_rooms(path: Path) -> set[str]:
    """The rooms of kinedex and the other packages that a module imports, `kinedex` itself for the public API."""
    names = set()
    for node in imports(path):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif node.module == "kinedex":
            names |= {f"kinedex.{alias.name}" for alias in node.names}
        elif node.module:
            names.add(node.module)
    rooms = {name.split(".")[1] for name in names if name.startswith("kinedex.")}
    return rooms | {name.split(".")[0] for name in names if not name.startswith("kinedex.")}


def files_that_import(files: list[Path], forbidden: set[str]) -> dict[str, set[str]]:
    """Return the files that import something forbidden, and what."""
    found = {str(path.relative_to(ROOT)): imported_rooms(path) & forbidden for path in files}
    return {name: rooms for name, rooms in found.items() if rooms}


@pytest.mark.parametrize("room", ROOMS)
def test_imports_go_one_way(room: str) -> None:
    above = {*ROOMS[ROOMS.index(room) + 1 :], "kinedex", "tests", "benchmarks", "studies"}
    assert files_of(room)
    assert files_that_import(files_of(room), above) == {}


def test_every_folder_of_the_package_is_a_room() -> None:
    folders = [path for path in (ROOT / "kinedex").iterdir() if (path / "__init__.py").is_file()]
    assert {path.name for path in folders} == {*ROOMS}
    assert {path.name for path in folders if not path.is_symlink()} == {*OWN}


def prints(path: Path) -> bool:
    """Return whether a module prints."""
    calls = (node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.Call))
    return any(isinstance(node.func, ast.Name) and node.func.id == "print" for node in calls)


def test_services_know_no_terminal() -> None:
    files = [path for room in ROOMS if room not in TERMINAL for path in files_of(room)]
    services = [path for path in files if path.relative_to(ROOT).as_posix() not in PROGRAMS]
    assert files_that_import(services, {"rich", "typer", "click"}) == {}
    assert [path for path in services if prints(path)] == []


def test_the_numbers_know_no_files_no_sql_and_no_config() -> None:
    outside = {"duckdb", "polars", "pyarrow", "yaml", "pydantic", "logging", "rich", "typer"}
    assert files_that_import([path for path in FILES if "ops" in path.parts], outside) == {}


def test_no_room_is_imported_by_its_bare_name() -> None:
    bare = {
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for path in FILES
        for node in imports(path)
        if (isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in ROOMS)
        or (isinstance(node, ast.Import) and any(alias.name.split(".")[0] in ROOMS for alias in node.names))
    }
    assert bare == set()


def test_stages_are_imported_by_nobody() -> None:
    for path in FILES:
        source = path.read_text(encoding="utf-8")
        named = "kinedex.pipelines.stages" in source or "kinedex.reports.stages" in source
        assert not named or (path.name == "stage.py" and path.parent.name == "engine"), path


def module_name(path: Path) -> str:
    """Return the dotted name of a module below `kinedex`; a package has the name of its folder."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    parts = parts if parts[0] == "kinedex" else ("kinedex", *parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


PRODUCT = {module_name(path): path for path in [*FILES, *sorted((ROOT / "kinedex").glob("*.py"))]}


def imported_modules(name: str, source: str, known: Container[str]) -> set[str]:
    """Return the modules of kinedex that a module imports: at its top, in functions, and for types alike."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            whole = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {part if part in known else node.module for part in whole}
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value.startswith("kinedex."):
            found.add(node.value)  # import_module("kinedex.…")
    return {module for module in found if module in known and module != name}


def circles(imports: dict[str, set[str]]) -> set[frozenset[str]]:
    """Return the sets of modules that import each other in a circle (the strongly connected components; Tarjan)."""
    order: dict[str, int] = {}
    lowest: dict[str, int] = {}
    stack: list[str] = []
    found = set()

    def visit(module: str) -> None:
        order[module] = lowest[module] = len(order)
        stack.append(module)
        for other in imports[module]:
            if other not in order:
                visit(other)
                lowest[module] = min(lowest[module], lowest[other])
            elif other in stack:
                lowest[module] = min(lowest[module], order[other])
        if lowest[module] == order[module]:
            members = stack[stack.index(module) :]
            del stack[stack.index(module) :]
            if len(members) > 1:
                found.add(frozenset(members))

    for module in imports:
        if module not in order:
            visit(module)
    return found


@cache
def imports_of_modules() -> dict[str, set[str]]:
    """Return the modules of kinedex that each of its modules imports."""
    return {name: imported_modules(name, path.read_text(encoding="utf-8"), PRODUCT) for name, path in PRODUCT.items()}


def test_modules_import_each_other_in_no_circle() -> None:
    found = circles(imports_of_modules())
    assert not found, "modules import each other in a circle"


def test_folders_of_the_store_import_each_other_in_no_circle() -> None:
    folders: dict[str, set[str]] = {}
    for name, inside in imports_of_modules().items():
        if name.startswith("kinedex.storage."):
            folders.setdefault(name.split(".")[2], set()).update(
                module.split(".")[2] for module in inside if module.count(".") > 1 and ".storage." in module
            )
    assert not circles({folder: others - {folder} for folder, others in folders.items()})


@pytest.mark.parametrize(
    "source",
    [
        "from kinedex.b import thing",
        "import kinedex.b",
        "from kinedex import b",
        "def f():\n    from kinedex.b import thing",
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from kinedex.b import Thing",
        "from importlib import import_module\nb = import_module('kinedex.b')",
    ],
)
def test_every_way_to_import_counts_in_a_circle(source: str) -> None:
    known = ("kinedex.a", "kinedex.b")
    back = imported_modules("kinedex.b", "import kinedex.a", known)
    imports = {"kinedex.a": imported_modules("kinedex.a", source, known), "kinedex.b": back}
    assert circles(imports) == {frozenset(known)}


FORMS = {
    "Interval": "ops/intervals.py",
    "Hit": "ops/intervals.py",
    "TakeSegment": "ops/intervals.py",
    "Segment": "ops/annotation/segments.py",
    "Label": "storage/formats/labels/file_labels.py",
    "ManualSegment": "storage/formats/labels/file_labels.py",
}
"""The forms of an interval, a hit, a segment and a label, and their homes (docs/architecture.md)."""


def test_each_form_of_the_field_has_one_definition() -> None:
    classes = (
        (node.name, path.relative_to(ROOT).as_posix())
        for path in FILES
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ClassDef)
    )
    assert sorted(one for one in classes if one[0] in FORMS) == sorted(FORMS.items())


def test_seconds_of_frames_are_rounded_in_one_place() -> None:
    rounded = re.compile(r"/ (?:[a-z_.]+\.)?rate_hz:\.\d")
    files = [path for room in ("pipelines", "reports", "explorer", "library", "commands") for path in files_of(room)]
    assert [path for path in files if rounded.search(path.read_text(encoding="utf-8"))] == []
