"""Measure one figure in a process of its own: `PYTHON launcher.py DRIVER FIGURE INPUTS WORK` prints it as JSON.

Any commit's interpreter runs this file, with that commit's checkout on the path: nothing of kinedex is imported here.
`work.py` beside it has a function for each figure, which is the same for all commits; a driver is a module that says
how a commit does the parts of it: read a file, search a store.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

Measured = dict[str, float]

MIN_SECONDS, MAX_RUNS = 1.0, 9
"""Work is repeated until it has taken so long in all, or so often."""


class MissingWork(Exception):
    """Say that a commit has no way to do the work of a figure."""


class Driver:
    """A module that does the parts of the work at a commit; a part that it lacks raises `MissingWork`."""

    def __init__(self, path: str) -> None:
        self._module = loaded(Path(path))

    def __getattr__(self, part: str) -> Any:
        """Return the function of a part of the work."""
        if not hasattr(self._module, part):
            raise MissingWork(f"no {part.replace('_', ' ')}")
        return getattr(self._module, part)


class Bench:
    """Give the work its files and folders, and measure it.

    Attributes
    ----------
    inputs : Path
        Folder of the files that all commits read.
    work : Path
        Folder for the stores of this commit.
    """

    def __init__(self, inputs: Path, work: Path) -> None:
        self.inputs = inputs
        self.work = work

    def timed(self, work: Callable[[], object], amount: float, before: Callable[[], object] = lambda: None) -> Measured:
        """Return the shortest time in seconds of several runs of work, after one that fills the caches.

        Parameters
        ----------
        work : callable
            The work.
        amount : float
            The amount of work in the figure's unit.
        before : callable, optional
            Is called before each run, and not timed.
        """
        times = list[float]()
        while not times or (len(times) <= MAX_RUNS and sum(times[1:]) < MIN_SECONDS):
            before()
            begin = time.perf_counter()
            work()
            times.append(time.perf_counter() - begin)
        return {"seconds": min(times[1:] or times), "amount": amount}

    def command(self, *words: str) -> Measured:
        """Return the shortest time in seconds of a command of kinedex, from the start of its process to its end."""
        command = [sys.executable, "-m", "kinedex", *words]
        # into a pipe: a wait with a bound for a process without one looks every 50 ms
        return self.timed(lambda: subprocess.run(command, check=True, stdout=subprocess.PIPE, timeout=600), 1.0)

    def peak(self, work: Callable[[], object]) -> Measured:
        """Return the highest resident memory of this process up to the end of the work."""
        work()
        status = Path("/proc/self/status")
        if status.is_file():  # the number of getrusage includes the process that started this one
            lines = status.read_text(encoding="ascii").splitlines()
            return {"bytes": next(1024.0 * int(line.split()[1]) for line in lines if line.startswith("VmHWM"))}
        most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return {"bytes": float(most if sys.platform == "darwin" else 1024 * most)}

    def fresh(self, name: str) -> Path:
        """Return the path of a folder of this commit that does not exist."""
        shutil.rmtree(self.work / name, ignore_errors=True)
        self.work.mkdir(parents=True, exist_ok=True)
        return self.work / name


def loaded(path: Path) -> ModuleType:
    """Return the module in a file, which need not be on the path."""
    spec = spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def main(driver: str, figure: str, inputs: str, work: str) -> None:
    """Measure a figure with the driver of a commit, and print it."""
    said = os.dup(1)
    os.dup2(2, 1)  # whatever the work prints is no part of the answer
    measure = getattr(loaded(Path(__file__).with_name("work.py")), figure)
    try:
        answer: dict[str, object] = dict(measure(Bench(Path(inputs), Path(work)), Driver(driver)))
    except MissingWork as reason:
        answer = {"missing": str(reason)}
    with os.fdopen(said, "w", encoding="utf-8") as out:
        print(json.dumps(answer), file=out)


if __name__ == "__main__":
    main(*sys.argv[1:])
