"""`python -m tests.claims`: run all that is claimed at a small size, on all cores, and print a table.

The benchmarks and a sample of each attack; every command that the project prints, as tests/claims/ways.yaml has it;
every study on a small cut of the data that it takes. Exit code 1 where anything fails. `--nightly` runs the whole form.
"""

from __future__ import annotations

import argparse
import os
import shlex
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from kinedex.pipelines.engine.executors import cores
from studies.bounded_process import run_bounded
from studies.small_form import STORES, Bench, forms, stores_in
from tests.claims.outcomes import Outcome, table
from tests.claims.pages import run_page
from tests.claims.printed import ROOT
from tests.claims.ways import document, page_ways
from tests.real_data import SHARED

OF_MAKE = ("MAKEFLAGS", "MFLAGS", "MAKEOVERRIDES", "MAKELEVEL", "NIGHTLY", "CLAIMS")
"""Variables by which `make check-claims NIGHTLY=1` would ask every target that it runs for its longest form, too."""


@dataclass(frozen=True)
class Task:
    """Claims that are tried one after the other: name, what runs them, and the claims that must have been tried."""

    name: str
    run: Callable[[], Iterator[Outcome]]
    after: tuple[str, ...] = ()


@dataclass
class Report:
    """Prints each outcome when it is there, and keeps all."""

    outcomes: list[Outcome] = field(default_factory=list)
    begin: float = field(default_factory=time.perf_counter)
    lock: threading.Lock = field(default_factory=threading.Lock)

    def add(self, outcome: Outcome) -> None:
        """Keep and print an outcome."""
        with self.lock:
            self.outcomes.append(outcome)
            at = time.perf_counter() - self.begin
            result = outcome.result if outcome.failed else outcome.result.partition("\n")[0]
            print(f"{at:6.0f} s  {outcome.seconds:6.1f} s  {outcome.claim}: {result}", flush=True)


def command(name: str, form: Mapping[str, object], bench: Bench) -> Iterator[Outcome]:
    """Run a command of the checkout, which has a bound of seconds."""
    line = str(form["run"])
    for key, path in bench.places.items():
        line = line.replace(f"{{{key}}}", path)
    words = [sys.executable if word == "python" else word for word in shlex.split(line)]
    bound = float(str(form.get("seconds", 300)))
    begin = time.perf_counter()
    environment = {name: value for name, value in os.environ.items() if name not in OF_MAKE} | {"COLUMNS": "120"}
    ended = run_bounded(words, ROOT, environment, bound)
    if ended.code is None:
        result = f"took longer than {bound:g} s"
    else:
        result = "ok" if ended.code == 0 else ended.problem(f"exit code {ended.code}")
    yield Outcome(name, line, time.perf_counter() - begin, result)


def study(name: str, bench: Bench) -> Iterator[Outcome]:
    """Run the small form of a study."""
    found = bench.study(name, forms()[name])
    left_out = found.result.startswith("left out")
    way = found.result if left_out else "on small data"
    yield Outcome(f"python -m studies.{name}", way, found.seconds, "not run" if left_out else found.result)


def made(store: str, bench: Bench) -> Iterator[Outcome]:
    """Make a store that studies and pages share."""
    for one in bench.make(store):
        yield Outcome(one.name, "on small data, for what follows", one.seconds, one.result)


def tasks(bench: Bench, folder: Path, nightly: bool) -> list[Task]:
    """Return everything that is tried, what takes longest first."""
    found = [Task(store, partial(made, store, bench)) for store in STORES]
    for target, form in document()["make"].items():
        way = form["nightly"] if nightly and "nightly" in form else form
        if "run" in way:
            after = tuple(stores_in(str(way["run"])))
            found.append(Task(f"make {target}", partial(command, f"make {target}", way, bench), after))
    first = ("bandai", "prior_choice", "depth", "priors")
    for name in sorted(forms(), key=lambda one: (one not in first, one)):
        after = tuple(stores_in(forms()[name].run) - {name})
        found.append(Task(name, partial(study, name, bench), after))
    for number, page in enumerate(page_ways().values()):
        after = tuple(stores_in("".join(f"{{{source}}}" for source in page.given.values())))
        found.append(Task(page.name, partial(run_page, page, bench, folder / f"page-{number}"), after))
    return found


def chosen(todo: list[Task], names: Sequence[str]) -> list[Task]:
    """Return the tasks of some names with those that they need; all without names."""
    needed, by_name = set[str](), {task.name: task for task in todo}
    waiting = list(names or by_name)
    while waiting:
        name = waiting.pop()
        needed.add(name)
        waiting += by_name[name].after
    return [task for task in todo if task.name in needed]


def run_all(todo: list[Task], workers: int, report: Report) -> None:
    """Run tasks beside each other, each after those that it needs."""
    done = {task.name: threading.Event() for task in todo}

    def run(task: Task) -> None:
        try:
            for outcome in task.run():
                report.add(outcome)
        except Exception as fault:
            report.add(Outcome(task.name, "", 0.0, f"{type(fault).__name__}: {fault}"))
        finally:
            done[task.name].set()

    ready = threading.Condition()
    waiting = list(todo)

    def work() -> None:
        while True:
            with ready:
                while True:
                    task = next((one for one in waiting if all(done[name].is_set() for name in one.after)), None)
                    if task is not None or not waiting:
                        break
                    ready.wait(1.0)
                if task is None:
                    return
                waiting.remove(task)
            run(task)
            with ready:
                ready.notify_all()

    with ThreadPoolExecutor(workers) as pool:
        for _ in range(workers):
            pool.submit(work)


def main() -> int:
    """Try everything, and print the table."""
    parser = argparse.ArgumentParser(prog="python -m tests.claims", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="a page, a study, or 'make TARGET'; all by default")
    parser.add_argument("--nightly", action="store_true", help="the whole form of what has one")
    parser.add_argument("--workers", type=int, default=cores(), help="tasks beside each other")
    given = parser.parse_args()
    report = Report()
    with tempfile.TemporaryDirectory() as name:
        bench = Bench(Path(name) / "small", SHARED / "data")
        bench.begin()
        todo = tasks(bench, Path(name), given.nightly)
        if unknown := set(given.names) - {task.name for task in todo}:
            parser.error(f"nothing is called {', '.join(sorted(unknown))}")
        run_all(chosen(todo, given.names), given.workers, report)
    print(f"\n{table(report.outcomes)}, {(time.perf_counter() - report.begin) / 60:.1f} minutes")
    return 1 if any(one.failed for one in report.outcomes) else 0


if __name__ == "__main__":
    sys.exit(main())
