"""Two evaluations compared: what got better and what got worse, in all, class by class and take by take."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from ops.measures.metrics import Counts, pooled
from pipelines.evaluation.runs import Scored

LEAST = 0.005
"""What changes by less than this is the same."""

LEVELS = ("f1", "f2")
DRAWS = 1000
NAMES = ("name", "title")
"""Settings that only name a method."""


@dataclass(frozen=True)
class Change:
    """One thing in both evaluations: F1 and F2 in A and in B; None where a measure is undefined."""

    name: str
    f1: tuple[float | None, float | None]
    f2: tuple[float | None, float | None]

    @property
    def by(self) -> tuple[float, float]:
        """The differences B − A of F1 and F2; 0 where one is undefined."""
        return _difference(self.f1), _difference(self.f2)

    @property
    def verdict(self) -> str:
        """better, worse, mixed or same."""
        up = any(one >= LEAST for one in self.by)
        down = any(one <= -LEAST for one in self.by)
        return "mixed" if up and down else "better" if up else "worse" if down else "same"


@dataclass(frozen=True)
class Comparison:
    """Two evaluations, B against A.

    overall: over the takes that both have. intervals: of the differences of F1 and F2, 95 % over takes. only_a,
    only_b: takes that one of them has, left out of `overall`. settings: the parameters of the annotation that are
    not the same: name, in A, in B; None where one has no such parameter.
    """

    a: str
    b: str
    overall: Change
    intervals: dict[str, tuple[float, float]]
    classes: tuple[Change, ...]
    takes: tuple[Change, ...]
    only_a: tuple[str, ...]
    only_b: tuple[str, ...]
    settings: tuple[tuple[str, object, object], ...] = ()

    @property
    def verdict(self) -> str:
        """What it comes to, in a sentence."""
        said = []
        for name, difference in zip(("F1", "F2"), self.overall.by, strict=True):
            low, high = self.intervals[name.lower()]
            sure = "" if math.isnan(low) else f" ({low:+.3f} to {high:+.3f}, 95 % over takes)"
            if abs(difference) < LEAST:
                said.append(f"{name} is the same{sure}")
                continue
            certain = not math.isnan(low) and (low > 0 or high < 0)
            how = "better" if difference > 0 else "worse"
            said.append(f"{name} is {how} by {abs(difference):.3f}{sure}{'' if certain else ', which may be chance'}")
        return "; ".join(said)

    def changed(self, what: Sequence[Change], verdict: str) -> list[Change]:
        """The changes of one verdict, the greatest first."""
        return sorted(
            (one for one in what if one.verdict == verdict), key=lambda one: (-sum(map(abs, one.by)), one.name)
        )


def compared(a: Scored, b: Scored, names: tuple[str, str]) -> Comparison:
    """Compare two evaluations.

    Parameters
    ----------
    names: what A and B are called.
    """
    both = [name for name in a.takes if name in b.takes]
    overall = _change("all", pooled(a.takes[name] for name in both), pooled(b.takes[name] for name in both))
    if not both:
        overall = _change("all", a.pooled, b.pooled)
    return Comparison(
        *names,
        overall,
        {
            level: difference_interval(
                [a.takes[name] for name in both], [b.takes[name] for name in both], _measure(level)
            )
            for level in LEVELS
        },
        tuple(_changes(a.classes, b.classes)),
        tuple(_changes(a.takes, b.takes)),
        tuple(sorted(set(a.takes) - set(b.takes))) if both else (),
        tuple(sorted(set(b.takes) - set(a.takes))) if both else (),
        tuple(
            (name, a.settings.get(name), b.settings.get(name))
            for name in dict.fromkeys((*a.settings, *b.settings))
            if name not in NAMES and a.settings.get(name) != b.settings.get(name)
        ),
    )


def without_repeats(comparisons: Sequence[Comparison]) -> list[Comparison]:
    """Comparisons of different names and the same content as one, with both names."""
    found: list[Comparison] = []
    for one in comparisons:
        for place, earlier in enumerate(found):
            if replace(one, a=earlier.a, b=earlier.b) == earlier:
                found[place] = replace(earlier, a=f"{earlier.a}; {one.a}", b=f"{earlier.b}; {one.b}")
                break
        else:
            found.append(one)
    return found


def difference_interval(
    a: Sequence[Counts], b: Sequence[Counts], measure: Callable[[Counts], float], draws: int = DRAWS, seed: int = 0
) -> tuple[float, float]:
    """A 95 % interval of the difference B − A of a measure: the same takes are drawn, with replacement, for both.

    Returns
    -------
    The percentile interval (low, high); NaN twice where there are no takes, or the difference is never defined.
    """
    if not a:
        return math.nan, math.nan
    ours, theirs = (np.array([tuple(vars(one).values()) for one in counts], np.int64) for counts in (a, b))
    drawn = np.random.default_rng(seed).integers(len(a), size=(draws, len(a)))
    values = [
        measure(Counts(*map(int, theirs[takes].sum(axis=0)))) - measure(Counts(*map(int, ours[takes].sum(axis=0))))
        for takes in drawn
    ]
    known = [value for value in values if not math.isnan(value)]
    if not known:
        return math.nan, math.nan
    low, high = np.quantile(known, [0.025, 0.975])
    return float(low), float(high)


def content(comparisons: Sequence[Comparison]) -> dict[str, object]:
    """Comparisons as JSON."""
    return {
        "format": "kinedex comparison 1",
        "comparisons": [
            {
                "a": one.a,
                "b": one.b,
                "verdict": one.verdict,
                "settings": [{"name": name, "a": ours, "b": theirs} for name, ours, theirs in one.settings],
                "overall": _row(one.overall),
                "intervals": {
                    name: [None if math.isnan(end) else end for end in ends] for name, ends in one.intervals.items()
                },
                "classes": [_row(change) for change in one.classes],
                "takes": [_row(change) for change in one.takes],
                "only_a": list(one.only_a),
                "only_b": list(one.only_b),
            }
            for one in comparisons
        ],
    }


def _row(change: Change) -> dict[str, object]:
    return {**asdict(change), "by": list(change.by), "verdict": change.verdict}


def _changes(a: Mapping[str, Counts], b: Mapping[str, Counts]) -> list[Change]:
    """What both have, in the order of A; what neither labels is left out."""
    return [
        _change(name, a[name], b[name])
        for name in a
        if name in b and any(one.frames_automatic + one.frames_manual for one in (a[name], b[name]))
    ]


def _change(name: str, a: Counts, b: Counts) -> Change:
    return Change(name, (_known(a.f1), _known(b.f1)), (_known(a.f2), _known(b.f2)))


def _known(value: float) -> float | None:
    return None if math.isnan(value) else value


def _difference(values: tuple[float | None, float | None]) -> float:
    a, b = values
    return 0.0 if a is None or b is None else b - a


def _measure(name: str) -> Callable[[Counts], float]:
    return lambda counts: float(getattr(counts, name))
