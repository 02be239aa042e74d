"""The choice of takes for a report that cannot show all: the worst, those around the median, the best."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from kinedex.ops.errors import KinedexError, ParameterError, did_you_mean

OPEN_ALL, OPEN = 10, 6
"""Up to `OPEN_ALL` timelines are all open; of more, `OPEN` come first and the others are folded."""


@dataclass(frozen=True)
class Choice:
    """The takes that a page shows, in its order, and those that it does not, by name; the last `folded` are folded."""

    shown: tuple[str, ...]
    left_out: tuple[str, ...]
    reason: str
    folded: int = 0


def choose_takes(
    names: Sequence[str], f1: Mapping[str, float], *, wanted: Sequence[str] | None = None, max_takes: int = 40
) -> Choice:
    """Choose the takes whose timelines are shown.

    Parameters
    ----------
    names : sequence of str
        All annotated takes.
    f1 : mapping of str to float
        F (frames) of the takes that have ground truth.
    wanted : sequence of str or None
        Exactly these takes, in this order; None chooses.
    max_takes : int
        Largest number of takes where they are chosen: a third each from the worst, the middle and the best.

    Returns
    -------
    Choice
        Takes with ground truth come first, the worst leading; the others follow by name. Of many takes, a few from the
        start, the middle and the end of this order come first, and the others are folded.

    Raises
    ------
    ParameterError
        If `max_takes` is not positive.
    KinedexError
        If a wanted take was not annotated.
    """
    if max_takes < 1:
        raise ParameterError("max_takes", "at least 1", max_takes)
    if wanted is not None:
        for name in wanted:
            if name not in names:
                raise KinedexError(f"takes: no annotated take is named '{name}'{did_you_mean(name, names)}")
        return Choice(tuple(wanted), tuple(sorted(set(names) - set(wanted))), "as requested")
    choice = _ranked(names, f1, max_takes)
    if len(choice.shown) <= OPEN_ALL:
        return choice
    first = worst_middle_best(choice.shown, OPEN)
    rest = [name for name in choice.shown if name not in first]
    return replace(choice, shown=(*first, *rest), folded=len(rest))


def _ranked(names: Sequence[str], f1: Mapping[str, float], max_takes: int) -> Choice:
    ranked = sorted((name for name in names if name in f1), key=lambda name: (f1[name], name))
    unranked = sorted(name for name in names if name not in f1)
    if len(names) <= max_takes:
        reason = "all takes, the lowest F (frames) first" if ranked else "all takes, by name"
        return Choice((*ranked, *unranked), (), reason)
    if not ranked:
        return Choice(tuple(unranked[:max_takes]), tuple(unranked[max_takes:]), "the first ones by name")
    shown = worst_middle_best(ranked, max_takes)
    rest = max_takes - len(shown)
    shown = [*shown, *unranked[:rest]]
    reason = "the worst, the middle and the best by F (frames), the lowest first"
    return Choice(tuple(shown), tuple(sorted(set(names) - set(shown))), reason)


def worst_middle_best(ranked: Sequence[str], count: int) -> list[str]:
    """Return `count` names of a ranked list: from its start, around its median, and from its end."""
    if len(ranked) <= count:
        return list(ranked)
    worst = (count + 2) // 3
    best = (count + 1) // 3
    middle = count - worst - best
    rest = len(ranked) - best - worst
    first = worst + (rest - middle) // 2
    return [*ranked[:worst], *ranked[first : first + middle], *ranked[len(ranked) - best :]]


def median_take(f1: Mapping[str, float]) -> str | None:
    """Return the median take by F (frames), the lower one of two; None where no take has ground truth."""
    ranked = sorted(f1, key=lambda name: (f1[name], name))
    return ranked[(len(ranked) - 1) // 2] if ranked else None
