"""A division of takes that all have a class: those to learn from, and those to annotate and to evaluate."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

from kinedex.pipelines.ingestion.pattern_proposal import Proposal

_MOST = 0.34
"""The largest share of the takes that is held out."""

_VALUES = 5
"""The largest number of values that are held out, so that a filter can be read."""

_EVERY = 4
"""Without a column to divide by, each take with a number that this divides is held out."""


@dataclass(frozen=True)
class Division:
    """Filters over the columns of takes that divide an archive in two.

    Attributes
    ----------
    train : str
        The takes to learn from.
    annotate : str
        The takes to annotate.
    reason : str
        The values that are held out, in words.
    """

    train: str
    annotate: str
    reason: str


def division(proposals: Sequence[Proposal]) -> Division | None:
    """Divide takes by actor, else by clip, else by another column of their paths, so that training keeps every class.

    Without such a column each fourth take is held out; None where the takes are too few for that.

    Parameters
    ----------
    proposals : sequence of Proposal
        The patterns of all paths, each of which gives a class.
    """
    columns = [{token.role: token.column.values for token in one.tokens if token.role} for one in proposals]
    shared = [role for role in columns[0] if all(role in one for one in columns) and role != "class"]
    classes = [name for one in columns for name in one["class"]]
    for role in sorted(shared, key=_order):
        values = [value for one in columns for value in one[role]]
        held_out = _held_out(classes, values)
        if held_out:
            listed = ", ".join(_quoted(value) for value in held_out)
            one = len(held_out) == 1
            return Division(
                f"{role} <> {listed}" if one else f"{role} NOT IN ({listed})",
                f"{role} = {listed}" if one else f"{role} IN ({listed})",
                f"the takes of {role} {' and '.join(held_out)}",
            )
    if len(classes) < _EVERY * len(set(classes)):
        return None
    return Division(f"take_id % {_EVERY} <> 0", f"take_id % {_EVERY} = 0", "every fourth take")


def _order(role: str) -> int:
    return {"actor": 0, "clip": 1}.get(role, 2)


def _held_out(classes: Sequence[str], values: Sequence[str]) -> list[str]:
    """Return few values that together have takes of many classes, while others have takes of every class, too.

    Empty where less than half of the classes would be evaluated.
    """
    of_value: dict[str, Counter[str]] = defaultdict(Counter)
    for name, value in zip(classes, values, strict=True):
        of_value[value][name] += 1
    of_value.pop("", None)
    left, found, covered = Counter(classes), list[str](), set[str]()
    while len(found) < _VALUES and len(covered) < len(left):
        room = _MOST * len(classes) - (len(classes) - left.total())
        fitting = {
            value: len(set(own) - covered)
            for value, own in of_value.items()
            if value not in found and own.total() <= room and all(left[name] > n for name, n in own.items())
        }
        best = max(fitting, key=lambda value: (fitting[value], value), default=None)
        if best is None or not fitting[best]:
            break
        found.append(best)
        covered |= set(of_value[best])
        left -= of_value[best]
    return sorted(found) if 2 * len(covered) >= len(set(classes)) else []


def _quoted(value: str) -> str:
    return "'" + value.replace("'", "''") + "'"
