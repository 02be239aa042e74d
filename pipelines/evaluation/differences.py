"""Compare two evaluations: the changes of measures over all takes, of each class, and of each take."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from operator import attrgetter

from kinedex.ops.evaluation.detection import bootstrap
from kinedex.ops.evaluation.metrics import Counts, pooled
from kinedex.pipelines.annotation.methods import METHODS, annotation_method
from kinedex.pipelines.evaluation.annotation_scores import F_FRAMES, F_SEGMENTS, defined
from kinedex.pipelines.evaluation.written_evaluations import MethodEvaluation

MIN_CHANGE = 0.005
"""The smallest change of a measure that counts as a change."""

LEVELS = ("f1", "f2")
NAMES = ("name", "title")
"""The settings that only name a method, and do not affect its results."""

THRESHOLDS = ("tau", "tau_by_class")
"""The settings that do not affect methods that need no thresholds."""

Pair = tuple[float | None, float | None]


@dataclass(frozen=True)
class Change:
    """F (frames) and F (segments) of a class or take in A and in B.

    A measure is None if it is undefined: there was nothing to find, and nothing was labelled.
    """

    name: str
    f1: Pair
    f2: Pair

    @property
    def by(self) -> Pair:
        """The differences B − A of both measures; 0 if both values are undefined, None if only one is."""
        return _difference(self.f1), _difference(self.f2)

    @property
    def verdict(self) -> str:
        """The verdict: better, worse, mixed or same; incomparable if only one evaluation had something to find."""
        ways = [direction(self.f1), direction(self.f2)]
        if None in ways:
            return "incomparable"
        return "mixed" if {1, -1} <= set(ways) else "better" if 1 in ways else "worse" if -1 in ways else "same"


@dataclass(frozen=True)
class UnsharedContent:
    """The takes and classes that only one of two evaluations has."""

    takes: tuple[str, ...] = ()
    classes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Comparison:
    """The comparison of two evaluations, B against A.

    Attributes
    ----------
    a, b : str
        The names of the evaluations.
    overall : Change
        The change over the common takes; if there are none, the change between all takes of A and all takes of B.
    intervals : dict of str to (float, float)
        The 95 % intervals over takes of the differences of both measures.
    classes, takes : tuple of Change
        The changes of each class and take.
    common : int, optional
        The number of common takes; None if neither evaluation names its takes.
    only_a, only_b : UnsharedContent
        Takes and classes of one evaluation only, which are excluded.
    other_truth : UnsharedContent
        Takes and classes whose manual labels differ.
    settings : tuple of (str, object, object)
        Name, value in A and value in B of the parameters that differ; None if an evaluation lacks the parameter.
    """

    a: str
    b: str
    overall: Change
    intervals: dict[str, tuple[float, float]]
    classes: tuple[Change, ...]
    takes: tuple[Change, ...]
    common: int | None
    only_a: UnsharedContent
    only_b: UnsharedContent
    other_truth: UnsharedContent = UnsharedContent()
    settings: tuple[tuple[str, object, object], ...] = ()

    @property
    def verdict(self) -> str:
        """The result of the comparison as a sentence."""
        if self.common == 0:
            return "no take in common, so neither is better or worse"
        parts = [
            _measure_verdict(*one)
            for one in zip((F_FRAMES, F_SEGMENTS), (self.overall.f1, self.overall.f2), self._ends, strict=True)
        ]
        if self.other_truth != UnsharedContent():
            parts.append("but A and B were judged against different ground truth")
        return "; ".join(parts)

    @property
    def _ends(self) -> list[tuple[float, float]]:
        return [self.intervals[level] for level in LEVELS]

    @property
    def scope(self) -> str:
        """The takes of `overall`, as text for people."""
        if self.common is None:
            return "all of each"
        return f"all takes that both have: {self.common}" if self.common else "each over its own takes"

    def changed(self, what: Sequence[Change], verdict: str) -> list[Change]:
        """Return the changes with the given verdict, the largest first."""
        return sorted(
            (one for one in what if one.verdict == verdict),
            key=lambda one: (-sum(1.0 if by is None else abs(by) for by in one.by), one.name),
        )


def compare_evaluations(a: MethodEvaluation, b: MethodEvaluation, names: tuple[str, str]) -> Comparison:
    """Compare two evaluations over their common takes, with bootstrap intervals of the differences.

    Parameters
    ----------
    a, b : MethodEvaluation
        The evaluations.
    names : tuple of str
        The names of A and B.

    Returns
    -------
    Comparison
        The changes from A to B: overall, by class and by take.
    """
    both = [name for name in a.takes if name in b.takes]
    ours, theirs = ([one.takes[name] for name in both] for one in (a, b))
    apart = not both and bool(a.takes or b.takes)
    return Comparison(
        *names,
        _change("all", *((pooled(ours), pooled(theirs)) if both else (a.pooled, b.pooled))),
        {level: bootstrap(_difference_of(level), ours, theirs) for level in LEVELS},
        () if apart else tuple(_changes(a.classes, b.classes)),
        tuple(_changes(a.takes, b.takes)),
        len(both) if a.takes or b.takes else None,
        _alone(a, b),
        _alone(b, a),
        UnsharedContent() if apart else _other_truth(a, b),
        _settings(a, b),
    )


def direction(pair: Pair) -> int | None:
    """Return 1 if a measure increases from A to B, −1 if it decreases, and 0 if it does not change.

    If a measure is undefined in one evaluation, there was nothing to find and nothing was labelled. A value of 0 in the
    other evaluation then counts as worse, because something was labelled in vain. None is returned if only one of the
    evaluations had something to find.
    """
    a, b = pair
    if a is not None and b is not None:
        return 1 if b - a >= MIN_CHANGE else -1 if b - a <= -MIN_CHANGE else 0
    if a is None and b is None:
        return 0
    if (b if a is None else a) != 0:
        return None
    return -1 if a is None else 1


def _measure_verdict(name: str, pair: Pair, ends: tuple[float, float]) -> str:
    """Return the part of the verdict about one measure."""
    way, by, (low, high) = direction(pair), _difference(pair), ends
    sure = "" if math.isnan(low) else f" ({low:+.3f} to {high:+.3f}, 95 % over takes)"
    if pair == (None, None):
        return f"{name} is undefined in both"
    if way is None:
        return f"{name} is undefined in {'A' if pair[0] is None else 'B'}"
    if way == 0:
        return f"{name} is the same{sure}"
    how = "better" if way > 0 else "worse"
    if by is None:
        return f"{name} is {how}: {'A' if way > 0 else 'B'} labels what is not there, the other one nothing"
    certain = not math.isnan(low) and (low > 0 or high < 0)
    return f"{name} is {how} by {abs(by):.3f}{sure}{'' if certain else ', which may be chance'}"


def _alone(one: MethodEvaluation, other: MethodEvaluation) -> UnsharedContent:
    return UnsharedContent(
        tuple(sorted(set(one.takes) - set(other.takes))),
        tuple(
            name
            for name, counts in one.classes.items()
            if name not in other.classes and counts.frames_automatic + counts.frames_manual
        ),
    )


def _other_truth(a: MethodEvaluation, b: MethodEvaluation) -> UnsharedContent:
    """Return common takes and classes whose numbers of manual frames or segments differ.

    Classes are compared only if both evaluations have the same takes.
    """

    def differ(ours: Mapping[str, Counts], theirs: Mapping[str, Counts]) -> tuple[str, ...]:
        manual = attrgetter("frames_manual", "segments_manual")
        return tuple(name for name in ours if name in theirs and manual(ours[name]) != manual(theirs[name]))

    same_takes = set(a.takes) == set(b.takes)
    return UnsharedContent(differ(a.takes, b.takes), differ(a.classes, b.classes) if same_takes else ())


def _settings(a: MethodEvaluation, b: MethodEvaluation) -> tuple[tuple[str, object, object], ...]:
    """Return the settings that differ, without those that do not affect A or B."""
    methods = [one.settings.get("method") for one in (a, b)]
    without = any(name in METHODS and not annotation_method(str(name)).needs.thresholds for name in methods)
    idle = {*NAMES, *(THRESHOLDS if without else ())}
    return tuple(
        (name, a.settings.get(name), b.settings.get(name))
        for name in dict.fromkeys((*a.settings, *b.settings))
        if name not in idle and a.settings.get(name) != b.settings.get(name)
    )


def without_repeats(comparisons: Sequence[Comparison]) -> list[Comparison]:
    """Merge comparisons with the same content, and join their names."""
    found: list[Comparison] = []
    for one in comparisons:
        for place, earlier in enumerate(found):
            if replace(one, a=earlier.a, b=earlier.b) == earlier:
                found[place] = replace(earlier, a=f"{earlier.a}; {one.a}", b=f"{earlier.b}; {one.b}")
                break
        else:
            found.append(one)
    return found


def comparisons_json(comparisons: Sequence[Comparison]) -> dict[str, object]:
    """Return comparisons as JSON values."""
    return {
        "format": "kinedex comparison 1",
        "comparisons": [
            {
                "a": one.a,
                "b": one.b,
                "verdict": one.verdict,
                "settings": [{"name": name, "a": ours, "b": theirs} for name, ours, theirs in one.settings],
                "common_takes": one.common,
                "overall": _row(one.overall),
                "intervals": {name: [defined(end) for end in ends] for name, ends in one.intervals.items()},
                "classes": [_row(change) for change in one.classes],
                "takes": [_row(change) for change in one.takes],
                "only_a": list(one.only_a.takes),
                "only_b": list(one.only_b.takes),
                "classes_only_a": list(one.only_a.classes),
                "classes_only_b": list(one.only_b.classes),
                "other_truth": {name: list(texts) for name, texts in asdict(one.other_truth).items()},
            }
            for one in comparisons
        ],
    }


def _row(change: Change) -> dict[str, object]:
    return {**asdict(change), "by": list(change.by), "verdict": change.verdict}


def _changes(a: Mapping[str, Counts], b: Mapping[str, Counts]) -> list[Change]:
    """Return the changes of the names in both A and B, in the order of A, without names that have no frames."""
    return [
        _change(name, a[name], b[name])
        for name in a
        if name in b and any(one.frames_automatic + one.frames_manual for one in (a[name], b[name]))
    ]


def _change(name: str, a: Counts, b: Counts) -> Change:
    return Change(name, (defined(a.f1), defined(b.f1)), (defined(a.f2), defined(b.f2)))


def _difference(pair: Pair) -> float | None:
    a, b = pair
    if a is None or b is None:
        return 0.0 if a is b else None
    return b - a


def _difference_of(level: str) -> Callable[[Counts, Counts], float]:
    return lambda ours, theirs: float(getattr(theirs, level) - getattr(ours, level))
