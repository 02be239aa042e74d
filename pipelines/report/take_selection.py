"""Which takes a report shows when it cannot show all: the worst, those in the middle, the best."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from kinedex.ops.errors import KinedexError, ParameterError, did_you_mean

OPEN_ALL = 10  # up to so many timelines are all open; of more, OPEN of them lead and the others are folded
OPEN = 6


@dataclass(frozen=True)
class Choice:
    """The takes shown, in the order in which they are shown, and those left out, by name.

    The last `folded` of those shown are there, but folded away.
    """

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
    names: all annotated takes.
    f1: F1 of the takes that have one.
    wanted: exactly these takes, in this order; None chooses.
    max_takes: how many at most when it chooses: a third each the worst, the middle and the best by F1.

    Returns
    -------
    The choice. Takes with an F1 come first, the worst leading; takes without ground truth follow by name. Of many, a
    few from the start, the middle and the end of this order lead, and the others are folded.

    Raises
    ------
    ParameterError: max_takes is not positive.
    KinedexError: a wanted take was not annotated.
    """
    if max_takes < 1:
        raise ParameterError("max_takes", "at least 1", max_takes)
    if wanted is not None:
        for name in wanted:
            if name not in names:
                raise KinedexError(f"takes: no annotated take is named '{name}'{did_you_mean(name, names)}")
        return Choice(tuple(wanted), tuple(sorted(set(names) - set(wanted))), "as asked for")
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
    """Take `count` of a ranked list: its start, the surroundings of its median, its end."""
    if len(ranked) <= count:
        return list(ranked)
    worst = (count + 2) // 3
    best = (count + 1) // 3
    middle = count - worst - best
    rest = len(ranked) - best - worst
    first = worst + (rest - middle) // 2
    return [*ranked[:worst], *ranked[first : first + middle], *ranked[len(ranked) - best :]]


def median_take(f1: Mapping[str, float]) -> str | None:
    """Return the take in the middle by F1 (the lower one of two), None where no take has one."""
    ranked = sorted(f1, key=lambda name: (f1[name], name))
    return ranked[(len(ranked) - 1) // 2] if ranked else None
