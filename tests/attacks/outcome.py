"""The common shape of the attacks: the options that each is given, and the counts and failures that it returns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal


@dataclass(frozen=True)
class Options:
    """The options of an attack.

    Attributes
    ----------
    seed : int
        The same seed makes the same cases.
    size : {"sample", "ordinary", "nightly"}
        How many cases: a few of each attack; as many as `make attack` tries; or what a night has time for.
    case : str or None
        The one case to repeat, as a failure names it; None for all of them.
    """

    seed: int = 0
    size: Literal["sample", "ordinary", "nightly"] = "ordinary"
    case: str | None = None


@dataclass(frozen=True)
class Failure:
    """A case in which an attack succeeded: its name, which `Options.case` takes, and the problem in one line."""

    case: str
    problem: str


@dataclass
class Outcome:
    """The outcome of an attack: counts by kind or phase, in the order to show them, failures, and number of cases."""

    counts: dict[str, int] = field(default_factory=dict)
    failures: list[Failure] = field(default_factory=list)
    cases: int = 0

    def count(self, kind: str, number: int = 1) -> None:
        """Add to a count."""
        self.counts[kind] = self.counts.get(kind, 0) + number

    def fail(self, case: str, problem: str) -> None:
        """Add a failure."""
        self.failures.append(Failure(case, problem))


Attack = Callable[[Path, Options], Outcome]
"""An attack works in an empty folder, never prints, and returns what it has found."""
