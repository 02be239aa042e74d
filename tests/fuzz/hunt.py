"""The hunt: mutants of valid files are read in a child process, which may hang, crash, or ask for all memory."""

from __future__ import annotations

import multiprocessing
import os
import resource
import shutil
import signal
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache
from multiprocessing.connection import Connection
from pathlib import Path
from random import Random
from typing import Any, Literal

from tests.fuzz.mutations import mutate
from tests.fuzz.structure import change_structure
from tests.fuzz.targets import Target

CASE_SECONDS = 5.0
"""A file of a megabyte at most that takes more of a core's time than this, or ten times as long by the clock, hangs."""

MEMORY_BYTES = 1 << 30
"""The memory that a child may allocate beyond what it has once everything is imported and compiled."""

MAX_FINDINGS = 10
"""So many different findings of one target end its hunt: mend these first."""


@dataclass(frozen=True)
class Finding:
    """A mutant that was not read as it should be: its number, what happened, and where it is written."""

    target: str
    case: int
    what: str
    path: Path

    @property
    def command(self) -> str:
        """The line that reads this file again."""
        return f"python -m tests.fuzz {self.target} --file {self.path}"


@dataclass
class Report:
    """The result of fuzzing one target: numbers of cases, failures and times."""

    target: str
    cases: int = 0
    read: int = 0
    findings: list[Finding] = field(default_factory=list)


Mutator = Literal["bytes", "structure"]
"""The mutators of which every case can be repeated by its number; `tests.fuzz.guided` is a third one."""


def mutant(target: Target, seed: int, case: int, mutator: Mutator = "bytes") -> bytes:
    """Return the file of one case: the same seed and number always make the same bytes."""
    random = Random(f"{target.name}/{seed}/{case}")
    seeds = _seeds(target)
    data = seeds[random.choice(sorted(seeds))]
    if mutator == "structure":
        return change_structure(data, target.ending, random)[: target.largest]
    return mutate(data, target.mutations, random, target.largest)


def hunt(
    target: Target, seed: int, seconds: float, folder: Path, cases: int | None = None, mutator: Mutator = "bytes"
) -> Report:
    """Read mutants for some time, each in a child process with limits, and write those that go wrong into a folder.

    Parameters
    ----------
    target : Target
        The reader and its files.
    seed : int
        Seed of the mutants.
    seconds : float
        Time for reading, without that for loading and compiling.
    folder : Path
        Folder of the findings.
    cases : int or None
        Most mutants; None for as many as there is time for.
    mutator : str
        Makes the mutants.
    """
    report, known = Report(target.name), Counter[str]()
    deadline, case = time.monotonic() + seconds, 0
    while time.monotonic() < deadline and (cases is None or case < cases):
        with _Child(target, mutator, seed, case, cases) as child:
            deadline += child.wait_until_ready()  # compiling does not count
            for number, outcome in child.outcomes(deadline):
                report.cases += 1
                case = number + 1
                if outcome in ("read", "refused"):
                    report.read += outcome == "read"
                    continue
                kind = kind_of(outcome)
                known[kind] += 1
                if known[kind] == 1:
                    stem = f"{target.name}-{mutator}-{seed}-{number}"
                    data = mutant(target, seed, number, mutator)
                    report.findings.append(write_finding(target, stem, number, data, outcome, folder))
                if len(known) == MAX_FINDINGS:
                    return report
    return report


def kind_of(outcome: str) -> str:
    """Return a key of a defect: the type of the error and the lines that raised it, without numbers."""
    places = [line.strip() for line in outcome.splitlines() if line.strip().startswith("File ")]
    return " ".join((outcome.strip().splitlines()[-1].split(":")[0], *places[-2:]))


def write_finding(target: Target, stem: str, case: int, data: bytes, outcome: str, folder: Path) -> Finding:
    """Write a file that was not read as it should be, and beside it what happened."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{stem}{target.ending}"
    path.write_bytes(data)
    finding = Finding(target.name, case, outcome, path)
    path.with_suffix(path.suffix + ".txt").write_text(f"{finding.command}\n\n{outcome}\n", encoding="utf-8")
    return finding


@lru_cache(maxsize=32)
def _seeds(target: Target) -> dict[str, bytes]:
    return target.seeds()


@lru_cache(maxsize=1)
def _processes() -> Any:
    """Return the way to start children: forked from a process that has imported all readers, where systems can."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["tests.fuzz.hunt", "kinedex.storage.formats.motion.reader_table"])
    return context


