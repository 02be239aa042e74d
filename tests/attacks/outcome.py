"""The common shape of the attacks: the options that each is given, and the counts and failures that it returns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path


@dataclass(frozen=True)
class Options:
    """The options of an attack.

    Attributes
    ----------
    seed : int
        The same seed makes the same cases.
    nightly : bool
        True for the full size; the ordinary sizes of all attacks together take at most 15 minutes on two cores.
    case : str or None
        The one case to repeat, as a failure names it; None for all of them.
    """

    seed: int = 0
    nightly: bool = False
    case: str | None = None


@dataclass(frozen=True)
class Failure:
    """A case in which an attack succeeded: its name, which `Options.case` takes, and the problem in one line."""

    case: str
    problem: str


@dataclass
class Outcome:
    """The outcome of an attack: counts by kind or phase, in the order of the table, and the failures."""

    counts: dict[str, int] = field(default_factory=dict)
    failures: list[Failure] = field(default_factory=list)

    def count(self, kind: str, number: int = 1) -> None:
        """Add to a count."""
        self.counts[kind] = self.counts.get(kind, 0) + number

    def fail(self, case: str, problem: str) -> None:
        """Add a failure."""
        self.failures.append(Failure(case, problem))


Attack = Callable[[Path, Options], Outcome]
"""An attack works in an empty folder, never prints, and returns what it has found."""
