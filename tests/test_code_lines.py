"""The size of rooms and functions stays within what was decided: folders, lines of code, and parameters."""

from __future__ import annotations

import ast
from pathlib import Path

from tests.code_lines import PRODUCT, ROOT, code_lines, lines_of, modules

MOST_LINES = 22_000
"""The largest number of lines of code of `pipelines`."""

MOST_FOLDERS, MOST_PARAMETERS = 14, 8


def test_lines_of_code_are_counted_without_texts_and_comments() -> None:
    source = '''"""A docstring.

    Two lines.
    """
X = 1  # a comment
"""X is a number."""

def f(
    a: int,
) -> str:
    """Return a text."""
    # a comment

    return """one
    two"""
'''
    assert code_lines(source) == 6


def test_pipelines_keep_to_what_was_decided() -> None:
    folders = [path for path in (ROOT / "pipelines").iterdir() if (path / "__init__.py").is_file()]
    assert len(folders) <= MOST_FOLDERS
    assert lines_of(ROOT / "pipelines") <= MOST_LINES


FLAT = ("kinedex/commands/", "kinedex/library/", "catalog/queries/query.py")
"""The modules whose signatures are flat: options of commands, and the public API with `kinedex.Query`."""


def is_edge(path: Path, function: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    """Return whether a signature may be flat: options of commands, the public API, and compiled kernels."""
    name = path.relative_to(ROOT).as_posix()
    compiled = any("njit" in ast.unparse(one) or "kernel" in ast.unparse(one) for one in function.decorator_list)
    return compiled or name.startswith(FLAT)


def test_no_function_has_more_parameters_than_a_reader_keeps_in_mind() -> None:
    long = []
    for room in PRODUCT:
        for path in modules(ROOT / room):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if not isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)) or is_edge(path, node):
                    continue
                names = [one.arg for one in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
                if len([name for name in names if name not in ("self", "cls")]) > MOST_PARAMETERS:
                    long.append(f"{path.relative_to(ROOT)}:{node.lineno} {node.name}")
    assert long == []
