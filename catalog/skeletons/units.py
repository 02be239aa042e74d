"""Units of length, and the guess of a file's unit from the height of the body."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path

from kinedex.ops.arrays import F64
from kinedex.ops.errors import SourceError

HUMAN_M = (1.0, 2.2)
"""Heights of a body, in metres, among which a unit is guessed; so narrow that no two units both fit."""

UNITS_M = {"metres": 1.0, "inches / 0.45 (Acclaim)": 0.0254 / 0.45, "inches": 0.0254, "cm": 0.01, "mm": 0.001}
"""The units of length that files come in, and the metres of one."""

RARE_UNITS_M = {"dm (MakeHuman)": 0.1}
"""Units that are tried where none of `UNITS_M` fits an adult."""

FEET_M = {"feet": 0.3048}
"""The unit that is tried last: a giant in metres has as many units as a child in feet."""

STATED_UNITS_M = {
    "m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "dm": 0.1, "ft": 0.3048, "meters": 1.0, "metres": 1.0,
    "decimeters": 0.1, "decimetres": 0.1, "centimeters": 0.01, "centimetres": 0.01, "millimeters": 0.001,
    "millimetres": 0.001, "inches": 0.0254, "feet": 0.3048,
}  # fmt: skip
"""A dict from word with which files state their unit of length, in lower case, to its metres."""

ADULT_M = 1.242
"""The least height by which a common unit goes before decimetres.

