"""`python -m tests.code_lines [FOLDER …]`: count lines of code by room, without docstrings and comments."""

from __future__ import annotations

import ast
import io
import sys
import tokenize
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

PRODUCT = ("ops", "catalog", "storage", "pipelines", "reports", "explorer", "kinedex")
"""The top-level folders of the product's Python; `kinedex` counts without the links to the other folders."""

_NO_CODE = {
    tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENCODING,
    tokenize.ENDMARKER,
}  # fmt: skip


def code_lines(source: str) -> int:
    """Return how many lines of a module hold code; a text that stands alone as a statement is a docstring."""
    lines = set[int]()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in _NO_CODE:
            lines.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            lines.difference_update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return len(lines)


def modules(folder: Path) -> list[Path]:
    """Return the modules of a folder, without those behind links and those that npm installs."""
    return [
        path
        for path in sorted(folder.rglob("*.py"))
        if "node_modules" not in path.parts and not any(parent.is_symlink() for parent in path.parents)
    ]


def lines_of(folder: Path) -> int:
    """Return the lines of code of a folder."""
    return sum(code_lines(path.read_text(encoding="utf-8")) for path in modules(folder))


def main(names: Sequence[str]) -> None:
    """Print the lines of code and the modules of folders, of the product's rooms unless some are named."""
    total = 0
    for name in names or PRODUCT:
        found = lines_of(ROOT / name)
        total += found
        print(f"{name:24} {found:7,} lines in {len(modules(ROOT / name)):4} modules")
    print(f"{'together':24} {total:7,} lines")


if __name__ == "__main__":
    main(sys.argv[1:])
