"""This module ranks labels by how much better another label would fit: another class, side, interval or rate.

Each label is judged by models that are learned from the labels of other takes. The distance between the descriptor of
its frames and its class is compared with the distances under other labels: those to other classes, that of its mirror
image, those of intervals around it, and those of its frames at twice and half the rate. The ratio of distances to the
best of these is compared with what is usual among the labels of the class, since some classes have less exact
boundaries, or are more similar to other classes. Labels that are probably wrong are excluded from learning.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from kinedex.ops.arrays import F64, I64
from kinedex.ops.body.facing_direction import mirrored_positions
from kinedex.ops.errors import ParameterError
from kinedex.ops.numeric.channels import channels
from kinedex.ops.numeric.class_densities import TEMPERATURE, ClassSums
from kinedex.ops.numeric.label_windows import LEAST_FRAMES, Window, described, known_part
from kinedex.ops.numeric.span_descriptors import SpanSums

BoolArray = npt.NDArray[np.bool_]
Kind = Literal["class", "side", "edges", "rate"]

KINDS: tuple[Kind, ...] = ("class", "side", "edges", "rate")
"""The kinds of mistakes: another class, the other side of the body, other edges, a wrong rate of the frames."""

SHIFTS = (-0.5, -0.35, -0.25, -0.15, 0.0, 0.15, 0.25, 0.35, 0.5)
"""The shares of a label's length by which its edges are moved."""

MOST_MOVED = 0.75
"""The largest sum of both shifts, unless both edges are moved alike."""

SHORTEST = 0.3
"""The shortest interval in place of a label, as a share of its length."""

MARGIN_FRAMES = 8
"""The frames around all of these intervals that smoothing reaches into."""

RATES = (2.0, 0.5)
"""The factors of the rate that are tried."""

DOUBTED = 0.1
"""Labels whose own class has less than this probability do not teach."""

MOST_FOLDS = 64
"""The largest number of parts that takes are divided into, each of which is left out once."""

USUAL = 4.0
"""The number of labels as which the labels of all classes count in what is usual in a class."""

POOLED_SHARE = 0.3
"""The share of the spread in all classes that is added to the spread in a class."""

SIDE_SHARE = 0.6
"""The share of another class's gain from which on the gain of the mirror image says that the side is wrong."""


ONE_SIDED = 1.05
"""The ratio of distances from which on mirror images usually fit worse than the labels, if the class has a side."""

WEIGHTS = (1.0, 1.0, 1.0, 0.5)
"""The weights of the `KINDS` in suspicion: speeds differ more by style than rates are wrong."""


class Place(NamedTuple):
    """A label: the number of its take, and its class."""

    take: int
    label: str


@dataclass(frozen=True)
class Judgement:
    """The judgement of a label by the labels of other takes.

    Attributes
    ----------
    reason : str
        Why the label cannot be judged; empty if it can.
    probability : float
        The probability of its class, by the labels of other takes.
    suspicion : float
        How much better the best other explanation fits than is usual in the class: the logarithm of the ratio of
        distances minus its usual value, in units of its spread in the class.
    kind : str
        The kind of mistake, one of `KINDS`; empty if nothing fits better.
    label : str
        The class that fits best among the others, for the kinds "class" and "side"; empty if there is none.
    interval : (int, int), optional
        The interval that fits best, within the window of the label, for the kind "edges".
    rate_factor : float, optional
        The factor of the rate that fits best, of `RATES`, for the kind "rate".
    """

    reason: str = ""
    probability: float = float("nan")
    suspicion: float = float("nan")
    kind: Kind | Literal[""] = ""
    label: str = ""
    interval: tuple[int, int] | None = None
    rate_factor: float | None = None


Windows = Callable[[], Iterable[tuple[int, Window]]]
"""Returns the window of each label, within `context_of` its interval, with its number, in any order; called twice."""


def context_of(start: int, stop: int, frames: int) -> tuple[int, int]:
    """Return the interval around a label whose frames are needed to judge it, in a take of `frames` frames."""
    around = int(np.ceil(SHIFTS[-1] * (stop - start))) + MARGIN_FRAMES
    return max(start - around, 0), min(stop + around, frames)