Bodies of 17.7 to 22 units are 1 to 1.24 m high in inches / 0.45, and 1.77 to 2.2 m in decimetres; adults are likelier.
"""

RARE_HEIGHTS_M = ((0.8, 1.0), (2.2, 2.3), (0.7, 0.8), (2.3, 4.1))
"""Ranges of heights that are tried if no unit gives a height in `HUMAN_M`, the likelier first: small children,
giants, and stylised figures, which are ingested with a warning on their height."""

_ROUNDED = 1e-5  # error of units that were written with six digits
_LEGS = (("lhip", "lknee", "lankle"), ("rhip", "rknee", "rankle"))
_TRUNK = ("root", "belly", "chest", "neck", "head", "headtop")
_LIKELY_M = (0.9, 2.3)  # heights of nearly everybody from the age of two
_POSSIBLE_M = (0.4, 4.1)  # heights with which a stated unit is accepted
_ADULTS_FIRST = ((ADULT_M, HUMAN_M[1]), HUMAN_M, *RARE_HEIGHTS_M)
_LOST = {f"units of {factor:g} of its own": factor for factor in (10.0, 100.0, 1000.0)}
_UPRIGHT = 1.1  # the share that feet and the slope of the pelvis add to the length of legs and trunk
_ARMS = (("lshoulder", "lelbow", "lwrist"), ("rshoulder", "relbow", "rwrist"))
_ARM_TO_LEG, _TRUNK_TO_LEG = 0.68, 0.76  # lengths of arms and trunk as shares of the legs', as in HDM05 and CMU


def guess_unit(source: str | Path, positions: F64, joints: tuple[str, ...]) -> tuple[str, float, float]:
    """Guess the unit of length from the height of a body, measured along its legs and trunk.

    Parameters
    ----------
    source : path
        The file that errors name.
    positions : float64 array (J, 3, T)
        Positions of the named joints, in the unit to be guessed.

    Returns
    -------
    tuple[str, float, float]
        The name of the unit (a key of `UNITS_M`, `RARE_UNITS_M` or `FEET_M`), its metres, and the height of the body
        in metres.

    Raises
    ------
    SourceError
        If no unit makes this a human height, or there are no legs to measure.
    """
    way_out = "state `unit_m` in the skeleton mapping"
    height = body_height(positions, joints)
    if height is None:
        raise SourceError(source, f"its unit of length cannot be guessed without a whole leg or arm; {way_out}")
    every = UNITS_M | RARE_UNITS_M
    tries = [(UNITS_M, (ADULT_M, HUMAN_M[1])), *((every, limits) for limits in _ADULTS_FIRST), (FEET_M, HUMAN_M)]
    for units, (low, high) in tries:
        for name, unit_m in units.items():
            if low <= height * unit_m <= high:
                return name, unit_m, height * unit_m
    raise SourceError(
        source,
        f"its unit of length cannot be guessed: the body is {height:.4g} units high, which is {RARE_HEIGHTS_M[2][0]:g} "
        f"to {RARE_HEIGHTS_M[3][1]:g} m in none of {', '.join(UNITS_M)}; {way_out}",
    )


def rival_unit(unit_m: float, height_m: float) -> tuple[str, float] | None:
    """Return another unit in which a body has a human height, too, with that height in metres; None if there is none.

    Parameters
    ----------
    unit_m : float
        Metres of the unit that was guessed.
    height_m : float
        The height of the body in metres by that unit.
    """
    for name, other_m in (UNITS_M | RARE_UNITS_M).items():
        if other_m != unit_m and HUMAN_M[0] <= height_m / unit_m * other_m <= HUMAN_M[1]:
            return name, height_m / unit_m * other_m
    return None


def unlikely_height(positions: F64, joints: tuple[str, ...], unit_m: float) -> float | None:
    """Return the height of a body in metres if hardly anybody is so short or so tall; None for a likely one.

    Parameters
    ----------
    positions : float64 array (J, 3, T)
        Positions of the named joints, in the file's unit.
    joints : tuple of str
        The names of the J joints.
    unit_m : float
        Metres of the stated unit.
    """
    height = body_height(positions, joints)
    return None if height is None or is_likely_height(height * unit_m) else height * unit_m


def is_likely_height(height_m: float) -> bool:
    """Return whether a height is that of nearly everybody from the age of two."""
    return _LIKELY_M[0] <= height_m <= _LIKELY_M[1]


def known_unit(unit_m: float) -> tuple[str, float]:
    """Return name and metres of the known unit nearly as long as the given one; otherwise describe the given one."""
    known = UNITS_M | RARE_UNITS_M | FEET_M
    near = (unit for unit in known.items() if math.isclose(unit[1], unit_m, rel_tol=_ROUNDED))
    return next(near, (f"units of {unit_m:.6g} m", unit_m))


def contradicted_unit(positions: F64, joints: tuple[str, ...], unit_m: float) -> tuple[str, float, float] | None:
    """Return the unit in which a body has a human height; None if the stated unit may be right.

    A stated unit is kept if the body is 0.4 to 4.1 m high in it, or if no unit gives a human height. Besides common
    units, 10, 100 and 1000 times the stated one are tried, for files whose lengths were converted twice.

    Parameters
    ----------
    positions : float64 array (J, 3, T)
        Positions of the named joints, in the file's unit.
    joints : tuple of str
        The names of the J joints.
    unit_m : float
        Metres of the stated unit.

    Returns
    -------
    tuple[str, float, float] or None
        The name of the unit, its metres, and the height of the body in metres.
    """
    height = body_height(positions, joints)
    if height is None or _POSSIBLE_M[0] <= height * unit_m <= _POSSIBLE_M[1]:
        return None
    lost = {name: factor * unit_m for name, factor in _LOST.items()}
    common, adult = UNITS_M | RARE_UNITS_M, (ADULT_M, HUMAN_M[1])
    for units, (low, high) in ((UNITS_M, adult), (common, adult), (common | lost, HUMAN_M)):
        for name, other_m in units.items():
            if other_m != unit_m and low <= height * other_m <= high:
                return name, other_m, height * other_m
    return None


def body_height(positions: F64, joints: tuple[str, ...]) -> float | None:
    """Return the height of a body along its legs and trunk, in the unit of its positions; None without leg and arm.

    If the body has no leg or no trunk, its length is estimated from an arm or a leg by human proportions.

    Parameters
    ----------
    positions : float64 array (J, 3, T)
        Positions of the named joints; the first frame counts.
    """
    first = zip(joints, positions[:, :, 0].tolist(), strict=True)
    known = {joint: place for joint, place in first if all(map(math.isfinite, place))}
    legs, arms = ([_length(known, limb) for limb in limbs if set(limb) <= known.keys()] for limbs in (_LEGS, _ARMS))
    if not legs and not arms:
        return None
    leg = max(legs) if legs else max(arms) / _ARM_TO_LEG
    trunk = [joint for joint in _TRUNK if joint in known]
    return _UPRIGHT * (leg + (_length(known, trunk) if len(trunk) > 1 else _TRUNK_TO_LEG * leg))


def _length(points: Mapping[str, Sequence[float]], chain: Iterable[str]) -> float:
    """Return the length of a chain of joints; infinite for absurd numbers, which no unit makes human."""
    return sum(math.dist(a, b) for a, b in pairwise(points[joint] for joint in chain))
