"""This module proposes poses in which a person faces other directions than the one assumed so far.

Extrema are rotated by the facing direction before poses are looked up. If the last pose is wrong, so is its facing
direction, and the lookup cannot find the right pose. So the first frame tries all directions, two of them with every
assignment of end effectors to extrema, since a person may lie; later, every third frame tries one more direction, in
turn.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.ops.depth.lookup import Lookup, Proposals

TURNS_DEG = (90.0, -90.0, 45.0, -45.0, 135.0, -135.0, 180.0)
"""Angles in degrees by which the facing direction is rotated, in this order."""

ALL_MAPS_DEG = (0.0, 180.0)
"""Rotations in degrees for which the first frame tries all assignments of end effectors to extrema; for the others the
lowest extrema are the feet.
"""

TURN_FRAMES = 3
"""Another direction is tried in one of this many frames."""

TURNED_SHARE = 0.85
"""A pose that faces another direction is accepted if it costs less than this share of the local hypothesis.

From behind, a person looks almost as from the front: the costs of both differ by little, and by chance.
"""


def propose_start(lookup: Lookup, extrema: F64, centre: F64, facing: F64) -> Proposals:
    """Propose poses that face any direction, without using a previous pose.

    Parameters
    ----------
    lookup : Lookup
        The pose database.
    extrema : float64 array (N, 3)
        The geodesic extrema in metres.
    centre : float64 array (3,)
        The centre of the points.
    facing : float64 array (3,)
        The direction that the person probably faces, which comes first.

    Returns
    -------
    Proposals
        The candidates of all directions, one direction after the other.
    """
    turns = (0.0, *TURNS_DEG)
    return _joined(
        [lookup.propose(extrema, centre, facing, None, every=turn in ALL_MAPS_DEG, turn_deg=turn) for turn in turns]
    )


def add_turned(proposals: Proposals, lookup: Lookup, extrema: F64, centre: F64, facing: F64, number: int) -> Proposals:
    """Add the best pose that faces another direction, with the lowest extrema as feet, unless it is a candidate.

    Parameters
    ----------
    proposals : Proposals
        The candidates of the facing direction.
    lookup, extrema, centre, facing
        See `propose_start`.
    number : int
        The number of the search: each takes the next one of `TURNS_DEG`.

    Returns
    -------
    Proposals
        The candidates, with the new one at the end.
    """
    turn = TURNS_DEG[number % len(TURNS_DEG)]
    other = lookup.propose(extrema, centre, facing, None, turn_deg=turn)
    new = np.flatnonzero(~np.isin(other.rows, proposals.rows))[:1]
    picked = {name: getattr(other, name)[new] for name in ("poses", "rows", "costs", "ends", "origins", "turns")}
    return _joined([proposals, other._replace(**picked)])


def _joined(parts: Sequence[Proposals]) -> Proposals:
    """Concatenate the candidates of several searches, with their maps."""
    maps = np.cumsum([0, *(len(one.maps) for one in parts)])
    origins = np.concatenate([one.origins + first for one, first in zip(parts, maps, strict=False)])
    columns = {
        name: np.concatenate([getattr(one, name) for one in parts]) for name in Proposals._fields if name != "origins"
    }
    return Proposals(origins=origins, **columns)


def best_of_rows(proposals: Proposals, costs: Sequence[float], most: int) -> list[int]:
    """Return indices of the cheapest candidates, one for each row of the database, sorted by their lookup costs.

    Parameters
    ----------
    proposals : Proposals
        The candidates.
    costs : sequence of float
        Their costs in the vote.
    most : int
        The most candidates.
    """
    best: dict[int, int] = {}
    for number in np.argsort(costs, kind="stable").tolist():
        best.setdefault(int(proposals.rows[number]), number)
    return sorted([*best.values()][:most], key=lambda number: (float(proposals.costs[number]), number))
