"""This module explains why a span of frames belongs to a class, by quantities that people understand and their values.

The evidence for one class against another is linear in the descriptor of the span, so that each number of the
descriptor has a share. The shares of numbers that belong together (the height of a hand, the turn, the duration) are
added. Since numbers are correlated, the share of a quantity can contradict its value. A quantity is only named if both
agree: a quantity with a positive share must be nearer to the median of this class's examples than of the other's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.ops.errors import ParameterError
from kinedex.ops.numeric.class_densities import TEMPERATURE, ClassSums
from kinedex.ops.numeric.span_descriptors import SLOW

LOW, HIGH = 10.0, 90.0
"""The percentiles of the examples that a value is compared with."""

DEGREES, LEG, PER_SECOND = "°", "leg lengths", "leg lengths/s"

TELLING = {DEGREES: 5.0, LEG: 0.02, PER_SECOND: 0.05, "s": 0.05}
"""The least difference between the medians of two classes of a quantity that is named, in its unit."""

PARTS = {
    "head": ("head", "headtop", "neck"),
    "trunk": ("belly", "chest"),
    "left elbow": ("lelbow",),
    "right elbow": ("relbow",),
    "left hand": ("lwrist", "lfingers"),
    "right hand": ("rwrist", "rfingers"),
    "left knee": ("lknee",),
    "right knee": ("rknee",),
    "left foot": ("lankle", "ltoes"),
    "right foot": ("rankle", "rtoes"),
}
"""The parts of the body, and their joints."""


@dataclass(frozen=True)
class Quantity:
    """A quantity of a span that people understand.

    Attributes
    ----------
    name, unit : str
        The name and the unit.
    more, less : str
        The words for a quantity that is larger, or smaller, than in examples.
    numbers : tuple of int
        The numbers of the descriptor that belong to it.
    read : callable
        Returns the quantity of descriptors (S, D), float64 (S,).
    """

    name: str
    unit: str
    more: str
    less: str
    numbers: tuple[int, ...]
    read: Callable[[F64], F64]


class Reason(NamedTuple):
    """A quantity that speaks for a class or against it.

    Attributes
    ----------
    text : str
        The sentence for people.
    quantity, unit : str
        The quantity and its unit.
    value : float
        Its value in the span.
    low, high : float
        The tenth and the ninetieth percentile among the examples of the class.
    other_low, other_high : float
        The same of the class that it is compared with.
    below : float
        The share of the examples of the class in which it is smaller.
    share : float
        Its part of the evidence, a difference of log densities; negative against the class.
    """

    text: str
    quantity: str
    unit: str
    value: float
    low: float
    high: float
    other_low: float
    other_high: float
    below: float
    share: float


class Explanation(NamedTuple):
    """The evidence for a class.

    Attributes
    ----------
    label, other : str
        The class, and the one that it is compared with: the most probable of the others.
    probability, other_probability : float
        Their probabilities.
    evidence : float
        The difference of their log densities; the shares of all quantities, named or not, add up to it.
    reasons : list of Reason
        The quantities that are named, those that say most first.
    """

    label: str
    other: str
    probability: float
    other_probability: float
    evidence: float
    reasons: list[Reason]


def explain(
    descriptor: F64, examples: F64, labels: Sequence[str], joints: Sequence[str], label: str | None = None
) -> Explanation:
    """Explain the evidence that a span belongs to a class.

    Parameters
    ----------
    descriptor : float64 array (D,)
        The descriptor of the span.
    examples : float64 array (E, D)
        Descriptors of examples.
    labels : sequence of str, length E
        Their classes, two at least.
    joints : sequence of str
        The names of the joints, the root first.
    label : str, optional
        The class; by default the most probable one.

    Raises
    ------
    ParameterError
        The class has no example, or no other class has one.
    """
    names = sorted(set(labels))
    if label is not None and label not in names:
        raise ParameterError("label", f"a class with examples ({', '.join(names)})", label)
    if len(names) < 2:
        raise ParameterError("labels", "of two classes or more", f"{len(names)}")
    classes = np.array([names.index(one) for one in labels], np.int64)
    densities = ClassSums(examples, classes, len(names)).without(np.empty(0, np.int64))
    distances = densities.squared_distances(descriptor[None])[0]
    probabilities = np.exp(-0.5 * (distances - distances.min()) / TEMPERATURE)
    probabilities /= probabilities.sum()
    one = int(distances.argmin()) if label is None else names.index(label)
    other = int(np.where(np.arange(len(names)) == one, np.inf, distances).argmin())
    shares = densities.shares(descriptor, one, other)
    reasons = []
    for quantity in quantities_of(tuple(joints)):
        value, every = float(quantity.read(descriptor[None])[0]), quantity.read(examples)
        own, theirs = every[classes == one], every[classes == other]
        share = float(shares[list(quantity.numbers)].sum())
        middle, other_middle = float(np.median(own)), float(np.median(theirs))
        nearer = abs(value - middle) < abs(value - other_middle)
        if nearer == (share > 0) and abs(middle - other_middle) >= TELLING[quantity.unit]:
            reasons.append(_reason(quantity, value, own, theirs, share))
    reasons.sort(key=lambda reason: -abs(reason.share))
    evidence = 0.5 * float(distances[other] - distances[one])
    return Explanation(
        names[one], names[other], float(probabilities[one]), float(probabilities[other]), evidence, reasons
    )


def _reason(quantity: Quantity, value: float, own: F64, theirs: F64, share: float) -> Reason:
    """Return a quantity as a reason, with its text."""
    low, high = np.percentile(own, [LOW, HIGH]).tolist()
    other_low, other_high = np.percentile(theirs, [LOW, HIGH]).tolist()
    where = ""
    if not low <= value <= high:
        word, than = (quantity.more, own < value) if value > high else (quantity.less, own > value)
        where = f", {word} than in {100 * than.mean():.0f} % of the examples"
    text = _turned(value, low, high) if quantity.unit == DEGREES else _amount(quantity, value, low, high, where)
    below = float(np.mean(own < value))
    return Reason(text, quantity.name, quantity.unit, value, low, high, other_low, other_high, below, share)


def _amount(quantity: Quantity, value: float, low: float, high: float, where: str) -> str:
    """Return a sentence that compares an amount with those of the examples."""
    examples = f"{where} ({low:.2f} to {high:.2f})" if where else f", examples {low:.2f} to {high:.2f}"
    return f"{quantity.name} {value:.2f} {quantity.unit}{examples}"


def _turned(value: float, low: float, high: float) -> str:
    """Return a sentence that compares a turn, in degrees, with those of the examples."""
    sides = ["left" if one >= 0 else "right" for one in (value, low, high)]
    degrees = [abs(round(one)) for one in (value, low, high)]
    examples = f"{degrees[1]}° {sides[1]} to {degrees[2]}° {sides[2]}"
    if sides[0] == sides[1] == sides[2]:
        examples = f"{min(degrees[1:])}° to {max(degrees[1:])}°"
    return f"turns {sides[0]} by {degrees[0]}°, examples {examples}"


@lru_cache(8)
def quantities_of(joints: tuple[str, ...]) -> tuple[Quantity, ...]:
    """Return the quantities of descriptors of a body with the given joints, of which the root is the first."""
    pose, speeds = 3 * (len(joints) - 1), len(joints)
    half = pose + speeds + 6
    root = pose + speeds
    last = 2 * half
    found = [
        Quantity("turn", DEGREES, "more to the left", "more to the right", (last, last + 1, root + 3, root + 4),
                 lambda rows: np.degrees(rows[:, last])),
        Quantity("way forwards", LEG, "longer", "shorter", (last + 3, root + 2), lambda rows: rows[:, last + 3]),
        Quantity("way to the left", LEG, "longer", "shorter", (last + 2, root), lambda rows: rows[:, last + 2]),
        Quantity("duration", "s", "longer", "shorter", (last + 4,), lambda rows: np.exp(rows[:, last + 4])),
        _mean("height of the hips", "higher", "lower", (root + 5,)),
        _spread("movement of the hips up and down", (half + root + 5, half + root + 1)),
    ]  # fmt: skip
    for part, names in PARTS.items():
        places = [joints.index(name) for name in names if name in joints]
        if not places:
            continue
        axes = [tuple(3 * (place - 1) + axis for place in places) for axis in range(3)]
        left, right = ("farther out", "farther in") if part.startswith("left") else ("farther left", "farther right")
        found += [
            _mean(f"height of the {part}", "higher", "lower", axes[1]),
            _mean(f"place of the {part} in front of the hips", "farther ahead", "farther back", axes[2]),
            _mean(f"place of the {part} left of the hips", left, right, axes[0]),
            *(
                _spread(f"movement of the {part} {way}", tuple(half + number for number in axes[axis]))
                for axis, way in ((1, "up and down"), (2, "to and fro"), (0, "side to side"))
            ),
            _speed(f"speed of the {part}", tuple(pose + place for place in places), half),
        ]
    return tuple(found)


def _mean(name: str, more: str, less: str, numbers: tuple[int, ...]) -> Quantity:
    return Quantity(name, LEG, more, less, numbers, lambda rows: rows[:, list(numbers)].mean(axis=1))


def _spread(name: str, numbers: tuple[int, ...]) -> Quantity:
    return Quantity(name, LEG, "more", "less", numbers, lambda rows: rows[:, numbers[0]])


def _speed(name: str, numbers: tuple[int, ...], half: int) -> Quantity:
    every = (*numbers, *(half + number for number in numbers))
    return Quantity(
        name, PER_SECOND, "faster", "slower", every, lambda rows: np.exp(rows[:, list(numbers)].mean(axis=1)) - SLOW
    )
