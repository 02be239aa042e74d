"""Divide takes that all have a class into those to learn from, and those to annotate and evaluate."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

from kinedex.pipelines.ingestion.pattern_proposal import Proposal

_MOST = 0.34
"""The largest fraction of the takes that is held out."""

_VALUES = 5
"""The largest number of values that are held out, so that the filter stays readable."""

_EVERY = 4
"""If there is no column to divide by, each take whose number is divisible by this is held out."""


@dataclass(frozen=True)
class Division:
    """SQL filters over the columns of takes that divide an archive in two.

    Attributes
    ----------
    train : str
        The filter of the takes to learn from.
    annotate : str
        The filter of the takes to annotate.
    reason : str
        A description of the values that are held out.
    """

    train: str
    annotate: str
    reason: str


def division(proposals: Sequence[Proposal]) -> Division | None:
    """Divide takes by actor, by clip, or by another column from their paths, so that training has every class.

    Without such a column every fourth take is held out. The result is None if there are too few takes.

    Parameters
    ----------
    proposals : sequence of Proposal
        The patterns of all paths; each of them yields a class.
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
    """Return a few values whose takes cover many classes, while the takes of the other values cover every class.

    The list is empty if less than half of the classes would be evaluated.
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
