"""Reads tests/claims/ways.yaml: how commands that the project prints are run."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import yaml

from studies.small_form import forms
from tests.claims.printed import ROOT, SHELL, Printed, printed_in_page

FILE = Path(__file__).with_name("ways.yaml")
KEYS = {"given", "first", "files", "words", "instead", "exit", "not", "tests"}


@dataclass(frozen=True)
class Step:
    """A command of a page, and how it is run.

    Attributes
    ----------
    printed : str
        The command as it is printed.
    run : str
        What bash runs; empty where it is not run here.
    exit : int
        The exit code that is expected.
    way : str
        "as it is", "at a small size", the file of the test that runs it, or why it is not run.
    """

    printed: str
    run: str
    exit: int
    way: str


@dataclass(frozen=True)
class PageWay:
    """A way to run the commands of a page; the attributes are the keys of ways.yaml."""

    name: str
    given: Mapping[str, str] = field(default_factory=dict)
    first: tuple[str, ...] = ()
    files: Mapping[str, int] = field(default_factory=dict)
    words: Mapping[str, str] = field(default_factory=dict)
    instead: Mapping[str, str] = field(default_factory=dict)
    exit: Mapping[str, int] = field(default_factory=dict)
    reasons: Mapping[str, str] = field(default_factory=dict)
    tests: str = ""

    @property
    def takes_real_data(self) -> bool:
        """True where the page is run with real data, and is not run where there is none."""
        texts = (*self.first, *self.words.values(), *self.instead.values())
        given = any(source.startswith(("data/", "bandai")) for source in self.given.values())
        return given or any("{data}" in text for text in texts)

    def steps(self) -> list[Step]:
        """Return the steps of the commands in blocks, in their order."""
        return [self._step(one.line) for one in printed_in_page(self.name) if one.form == "block"]

    def _step(self, line: str) -> Step:
        if line.split()[0] not in ("kinedex", *SHELL):
            return Step(line, "", 0, way_of_program(line))
        for beginning, reason in self.reasons.items():
            if line.startswith(beginning):
                return Step(line, "", 0, f"not run: {reason}")
        if self.tests:
            return Step(line, "", 0, self.tests)
        run = self.instead.get(line, line)
        for text, other in self.words.items():
            run = run.replace(text, other)
        return Step(line, run, self.exit.get(line, 0), "as it is" if run == line else "at a small size")


@cache
def document() -> dict[str, Any]:
    """Return the whole file."""
    found: dict[str, Any] = yaml.safe_load(FILE.read_text(encoding="utf-8"))
    return found


def page_ways() -> dict[str, PageWay]:
    """Return how the commands of each page are run."""
    found = {}
    for name, keys in document()["pages"].items():
        own = dict(keys or {})
        if unknown := set(own) - KEYS:
            raise ValueError(f"{FILE.name}: {name}: unknown keys {', '.join(sorted(unknown))}")
        first = tuple(own.pop("first", ()))
        found[name] = PageWay(name, first=first, reasons=own.pop("not", {}), **own)
    return found


def way_of_program(line: str) -> str:
    """Return how a command that is none of kinedex is run; empty where nothing says so."""
    if found := re.match(r"python -m studies\.(\w+)", line):
        return f"studies.{found[1]} --small" if found[1] in forms() else ""
    if found := re.match(r"make ([\w-]+)", line):
        target = document()["make"].get(found[1])
        return "" if target is None else ", ".join(f"{key}: {value}" for key, value in target.items())
    for beginning, way in document()["programs"].items():
        if line == beginning or line.startswith(f"{beginning} "):
            return str(way)
    return ""


def without_a_way(printed: Printed) -> bool:
    """Return whether nothing says how a command of another program than kinedex is run."""
    return printed.line.split()[0] not in ("kinedex", *SHELL) and not way_of_program(printed.line)


def phony_targets() -> set[str]:
    """Return the targets of the Makefile that are commands."""
    (line,) = re.findall(r"^\.PHONY: (.*)$", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    return set(line.split())


def named_tests() -> Iterator[str]:
    """Yield the files of tests that ways.yaml names."""
    yield from re.findall(r"tests/[\w/]+\.py", FILE.read_text(encoding="utf-8"))
