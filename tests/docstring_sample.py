"""`python -m tests.docstring_sample --seed 32 --count 200`: draw docstrings of the product for a reader to judge.

Every docstring of a module, a class or a function has the same chance, private ones included. Each is printed with its
place, its name and what its reader has before him: the signature of a function, the bases and fields of a class.
CONTRIBUTING.md says how the language is judged by such a sample.
"""

from __future__ import annotations

import argparse
import ast
import random
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from tests.code_lines import PRODUCT, ROOT, modules


class Docstring(NamedTuple):
    """A docstring of a module, a class or a function.

    Parameters
    ----------
    path : str
        File, from the root of the repository.
    line : int
        Line of the definition, 1 of a module.
    name : str
        Name with those of the classes and functions around it; the file's name of a module.
    signature : str
        The line of the definition, in one line, with decorators; empty for a module.
    text : str
        The docstring, without its indentation.
    """

    path: str
    line: int
    name: str
    signature: str
    text: str


def docstrings(source: str, path: str) -> Iterator[Docstring]:
    """Yield the docstrings of a module, in the order of the file."""
    tree = ast.parse(source)
    module = ast.get_docstring(tree)
    if module is not None:
        yield Docstring(path, 1, path.rpartition("/")[2], "", module)
    yield from _inside(tree, path, "")


def _inside(node: ast.AST, path: str, around: str) -> Iterator[Docstring]:
    """Yield the docstrings of the definitions in a node, those in other definitions included."""
    for child in ast.iter_child_nodes(node):
        if not isinstance(child, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            yield from _inside(child, path, around)
            continue
        name = f"{around}{child.name}"
        text = ast.get_docstring(child)
        if text is not None:
            yield Docstring(path, child.lineno, name, _signature(child), text)
        yield from _inside(child, path, f"{name}.")


def _signature(node: ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) -> str:
    """Return the decorators and the first line of a definition; of a class, the names of its fields as well."""
    decorators = [f"@{ast.unparse(one)}" for one in node.decorator_list]
    if isinstance(node, ast.ClassDef):
        bases = ", ".join(ast.unparse(one) for one in node.bases)
        fields = ", ".join(ast.unparse(one.target) for one in node.body if isinstance(one, ast.AnnAssign))
        return " ".join([*decorators, f"class {node.name}({bases}): {fields}".rstrip()])
    returns = f" -> {ast.unparse(node.returns)}" if node.returns else ""
    return " ".join([*decorators, f"def {node.name}({ast.unparse(node.args)}){returns}"])


def product_docstrings() -> list[Docstring]:
    """Return all docstrings of the product, by path and line."""
    return [
        one
        for room in PRODUCT
        for path in modules(ROOT / room)
        for one in docstrings(path.read_text(encoding="utf-8"), path.relative_to(ROOT).as_posix())
    ]


def sample(found: Sequence[Docstring], seed: int, count: int) -> list[Docstring]:
    """Draw docstrings without replacement, each with the same chance; a seed draws the same ones again."""
    return sorted(random.Random(seed).sample(found, min(count, len(found))))


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a sample of the product's docstrings."""
    parser = argparse.ArgumentParser(prog="python -m tests.docstring_sample", description="Draw docstrings to judge.")
    parser.add_argument("--seed", type=int, default=0, help="another seed draws others (default: 0)")
    parser.add_argument("--count", type=int, default=200, help="how many are drawn (default: 200)")
    options = parser.parse_args(arguments)
    found = product_docstrings()
    for number, one in enumerate(sample(found, options.seed, options.count), 1):
        print(f"[{number}] {one.path}:{one.line} {one.name}")
        if one.signature:
            print(f"    {one.signature}")
        print("".join(f"        {line}\n" if line else "\n" for line in one.text.splitlines()))
    print(f"{min(options.count, len(found))} of {len(found)} docstrings, seed {options.seed}")


if __name__ == "__main__":
    main()
