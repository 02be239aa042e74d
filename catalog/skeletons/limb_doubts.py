"""Find implausible limbs: without length, unequally long on the two sides, or with joints of the other side."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import numpy as np

from kinedex.ops.arrays import F64, I64

_LIMBS = (
    ("hip", "knee"), ("knee", "ankle"), ("ankle", "toes"), ("shoulder", "elbow"), ("elbow", "wrist"),
    ("wrist", "fingers"),
)  # fmt: skip
_WIDTHS = (("root", "hip"), ("neck", "shoulder"))
_BOTH_SIDES = (
    *(((f"l{a}", f"l{b}"), (f"r{a}", f"r{b}")) for a, b in _LIMBS),
    *(((a, f"l{b}"), (a, f"r{b}")) for a, b in _WIDTHS),
)
_TRUNK = (("root", "neck"), ("neck", "head"), ("root", "belly"), ("belly", "chest"))
_UNEQUAL = {"toes": 1.35, "fingers": 2.0, "hip": 1.5, "shoulder": 1.5}
"""Largest ratios of the lengths on both sides, by the outer joint: skeletons end feet and hands differently."""

_MOST_UNEQUAL = 1.2  # ratio of both sides' lengths of the other limbs
_NO_LENGTH = 0.02  # of the longest limb; no bone between these joints is so short
_VARYING = 0.05  # ranges of two lengths, as shares of these; those of bones are below it
_MOST_FRAMES = 32
_SHOWN = 4


def limb_doubts(positions: F64, joints: tuple[str, ...]) -> list[str]:
    """Return one warning that lists limbs without length, unequal limbs and exchanged sides; empty if there are none.

    Parameters
    ----------
    positions : float64 array (J, 3, T)
        The joints, in any unit; NaN where one is unknown.
    joints : tuple of str
        The names of the J joints.
    """
    pairs, ends = _pairs(joints)
    places = positions[:, :, :: -(-positions.shape[2] // _MOST_FRAMES)]
    last = places.shape[2] - 1
    with np.errstate(over="ignore", invalid="ignore"):  # Absurd numbers are refused elsewhere.
        apart = places[ends[:, 0]] - places[ends[:, 1]]
        lengths = np.sort(np.sqrt((apart * apart).sum(axis=1)), axis=1)
        low, middle, high = (lengths[:, round(share * last)] for share in (0.05, 0.5, 0.95))
        at = dict(zip(pairs, zip(middle.tolist(), (high - low).tolist(), strict=True), strict=True))
    found = [*_lengths(at), *_exchanged(at)]
    if not found:
        return []
    more = f", and {len(found) - _SHOWN} more such findings" if len(found) > _SHOWN else ""
    return [f"its skeleton, or the names of its joints, may be wrong: {'; '.join(found[:_SHOWN])}{more}"]


@cache
def _pairs(joints: tuple[str, ...]) -> tuple[list[tuple[str, str]], I64]:
    """Return the pairs of joints whose distances are looked at, and their indices (P, 2)."""
    pairs = [(f"{a}{inner}", f"{b}{outer}") for inner, outer in _LIMBS for a in "lr" for b in "lr"]
    widths = [(inner, f"{side}{outer}") for inner, outer in _WIDTHS for side in "lr"]
    known = [pair for pair in [*pairs, *widths, *_TRUNK] if set(pair) <= set(joints)]
    return known, np.array([[joints.index(joint) for joint in pair] for pair in known], np.int64).reshape(-1, 2)


Distances = dict[tuple[str, str], tuple[float, float]]
"""Two joints → the median of their distance and its range in nine of ten frames; NaN if one is unknown."""


def _lengths(at: Distances) -> Iterator[str]:
    """Yield a clause for each limb that has no length, or different lengths on the two sides."""
    both = {pair: (at[pair[0]][0], at[pair[1]][0]) for pair in _BOTH_SIDES if pair[0] in at and pair[1] in at}
    longest = max((max(pair) for pair in both.values() if pair[0] + pair[1] > 0), default=0.0)
    for (of_left, of_right), (left, right) in both.items():
        if not left + right >= 0:
            continue
        if min(left, right) < _NO_LENGTH * longest:
            yield f"{' and '.join(of_left if left < right else of_right)} are at the same place"
        elif max(left, right) > _UNEQUAL.get(of_left[1][1:], _MOST_UNEQUAL) * min(left, right):
            ratio = left / right
            yield f"{' and '.join(of_left)} are {ratio:.2f} times as far apart as {' and '.join(of_right)}"
    for a, b in _TRUNK:
        if at.get((a, b), (longest, 0.0))[0] < _NO_LENGTH * longest:
            yield f"{a} and {b} are at the same place"


def _exchanged(at: Distances) -> Iterator[str]:
    """Yield a clause for each pair of limbs whose outer joints seem to be exchanged between left and right.

    The distance of such a joint from the inner joint of the other limb is constant, while that from its own inner joint
    varies.

    Limbs that merely cross are not doubted, as the lengths of their bones stay the same.
    """
    for inner, outer in _LIMBS:
        if (f"l{inner}", f"l{outer}") not in at:
            continue
        left, right, far_left, far_right = f"l{inner}", f"r{inner}", f"l{outer}", f"r{outer}"
        own = [at[left, far_left], at[right, far_right]]
        crossed = [at[left, far_right], at[right, far_left]]
        if max(_shares(own), default=0.0) > _VARYING > max(_shares(crossed), default=1.0):
            yield f"{far_left} and {far_right} are as far from {right} and {left} in all frames, as if exchanged"


def _shares(found: list[tuple[float, float]]) -> list[float]:
    """Return the variation of each distance as a fraction of the distance."""
    return [spread / length for length, spread in found if length > 0]
