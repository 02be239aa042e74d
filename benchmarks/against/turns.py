"""Measure a figure at two commits by turns, each time in a process of its own."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from benchmarks.against.commits import DRIVERS, Side
from kinedex.ops.errors import KinedexError

LIMIT_SECONDS = 600.0
"""The longest that one measurement may take."""


class DriverError(KinedexError):
    """Say that a driver ended with an error, or without a measurement."""


@dataclass(frozen=True)
class Missing:
    """The reason why a commit has no such figure."""

    reason: str


Measurement = dict[str, float] | Missing
Measure = Callable[[Side, str, Path], Measurement]


def order_of_turns(rounds: int) -> Iterator[tuple[int, int]]:
    """Yield which side comes first and which second in each round: A B, B A, A B, …

    What drifts during a run, such as the temperature of the processor, then weighs as much on one side as on the other.
    """
    for turn in range(rounds):
        yield (turn % 2, 1 - turn % 2)


def by_turns(
    sides: tuple[Side, Side], figure: str, inputs: Path, rounds: int, measure: Measure
) -> tuple[list[dict[str, float]], list[dict[str, float]]] | tuple[Measurement, Measurement]:
    """Measure a figure at both sides in every round, after one measurement each that only fills the caches.

    Parameters
    ----------
    sides : tuple of Side
        The two commits.
    figure : str
        The name of a function in `benchmarks/drivers/work.py`.
    inputs : Path
        Folder of the files that both read.
    rounds : int
        The number of measurements of each side.
    measure : callable
        Measures a figure once at one side.

    Returns
    -------
    tuple of list
        The measurements of the sides, one a round; where a side has no such figure, what was measured once.
    """
    first = tuple(measure(side, figure, inputs) for side in sides)
    if any(isinstance(one, Missing) for one in first):
        return first[0], first[1]
    found: tuple[list[dict[str, float]], list[dict[str, float]]] = ([], [])
    for turn in order_of_turns(rounds):
        for place in turn:
            one = measure(sides[place], figure, inputs)
            if isinstance(one, Missing):
                raise DriverError(f"{figure} at {sides[place].name} is missing in one round: {one.reason}")
            found[place].append(one)
    return found


def measure_once(side: Side, figure: str, inputs: Path) -> Measurement:
    """Measure a figure at one side in a new process of its interpreter.

    Raises
    ------
    DriverError
        The process failed, took longer than `LIMIT_SECONDS`, or printed no measurement.
    """
    work = side.work / inputs.name
    work.mkdir(parents=True, exist_ok=True)
    words = [side.python, DRIVERS / "launcher.py", side.driver, figure, inputs, work]
    environment = {**os.environ, "PYTHONPATH": str(side.tree)}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # else every start compiles every module
    try:
        done = subprocess.run(
            list(map(str, words)), env=environment, cwd=work, capture_output=True, text=True, timeout=LIMIT_SECONDS
        )
    except subprocess.TimeoutExpired:
        raise DriverError(f"{figure} at {side.name} took longer than {LIMIT_SECONDS:g} s") from None
    if done.returncode:
        raise DriverError(f"{figure} at {side.name} ended with status {done.returncode}: {reason_of(done.stderr)}")
    return read_answer(done.stdout, figure, side.name)


def reason_of(printed: str) -> str:
    """Return what a process printed on its failure: the last line, after that which a command of it printed before."""
    lines = printed.strip().splitlines() or ["nothing was printed"]
    begin = next((number for number, line in enumerate(lines) if line.startswith("Traceback ")), 0)
    return "; ".join([*lines[max(0, begin - 1) : begin], lines[-1]])


def read_answer(text: str, figure: str, name: str) -> Measurement:
    """Return what a driver printed: a measurement, or why there is none."""
    try:
        answer = json.loads(text)
    except ValueError:
        answer = {}
    if "missing" in answer:
        return Missing(str(answer["missing"]))
    timed = answer.get("seconds", 0) > 0 and answer.get("amount", 0) > 0
    if not timed and not answer.get("bytes", 0) > 0:
        raise DriverError(f"{figure} at {name} printed no measurement, but {text.strip()!r}")
    return {key: float(value) for key, value in answer.items()}