def judge_labels(places: Sequence[Place], windows: Windows, joints: Sequence[str], rate_hz: float) -> list[Judgement]:
    """Judge each label by those of other takes.

    Parameters
    ----------
    places : sequence of Place
        The takes and the classes of N labels.
    windows : callable
        Returns the windows of the labels.
    joints : sequence of str
        The names of the joints, the root first.
    rate_hz : float
        Frames per second.

    Returns
    -------
    list of Judgement, length N
    """
    names = sorted({one.label for one in places})
    classes = np.array([names.index(one.label) for one in places], np.int64)
    reasons = ["not given"] * len(places)
    descriptors: dict[int, F64] = {}
    for number, window in windows():
        try:
            descriptors[number] = _as_labelled(known_part(window), joints, rate_hz)
            reasons[number] = ""
        except ParameterError as fault:
            reasons[number] = str(fault)
    known = np.array(sorted(descriptors), np.int64)
    alone = np.bincount(classes[known], minlength=len(names))[classes] < 2
    for number in known[alone[known]].tolist():
        reasons[number] = "no other label of its class can be judged"
    found = [Judgement(reason) for reason in reasons]
    if alone[known].all():
        return found
    takes = np.array([one.take for one in places], np.int64)[known]
    every = np.stack([descriptors[number] for number in known.tolist()])
    taught = _LeftOut(every[:, 0], classes[known], _folds(takes, classes[known]), len(names))
    moved = _moved(windows, taught, dict(zip(known.tolist(), range(len(known)), strict=True)), joints, rate_hz)
    for row, judgement in zip(*_judged(taught, every, moved, names, ~alone[known]), strict=True):
        found[int(known[row])] = judgement
    return found


def _as_labelled(window: Window, joints: Sequence[str], rate_hz: float) -> F64:
    """Return the descriptors of a label, of its mirror image, and of its frames at each of `RATES`, float64 (4, D)."""
    image = window._replace(positions=mirrored_positions(window.positions, joints))
    rates = [described(window, joints, factor * rate_hz) for factor in RATES]
    return np.stack([described(window, joints, rate_hz), described(image, joints, rate_hz), *rates])


def _folds(takes: I64, classes: I64) -> I64:
    """Return the fold of each label: labels of one take share a fold, unless it would have all labels of a class."""
    names, own = np.unique(takes, return_inverse=True)
    count = max(min(len(names), MOST_FOLDS), 2)
    folds: I64 = own % count
    for one in range(int(classes.max()) + 1):
        places = np.flatnonzero(classes == one)
        if len(places) and len(np.unique(folds[places])) == 1:
            folds[places] = np.arange(len(places)) % count
    return folds


class _LeftOut:
    """The densities of the classes for each fold of labels, learned from the labels of the other folds.

    Parameters
    ----------
    descriptors : float64 array (E, D)
        The descriptors of the labels.
    classes, folds : int64 array (E,)
        The class and the fold of each label.
    count : int
        The number of classes.
    """

    def __init__(self, descriptors: F64, classes: I64, folds: I64, count: int) -> None:
        self.classes, self.folds = classes, folds
        self._sums = ClassSums(descriptors, classes, count)
        self._fit(np.zeros(len(classes), np.bool_))
        doubted = self.probabilities(self.distances(descriptors)) < DOUBTED
        for one in range(count):  # what most labels of a class are like is what the class is
            own = classes == one
            if len(np.unique(folds[own & ~doubted])) < 2 or 2 * doubted[own].sum() > own.sum():
                doubted[own] = False
        self._fit(doubted)

    def _fit(self, excluded: BoolArray) -> None:
        self.densities = [
            self._sums.without(np.flatnonzero((self.folds == fold) | excluded))
            for fold in range(int(self.folds.max()) + 1)
        ]

    def distances(self, descriptors: F64) -> F64:
        """Return the squared distances (E, P) of a descriptor of each label to classes learned from other folds."""
        found = np.empty((len(descriptors), len(self.densities[0].means)))
        for fold, one in enumerate(self.densities):
            found[self.folds == fold] = one.squared_distances(descriptors[self.folds == fold])
        return found

    def probabilities(self, distances: F64) -> F64:
        """Return the probability of each label's own class (E,), from the squared distances (E, P) to all classes."""
        logs = -distances / (2.0 * TEMPERATURE)
        shares = np.exp(logs - logs.max(axis=1, keepdims=True))
        found: F64 = self.own(shares) / shares.sum(axis=1)
        return found

    def own(self, values: F64) -> F64:
        """Return from values (E, P) the value of each label's own class, float64 (E,)."""
        found: F64 = np.take_along_axis(values, self.classes[:, None], axis=1)[:, 0]
        return found


class _Moved(NamedTuple):
    """The interval around each of E labels that is nearest to its class: its squared distance, and its frames."""

    distances: F64
    starts: I64
    stops: I64


