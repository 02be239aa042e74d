"""The small form of studies: each runs as a program of its own, on small cuts of the data that it takes."""

from __future__ import annotations

import os
import re
import shlex
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import yaml

from studies.bounded_process import run_bounded
from studies.small_data import cut

ROOT = Path(__file__).resolve().parents[1]
FORMS = Path(__file__).with_name("small_forms.yaml")
MAX_SECONDS = 300.0
"""A study that takes longer fails: its small form is not small."""


@dataclass(frozen=True)
class Form:
    """The small form of a study.

    Attributes
    ----------
    run : str
        The arguments of the program, with names in braces; empty where `reason` is not.
    needs : tuple of str
        What must be in the folder of real data.
    exit : tuple of int
        The exit codes of success.
    reason : str
        Why there is no small form; empty where there is one.
    """

    run: str = ""
    needs: tuple[str, ...] = ()
    exit: tuple[int, ...] = (0,)
    reason: str = ""


@dataclass(frozen=True)
class Outcome:
    """The end of a program: its name, seconds, and "ok", or what is wrong."""

    name: str
    seconds: float
    result: str

    @property
    def failed(self) -> bool:
        """True where something is wrong; a study that is left out has not failed."""
        return self.result != "ok" and not self.result.startswith("left out")


def forms() -> dict[str, Form]:
    """Read the small forms of all studies."""
    found = yaml.safe_load(FORMS.read_text(encoding="utf-8"))
    return {
        name: Form(one.get("run", ""), tuple(one.get("needs", ())), tuple(one.get("exit", (0,))), one.get("not", ""))
        for name, one in found.items()
    }


STORES = {
    "demo": ("", "kinedex demo {demo} --minutes 2"),
    "hdm05": ("hdm05 cmu", "kinedex run hdm05-cmu --store {hdm05} --set source={data}/hdm05 --set cmu={data}/cmu"),
    "folds": (
        "hdm05",
        "kinedex run hdm05 --store {folds} --set source={data}/hdm05 "
        "--set learn_keyframes.runs=1 --set learn_keyframes.generations=20",
        "kinedex repair {folds}",  # which builds the index
    ),
}
"""Store → what must be in the folder of real data, and the commands that make it; the study `bandai` makes another."""


def stores_in(text: str) -> set[str]:
    """Return the stores that stand in braces in a text, or what they bring."""
    named = set(re.findall(r"\{(\w+)", text))
    return {"demo" if name == "archive" else name for name in named} & {*STORES, "bandai"}


@dataclass
class Bench:
    """A folder in which small studies run, with the data and the stores that they share.

    Attributes
    ----------
    folder : Path
        The folder; it is new.
    data : Path
        The folder of real data; it need not be there.
    """

    folder: Path
    data: Path
    places: dict[str, str] = field(default_factory=dict)

    def begin(self) -> None:
        """Cut the data, and name the places."""
        small, demo = self.folder / "data", self.folder / "demo"
        small.mkdir(parents=True)
        cut(self.data, small)
        queries = small / "queries.json"
        made = {"data": small, "demo": demo, "archive": self.folder / "demo-archive-2min", "folder": self.folder,
                "hdm05": self.folder / "hdm05", "folds": self.folder / "folds", "bandai": self.folder / "bandai",
                "queries": queries if queries.is_file() else ROOT / "configs" / "queries" / "example.yaml"}  # fmt: skip
        self.places = {name: shlex.quote(str(path)) for name, path in made.items()}

    def make(self, store: str) -> Iterator[Outcome]:
        """Make one of `STORES`; the outcomes of the commands that make it."""
        needs, *lines = STORES[store]
        if not self.missing(needs.split()):
            for line in lines:
                yield self.command(" ".join(line.split()[:3]), line)

    def path(self, name: str) -> Path:
        """Return a place by its name, or a path below one."""
        first, _, rest = name.partition("/")
        return Path(shlex.split(self.places[first])[0]) / rest

    def missing(self, needs: Sequence[str]) -> list[str]:
        """Return what is not in the folder of real data."""
        return [name for name in needs if not (self.data / name).is_dir()]

    def study(self, name: str, form: Form) -> Outcome:
        """Run the small form of a study."""
        if form.reason:
            return Outcome(name, 0.0, f"left out: {form.reason}")
        if missing := self.missing(form.needs):
            return Outcome(name, 0.0, f"left out: no {', '.join(missing)} in {self.data}")
        return self.command(name, f"studies.{name} {form.run}", form.exit)

    def command(self, name: str, line: str, codes: Sequence[int] = (0,)) -> Outcome:
        """Run a module of Python with arguments."""
        words = shlex.split(line.format(**self.places))
        environment = {**os.environ, "KINEDEX_STUDIES": str(self.folder / "build"), "COLUMNS": "160"}
        begin = time.perf_counter()
        result = ran([sys.executable, "-m", *words], environment, codes)
        return Outcome(name, time.perf_counter() - begin, result)


def ran(words: Sequence[str], environment: Mapping[str, str], codes: Sequence[int]) -> str:
    """Run a program; return "ok", or what is wrong with the end of its output."""
    ended = run_bounded(words, ROOT, environment, MAX_SECONDS)
    if ended.code is None:
        return f"took longer than {MAX_SECONDS:g} s"
    if ended.code not in codes:
        return ended.problem(f"exit code {ended.code}")
    return "ok" if ended.output.strip() else "printed nothing"


def run_small(names: Sequence[str], bench: Bench, show: Callable[[Outcome], None]) -> bool:
    """Run the small form of studies, one after the other.

    Parameters
    ----------
    names : sequence of str
        The studies; `bandai` makes a store that others need, and runs first.
    bench : Bench
        Where they run.
    show : callable
        Called with each outcome.

    Returns
    -------
    bool
        Whether all went well.
    """
    known, failed = forms(), False
    bench.begin()
    needed = set[str]().union(*(stores_in(known[name].run) for name in names))
    for store in STORES:
        for outcome in bench.make(store) if store in needed else ():
            show(outcome)
            failed |= outcome.failed
    for name in sorted({*names, *({"bandai"} & needed)}, key=lambda one: (one != "bandai", one)):
        outcome = bench.study(name, known[name])
        show(outcome)
        failed |= outcome.failed
    return not failed
