"""Collects the commands that the project prints: in its pages, the Makefile's help, help texts and error messages."""

from __future__ import annotations

import ast
import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
GENERATED = {"docs/reference.md"}
"""Pages that are made of the code, whose texts are collected there."""

ROOMS = ("catalog", "explorer", "kinedex", "ops", "pipelines", "reports", "storage")
PROGRAMS = ("kinedex", "make", "python", "pip", "pytest", "pre-commit", "chromium", "curl", "docker", "uv", "git")
SHELL = ("for", "mkdir", "cp", "sed")
"""Words of the shell that begin a command between others, in blocks alone."""

_BEGIN = re.compile(rf"(?:\$ )?((?:{'|'.join((*PROGRAMS, *SHELL))})(?: .*|)$)", re.DOTALL)
_CODE = re.compile(rf"`((?:{'|'.join(PROGRAMS)}) [^`]+)`")
_FENCE = re.compile(r"^( *)```(\w*)[^\n]*\n(.*?)^\1```", re.DOTALL | re.MULTILINE)
_INDENTED = re.compile(r"(?:^(?: {4}|\t).*\n?)+", re.MULTILINE)
_COMMENT = re.compile(r"<!--(.*?)-->", re.DOTALL)


@dataclass(frozen=True, order=True)
class Printed:
    """A command as it is printed.

    Attributes
    ----------
    place : str
        The file, relative to the checkout.
    form : str
        "block" where it stands in a block or a comment, to be run; "code" within a sentence or a table, where words may
        stand for others.
    line : str
        The command, on one line, without a comment behind it.
    """

    place: str
    form: str
    line: str


def pages() -> list[str]:
    """Return the pages, relative to the checkout."""
    found = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
    names = [path.relative_to(ROOT).as_posix() for path in found]
    return [name for name in names if name not in GENERATED]


def printed_in_page(name: str) -> list[Printed]:
    """Return the commands of a page in their order: of blocks and comments, then within sentences and tables."""
    text = (ROOT / name).read_text(encoding="utf-8")
    return [
        *(Printed(name, "block", line) for line in _blocks(text)),
        *(Printed(name, "code", " ".join(line.split())) for line in _CODE.findall(_FENCE.sub("", text))),
    ]


def printed_in_code() -> list[Printed]:
    """Return the commands in texts of the code, help and error messages; values in them are …."""
    found = set()
    for room in ROOMS:
        for path in sorted((ROOT / room).rglob("*.py")):
            name = path.relative_to(ROOT).as_posix()
            if "node_modules" not in name:
                found |= {Printed(name, "code", line) for line in _of_module(path.read_text(encoding="utf-8"))}
    return sorted(found)


def make_targets() -> set[str]:
    """Return the targets that `make help` prints."""
    text = (ROOT / "Makefile").read_text(encoding="utf-8")
    return set(re.findall(r'^\t@echo "make ([\w-]+)', text, re.MULTILINE))


def _blocks(text: str) -> Iterator[str]:
    """Yield the commands of fenced and indented blocks, and of comments, in the order of the page."""
    parts = [(one.start(), one[3]) for one in _FENCE.finditer(text) if one[2] in ("", "sh", "bash", "console", "shell")]
    blank = _FENCE.sub(lambda one: re.sub(r"[^\n]", " ", one[0]), text)
    parts += [(one.start(), one[0]) for one in _INDENTED.finditer(blank)]
    parts += [(one.start(), one[1]) for one in _COMMENT.finditer(text)]
    for _, part in sorted(parts):
        yield from commands(part)


def commands(text: str) -> Iterator[str]:
    """Yield the commands of a text, one a line; one that a backslash or an open quote ends goes on in the next line."""
    lines = iter(text.splitlines())
    for line in lines:
        begin = _BEGIN.match(line.strip())
        if begin is None:
            continue
        whole = begin[1]
        if whole.startswith("for "):
            yield _loop(whole, lines)
            continue
        while (more := _goes_on(whole)) is not None:
            following = next(lines, None)
            if following is None:
                break
            whole = f"{more} {following.strip()}"
        words = _words(whole)
        if words and (words[0] != "kinedex" or re.match(r"[a-z-]+$", words[1] if len(words) > 1 else "x")):
            yield _without_comment(whole)


def _loop(whole: str, lines: Iterator[str]) -> str:
    """Return a loop of the shell with all its lines."""
    for line in lines:
        whole += f"\n{line.strip()}"
        if whole.count("\ndone") == len(re.findall(r"^for ", whole, re.MULTILINE)):
            break
    return whole


def _goes_on(line: str) -> str | None:
    """Return the part of a line that the next line continues; None where it is whole."""
    if line.endswith("\\"):
        return line[:-1].rstrip()
    try:
        shlex.split(line, comments=True)
    except ValueError:
        return line
    return None


def _words(line: str) -> list[str]:
    try:
        return shlex.split(line, comments=True)
    except ValueError:
        return []


def _without_comment(line: str) -> str:
    """Return a command without the comment behind it: as many of its parts as words need."""
    words = _words(line)
    parts = re.split(r"(\s#\s?)", line)
    for count in range(1, len(parts) + 1, 2):
        begin = "".join(parts[:count]).rstrip()
        if _words(begin) == words:
            return begin
    return line


def _of_module(text: str) -> Iterator[str]:
    """Yield the commands in the texts of a module that are no docstrings."""
    if not _CODE.search(text):
        return
    tree = ast.parse(text)
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    docstrings = {
        id(node.body[0].value)
        for node in ast.walk(tree)
        if isinstance(node, documented) and node.body and isinstance(node.body[0], ast.Expr)
    }
    inner = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in node.values}
    for node in ast.walk(tree):
        if id(node) in docstrings or id(node) in inner:
            continue
        if isinstance(node, ast.JoinedStr):
            whole = "".join(str(one.value) if isinstance(one, ast.Constant) else "…" for one in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            whole = node.value
        else:
            continue
        yield from (" ".join(line.split()) for line in _CODE.findall(whole))