def _moved(windows: Windows, taught: _LeftOut, rows: dict[int, int], joints: Sequence[str], rate_hz: float) -> _Moved:
    """Return the best other interval of each label; `rows` is a dict from a label's number to its row."""
    found = _Moved(np.full(len(rows), np.inf), np.zeros(len(rows), np.int64), np.zeros(len(rows), np.int64))
    for number, window in windows():
        row = rows.get(number)
        if row is None:
            continue
        positions, start, stop = known_part(window)
        starts, stops = _intervals(start, stop, len(positions))
        if len(starts):
            descriptors = SpanSums(channels(positions, joints, rate_hz), rate_hz).describe(starts, stops)
            densities = taught.densities[taught.folds[row]]
            distances = densities.squared_distances(descriptors)[:, taught.classes[row]]
            best = int(distances.argmin())
            before = window.start - start  # the frames of the window that are not known
            found.distances[row] = distances[best]
            found.starts[row], found.stops[row] = starts[best] + before, stops[best] + before
    return found


def _intervals(start: int, stop: int, frames: int) -> tuple[I64, I64]:
    """Return the starts and stops of the intervals around a label that are tried in its place."""
    length = stop - start
    shifts = [
        (first, last) for first in SHIFTS for last in SHIFTS if first == last or abs(first) + abs(last) <= MOST_MOVED
    ]
    edges = np.rint(np.array(shifts) * length).astype(np.int64)
    edges += [start, stop]
    edges = np.unique(edges.clip(0, frames), axis=0)
    lengths = edges[:, 1] - edges[:, 0]
    fits = (lengths >= max(LEAST_FRAMES, SHORTEST * length)) & np.any(edges != [start, stop], axis=1)
    return edges[fits, 0], edges[fits, 1]


def _judged(
    taught: _LeftOut, descriptors: F64, moved: _Moved, names: Sequence[str], chosen: BoolArray
) -> tuple[I64, list[Judgement]]:
    """Return the rows of chosen labels, and their judgements."""
    rows = np.flatnonzero(chosen)
    distances = taught.distances(descriptors[:, 0])
    others = np.where(np.arange(len(names)) == taught.classes[:, None], np.inf, distances)
    images = [taught.own(taught.distances(descriptors[:, place])) for place in range(1, 4)]
    best = np.stack([others.min(axis=1), images[0], moved.distances, np.minimum(*images[1:])])
    gains = np.log(np.maximum(taught.own(distances)[rows], 1e-9) / np.maximum(best[:, rows], 1e-9))
    gains[1, _two_sided(gains[1], taught.classes[rows])] = -np.inf
    excess = np.stack([_spreads(one, taught.classes[rows]) for one in gains]) * np.array(WEIGHTS)[:, None]
    suspicion = np.where(gains > 0, excess, -np.inf).max(axis=0)
    weights = gains.copy()
    weights[1] = np.where(gains[1] > SIDE_SHARE * gains[0], np.maximum(gains[0], gains[1]) + 1e-9, gains[1])
    kinds = weights.argmax(axis=0)
    probabilities = taught.probabilities(distances)
    found = []
    for column, row in enumerate(rows.tolist()):
        kind: Kind | Literal[""] = KINDS[kinds[column]] if gains[:, column].max() > 0 else ""
        is_other = kind == "class" or (kind == "side" and gains[0, column] > SIDE_SHARE * gains[1, column])
        found.append(
            Judgement(
                "",
                float(probabilities[row]),
                float(suspicion[column]) if kind else 0.0,
                kind,
                names[int(others[row].argmin())] if is_other else "",
                (int(moved.starts[row]), int(moved.stops[row])) if kind == "edges" else None,
                RATES[int(images[2][row] < images[1][row])] if kind == "rate" else None,
            )
        )
    return rows, found


def _two_sided(gains: F64, classes: I64) -> BoolArray:
    """Return a mask (E,) of the labels whose classes have no side, judged by the gains (E,) of mirror images."""
    usual = {one: _usual(gains[classes == one])[0] for one in np.unique(classes).tolist()}
    return np.array([usual[one] > -np.log(ONE_SIDED) for one in classes.tolist()])


def _spreads(gains: F64, classes: I64) -> F64:
    """Return how far gains (E,) are above the median of their class, in units of the class's spread.

    Median and spread of a class with few labels are averaged with those of all classes.
    """
    usual, spread = _usual(gains)
    found = np.empty(len(gains))
    for one in np.unique(classes):
        own = classes == one
        share = own.sum() / (own.sum() + USUAL)
        middle, width = _usual(gains[own])
        middle, width = share * middle + (1 - share) * usual, share * width + (1 - share) * spread
        found[own] = (gains[own] - middle) / (width + POOLED_SHARE * spread + 1e-9)
    return found


def _usual(values: F64) -> tuple[float, float]:
    """Return the median of the finite values, and the median distance from it; 0 and 0 if there are none."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return 0.0, 0.0
    middle = float(np.median(finite))
    return middle, float(np.median(np.abs(finite - middle)))
