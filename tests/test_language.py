"""The language and shape of the code: docstrings are sentences, module names are nouns, functions are short."""

from __future__ import annotations

import ast
import re
from collections.abc import Container, Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("kinedex", "ops", "catalog", "storage", "pipelines", "reports", "explorer", "benchmarks", "studies")
MAX_LINES = 60
"""The longest function: a screen of code, from `def` to its end, without its docstring."""

FRAGMENT = re.compile(r"(What|Whether|How|Which|Where)\b")

FIELD_TERMS = {
    "averaging": "template learning averages aligned clips; the literature's word for the step",
    "decoding": "labelling a sequence by its best path, as of hidden Markov models",
    "indexing": "the subject of Section 3.3 and of what is measured",
    "learning": "machine learning",
    "pruning": "leaving out what a lower bound excludes; the word of dynamic time warping's literature",
    "ranking": "the order of an archive by a template's distance",
    "reading": "what the benchmark times: files to words",
    "recording": "a noun: what cameras, depth cameras or sensors took down, before it is a take",
    "scaling": "how cost grows with the number of workers or the size of the archive",
    "searching": "what the benchmark times: keyframe search",
    "sharing": "memory that processes share",
    "tracking": "following a body through a recording; the literature's word, and the thesis's",
    "training": "the clips that are learned from",
    "warping": "dynamic time warping",
    "wording": "a noun: counts and names in words",
    "annotating": "what the benchmark times: labels for takes",
}
"""Names ending in -ing that are terms of the field, each with its reason."""


def files(*rooms: str) -> list[Path]:
    """Return the Python files of rooms or of folders of them, by their places in the repository."""
    return sorted(path for room in rooms for path in (ROOT / room).rglob("*.py") if not _linked(path))


def _linked(path: Path) -> bool:
    """Say whether a path goes through one of the links of `kinedex/` to the rooms."""
    return any(parent.is_symlink() for parent in path.parents)


def docstrings(path: Path) -> Iterator[tuple[int, str]]:
    """Yield line and text of every docstring: of module, classes, functions and attributes."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield node.lineno, node.value.value


def long_functions(path: Path) -> Iterator[str]:
    """Yield the functions that are longer than a screen."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            lines = (node.end_lineno or node.lineno) - node.lineno + 1
            first = node.body[0]
            if ast.get_docstring(node) is not None:
                lines -= (first.end_lineno or first.lineno) - first.lineno + 1
            if lines > MAX_LINES:
                yield f"{_name(path)}:{node.lineno}: {node.name} has {lines} lines"


def fragments(path: Path) -> list[str]:
    """Return the docstrings that begin as a fragment does."""
    return [
        f"{_name(path)}:{line}: {' '.join(text.split())[:60]}"
        for line, text in docstrings(path)
        if FRAGMENT.match(text.strip())
    ]


def other_types(path: Path, classes: Container[str]) -> Iterator[str]:
    """Find the parameters that a docstring gives another class than the signature does."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        text = ast.get_docstring(node) or ""
        for one in (*node.args.args, *node.args.kwonlyargs):
            stated = re.search(rf"^{one.arg} : ([A-Z]\w+)(?:$|,| or)", text, re.MULTILINE)
            kind = one.annotation.id if isinstance(one.annotation, ast.Name) else None
            if stated and kind in classes and stated[1] != kind:
                yield f"{_name(path)}:{node.lineno}: {one.arg} is of {kind}, not {stated[1]}"


def _name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@pytest.mark.parametrize("room", [*ROOMS, "tests"])
def test_a_docstring_is_a_sentence(room: str) -> None:
    assert not [fault for path in files(room) for fault in fragments(path)]


def test_docstrings_name_the_classes_of_signatures() -> None:
    trees = [ast.parse(path.read_text(encoding="utf-8")) for path in files(*ROOMS)]
    classes = {node.name for tree in trees for node in ast.walk(tree) if isinstance(node, ast.ClassDef)}
    assert not [fault for path in files(*ROOMS) for fault in other_types(path, classes)]


@pytest.mark.parametrize("room", ROOMS)
def test_a_function_fits_on_a_screen(room: str) -> None:
    assert not [fault for path in files(room) for fault in long_functions(path)]


@pytest.mark.parametrize("room", [*ROOMS, "tests"])
def test_a_module_ending_in_ing_is_a_term_of_the_field(room: str) -> None:
    names = {part for path in files(room) for part in (path.stem, *path.relative_to(ROOT).parts[:-1])}
    terms = {name.rpartition("_")[2] for name in names if name.endswith("ing")}
    assert terms <= set(FIELD_TERMS)


def test_no_term_is_listed_in_vain() -> None:
    names = {part for path in files(*ROOMS, "tests") for part in (path.stem, *path.relative_to(ROOT).parts[:-1])}
    assert set(FIELD_TERMS) <= {name.rpartition("_")[2] for name in names}


def test_every_room_is_there() -> None:
    assert all(files(room) for room in ROOMS)
