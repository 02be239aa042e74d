"""Choose and group the takes of a report."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import PurePosixPath

import polars as pl

from kinedex.ops.errors import KinedexError, ParameterError, did_you_mean
from kinedex.ops.intervals import TakeSegment

OPEN_ALL, OPEN = 10, 6
"""Up to `OPEN_ALL` timelines are all unfolded; if there are more, only the first `OPEN` are."""


@dataclass(frozen=True)
class Choice:
    """The takes of a page.

    Attributes
    ----------
    shown : tuple of str
        The takes with a timeline, in the order of the page.
    left_out : tuple of str
        The other takes, by name.
    reason : str
        The order in words.
    folded : int
        Number of takes at the end of `shown` that are folded.
    look : tuple of str
        The takes of `shown` with the most doubtful segments.
    """

    shown: tuple[str, ...]
    left_out: tuple[str, ...]
    reason: str
    folded: int = 0
    look: tuple[str, ...] = ()


@dataclass(frozen=True)
class Findings:
    """Totals of a take: the number and frames of its segments, their lowest confidence, and the doubtful segments."""

    segments: int
    frames: int
    least: float
    doubted: int


def findings_of(segments: Iterable[TakeSegment]) -> dict[str, Findings]:
    """Return the number, frames and confidences of the automatic segments of each take."""
    found: dict[str, Findings] = {}
    for one in segments:
        old = found.get(one.take, Findings(0, 0, 1.0, 0))
        sure = 1.0 if one.confidence is None else one.confidence
        found[one.take] = Findings(
            old.segments + 1, old.frames + one.stop - one.start, min(old.least, sure),
            old.doubted + (one.doubted is not None),
        )  # fmt: skip
    return found


def choose_takes(
    names: Sequence[str],
    f1: Mapping[str, float],
    *,
    findings: Mapping[str, Findings] | None = None,
    wanted: Sequence[str] | None = None,
    max_takes: int = 40,
) -> Choice:
    """Choose the takes whose timelines are shown.

    Parameters
    ----------
    names : sequence of str
        All annotated takes.
    f1 : mapping of str to float
        F (frames) of the takes that have ground truth.
    findings : mapping of str to Findings or None
        The totals of segments of each take, for takes without ground truth.
    wanted : sequence of str or None
        The takes to show, in this order; if None, takes are chosen.
    max_takes : int
        Largest number of takes that are chosen. With ground truth, a third each are the worst, the middle and the best
        takes; otherwise, half are the takes with the most segments, and half those with the most doubtful segments.

    Returns
    -------
    Choice
        The chosen takes. With ground truth, the worst takes come first; of many takes, a few from the start, the middle
        and the end of this order come first, and the others are folded. Without ground truth, takes with the most
        segments come first, and `look` has the takes with the most segments that another method contradicts, or with
        the least confident segment.

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
    if not f1:
        return _by_findings(names, findings or {}, max_takes)
    choice = _ranked(names, f1, max_takes)
    if len(choice.shown) <= OPEN_ALL:
        return choice
    first = worst_middle_best(choice.shown, OPEN)
    rest = [name for name in choice.shown if name not in first]
    return replace(choice, shown=(*first, *rest), folded=len(rest))


def _by_findings(names: Sequence[str], findings: Mapping[str, Findings], max_takes: int) -> Choice:
    """Choose takes without ground truth by their numbers of segments and of doubtful segments."""
    most = sorted(
        (name for name in names if name in findings),
        key=lambda name: (-findings[name].segments, -findings[name].frames, name),
    )
    looks = sorted(most, key=lambda name: (-findings[name].doubted, findings[name].least, name))
    empty = sorted(set(names) - set(most))
    if len(names) <= OPEN_ALL and len(names) <= max_takes:
        doubted = tuple(name for name in looks if findings[name].doubted)
        return Choice((*most, *empty), (), "the take with the most segments first", look=doubted)
    look = looks[: max_takes // 2]
    rest = [name for name in most if name not in look][: max_takes - len(look)]
    first = [*rest[: OPEN // 2], *look[: OPEN - len(rest[: OPEN // 2])]]
    shown = [*first, *(name for name in (*rest, *look) if name not in first)]
    reason = "the takes with the most segments first, then those that deserve a look: "
    doubts = any(one.doubted for one in findings.values())
    reason += "where another method disagrees most" if doubts else "those with the least confident segments"
    left_out = tuple(sorted(set(names) - set(shown)))
    return Choice(tuple(shown), left_out, reason, len(shown) - len(first), tuple(look))


def _ranked(names: Sequence[str], f1: Mapping[str, float], max_takes: int) -> Choice:
    ranked = sorted((name for name in names if name in f1), key=lambda name: (f1[name], name))
    unranked = sorted(name for name in names if name not in f1)
    if len(names) <= max_takes:
        return Choice((*ranked, *unranked), (), "all takes, the lowest F (frames) first")
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
    """Return the median take by F (frames), the lower of two; None if no take has ground truth."""
    ranked = sorted(f1, key=lambda name: (f1[name], name))
    return ranked[(len(ranked) - 1) // 2] if ranked else None


MIN_GROUPS, MAX_GROUPS = 2, 40
"""Minimum and maximum number of groups of takes."""

NONE = "other"
"""The group of takes without a value."""

_SHARE = 0.5  # smallest share of takes with a value
_OWN = ("class", "clip")  # columns that name the content or count takes
_EMPTY = (None, "")


def take_groups(takes: pl.DataFrame, columns: Sequence[str]) -> tuple[str, dict[str, str]]:
    """Group takes by the actor or, if that is not possible, by the column with the most values, or by the folder.

    Parameters
    ----------
    takes : polars.DataFrame
        Rows of `takes` with name, source, actor and the columns.
    columns : sequence of str
        The columns that come from named groups of patterns or from metadata.

    Returns
    -------
    name : str
        Name of the column, "folder", or empty if nothing divides the takes into `MIN_GROUPS` to `MAX_GROUPS` groups.
    groups : dict of str to str
        Name of a take → its group.
    """
    names = takes["name"].to_list()
    others = {name: takes[name].to_list() for name in columns if name not in (*_OWN, "actor") and name in takes.columns}
    folders = [PurePosixPath(source.replace("\\", "/")).parent.as_posix() for source in takes["source"].to_list()]
    candidates: dict[str, Sequence[object]] = {"actor": takes["actor"].to_list()}
    candidates |= {key: others[key] for key in sorted(others, key=lambda key: (-len(_values(others[key])), key))}
    candidates |= {"folder": ["" if one == "." else one for one in folders]}
    for name, values in candidates.items():
        if _divides(values):
            return name, {
                take: NONE if value in _EMPTY else str(value) for take, value in zip(names, values, strict=True)
            }
    return "", {}


def by_group(groups: Mapping[str, str], names: Sequence[str]) -> dict[str, list[str]]:
    """Return the takes of each group; groups and takes are sorted by name, but takes without a value come last."""
    found: dict[str, list[str]] = {}
    for name in names:
        found.setdefault(groups.get(name, ""), []).append(name)
    return {group: found[group] for group in sorted(found, key=lambda one: (one == NONE, one))}


def _values(values: Sequence[object]) -> set[object]:
    return {value for value in values if value not in _EMPTY}


def _divides(values: Sequence[object]) -> bool:
    known = sum(value not in _EMPTY for value in values)
    return (
        MIN_GROUPS <= len(_values(values)) <= MAX_GROUPS
        and known >= _SHARE * len(values)
        and len(_values(values)) < known
    )
