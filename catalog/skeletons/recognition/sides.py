"""Find left and right of a body: by names, and by the direction in which feet point and knees bend."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinedex.catalog.skeletons.recognition.anatomy import Anatomy
from kinedex.catalog.skeletons.recognition.limbs import Limb, Pair
from kinedex.catalog.skeletons.recognition.tree import Tree, lengths
from kinedex.ops.arrays import F64

_SEEN = 0.012  # share of a leg's length; shorter feet or knee bends have no clear direction
_SURE = 0.3  # least mean cosine, in absolute value, at which feet and knees decide against names


@dataclass(frozen=True)
class Sides:
    """The left and the right limbs of a body.

    Attributes
    ----------
    legs, arms : tuple of Limb, optional
        The left and the right one.
    named : bool
        True if names state the sides.
    mirrored : bool
        True if the limbs that are named left lie on the right: the file's axes are left-handed.
    facing : float
        From −1 to 1, how clearly feet and knees show that the left limbs are on the left; 0 without evidence.
    crossed : bool
        True if the left leg and the left arm lie on different sides.
    """

    legs: tuple[Limb, Limb] | None
    arms: tuple[Limb, Limb] | None
    named: bool
    mirrored: bool
    facing: float
    crossed: bool


def find_sides(tree: Tree, body: Anatomy) -> Sides:
    """Find the left limbs of a body.

    Names decide where there are any. In a nameless tree left is where up (from the ankle to the hip) and ahead (where
    the feet point and the knees bend) put it in right-handed axes.
    """
    legs, arms = _ordered(tree, body.legs), _ordered(tree, body.arms)
    named = any(_stated(tree, limbs) for limbs in (legs, arms))
    facing = 0.0 if legs is None else _facing(tree, legs)
    if legs is not None and not _stated(tree, legs):
        together = 1.0 if arms is None else _along(tree, legs, arms)
        turn = together < 0 if arms is not None and _stated(tree, arms) else facing < 0
        if turn:
            legs, facing = legs[::-1], -facing
    crossed = False
    if legs is not None and arms is not None and _along(tree, legs, arms) < 0:
        if _stated(tree, arms):
            crossed = True
        else:
            arms = arms[::-1]
    return Sides(legs, arms, named, named and facing < -_SURE, facing, crossed)


def _ordered(tree: Tree, pair: Pair | None) -> tuple[Limb, Limb] | None:
    """Return a pair with the limb first whose names say left; unchanged if they say nothing."""
    if pair is None:
        return None
    first, second = pair.first, pair.second
    return (second, first) if _vote(tree, first) < _vote(tree, second) else (first, second)


def _vote(tree: Tree, limb: Limb) -> int:
    sides = [tree.names[node].side for node in limb.path]
    return sides.count("l") - sides.count("r")


def _stated(tree: Tree, limbs: tuple[Limb, Limb] | None) -> bool:
    return limbs is not None and _vote(tree, limbs[0]) > _vote(tree, limbs[1])


def _along(tree: Tree, legs: tuple[Limb, Limb], arms: tuple[Limb, Limb]) -> float:
    """Return the mean cosine between the line of the hips and that of the shoulders, both from right to left."""
    across = [_unit(tree.places[pair[0].nodes[0]] - tree.places[pair[1].nodes[0]]) for pair in (legs, arms)]
    return float(np.mean((across[0] * across[1]).sum(axis=0)))


def _facing(tree: Tree, legs: tuple[Limb, Limb]) -> float:
    """Return the mean cosine of the line from right hip to left hip with the left direction by feet and knees."""
    across = _unit(tree.places[legs[0].nodes[0]] - tree.places[legs[1].nodes[0]])
    total, weight = 0.0, 0.0
    for leg in legs:
        hip, knee, ankle = (tree.places[node] for node in leg.nodes)
        tip = tree.places[leg.path[-1]]
        shank, line = _unit(knee - ankle), _unit(hip - ankle)
        for up, vector in ((shank, tip - ankle), (line, knee - ankle)):
            ahead = vector - up * (up * vector).sum(axis=0)
            left = _cross(up, ahead)
            length = lengths(ahead)
            seen = length > _SEEN * leg.length
            total += float((across * left).sum(axis=0)[seen].sum())
            weight += float(length[seen].sum())
    return total / weight if weight > 0 else 0.0


def _cross(a: F64, b: F64) -> F64:
    """Return the cross products of vectors (3, K); `numpy.cross` takes three times as long for a few."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _unit(vectors: F64) -> F64:
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        found = vectors / lengths(vectors)
        return found if np.isfinite(found).all() else np.nan_to_num(found)