class _Child:
    """A process that reads one mutant after the other; it is ended where one takes too long."""

    def __init__(self, target: Target, mutator: Mutator, seed: int, first: int, last: int | None) -> None:
        context = _processes()
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(
            target=_read_mutants, args=(theirs, target, mutator, seed, first, last), daemon=True
        )
        self._next = first
        self._process.start()
        theirs.close()

    def wait_until_ready(self) -> float:
        """Wait until the child has imported, compiled and read the seeds; return the seconds that this took."""
        begin = time.monotonic()
        message = self._pipe.recv()
        if message != "ready":
            raise RuntimeError(f"a seed is not read:\n{message}")
        return time.monotonic() - begin

    def outcomes(self, deadline: float) -> Iterator[tuple[int, str]]:
        """Case and outcome, one by one, until time is up or the child is gone."""
        while True:
            try:
                if not self._answers():
                    yield self._next, f"Hang: still at it after {CASE_SECONDS:g} s of a core's time"
                    return
                outcome = self._pipe.recv()
            except (EOFError, OSError):
                self._process.join()
                code = self._process.exitcode or 0
                name = signal.Signals(-code).name if code < 0 else str(code)
                yield self._next, f"Crash: the process ended with {name}"
                return
            if outcome == "done":
                return
            yield self._next, outcome
            self._next += 1
            if time.monotonic() >= deadline:
                return

    def _answers(self) -> bool:
        """Wait for the next outcome, on a machine that is busy with other things, too."""
        begun, before = time.monotonic(), self._core_seconds()
        while not self._pipe.poll(0.5):
            used, passed = self._core_seconds() - before, time.monotonic() - begun
            if used > CASE_SECONDS or passed > 10 * CASE_SECONDS:
                return False
        return True

    def _core_seconds(self) -> float:
        """Return the CPU seconds that the child has used so far, or wall-clock seconds on systems without /proc."""
        try:
            fields = Path(f"/proc/{self._process.pid}/stat").read_text().rsplit(")", 1)[1].split()
        except OSError:
            return time.monotonic()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def __enter__(self) -> _Child:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.join()
        self._pipe.close()


def _read_mutants(pipe: Connection, target: Target, mutator: Mutator, seed: int, first: int, last: int | None) -> None:
    """Read the seeds, then mutants, in the child, and send the outcome of each."""
    place = Path(tempfile.mkdtemp(prefix="kinedex-fuzz-"))
    with suppress(BrokenPipeError, KeyboardInterrupt):
        try:
            for key, data in target.seeds().items():
                outcome = attempt(target, place / f"seed{target.ending}", data)
                if outcome != "read":
                    pipe.send(f"{target.name}, seed '{key}': {outcome}")
                    return
            limit_memory(MEMORY_BYTES)
            pipe.send("ready")
            case = first
            while last is None or case < last:
                # a name of its own: what remembers files by their path must not know it already
                pipe.send(attempt(target, place / f"case{case}{target.ending}", mutant(target, seed, case, mutator)))
                case += 1
            pipe.send("done")
        finally:
            shutil.rmtree(place, ignore_errors=True)


def limit_memory(further: int) -> None:
    """Let this process have so many bytes more than it has, and no more."""
    pages = int(Path("/proc/self/statm").read_text().split()[0]) if Path("/proc/self/statm").exists() else None
    if pages is not None:
        limit = pages * os.sysconf("SC_PAGE_SIZE") + further
        resource.setrlimit(resource.RLIMIT_AS, (limit, resource.getrlimit(resource.RLIMIT_AS)[1]))


def attempt(target: Target, path: Path, data: bytes) -> str:
    """Read one file and return "read", "refused", or the traceback of an unexpected error."""
    path.write_bytes(data)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            return "read" if target.read(path) else "refused"
    except Exception:
        return traceback.format_exc()
    finally:
        path.unlink(missing_ok=True)


def each(targets: list[Target], work: Callable[[Target], Report], jobs: int) -> Iterator[Report]:
    """The reports of several targets, hunted side by side, as they come."""
    from concurrent.futures import ThreadPoolExecutor, as_completed

    with ThreadPoolExecutor(jobs) as pool:
        for future in as_completed([pool.submit(work, target) for target in targets]):
            yield future.result()
