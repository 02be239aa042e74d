"""Proposals for other directions that a person may face than the one that is known.

Extrema are turned by the facing direction before poses are looked up. That of the last pose is wrong where the pose is,
and then no pose is found that could replace it. So all directions are tried at a start, two of them with every map of
ends to extrema since a person may lie, and one more direction in every third frame after it, in turn.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from kinedex.ops.depth.lookup import Lookup, Proposals

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]

TURNS_DEG = (90.0, -90.0, 45.0, -45.0, 135.0, -135.0, 180.0)
"""The facing direction is turned by each of these, in this order."""

ALL_MAPS_DEG = (0.0, 180.0)
"""At a start all maps of ends to extrema are tried for these turns; for the others the lowest extrema are the feet."""

TURN_FRAMES = 3
"""Another direction is tried in one of so many frames."""

TURNED_SHARE = 0.85
"""A pose that faces another direction is taken where it costs less than this share of the local hypothesis.

From behind, a person looks almost as from the front: the costs of both differ by little, and by chance.
"""


def propose_start(lookup: Lookup, extrema: F64, centre: F64, facing: F64) -> Proposals:
    """Propose poses that face any direction, without a previous pose.

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
    """Add the best pose that faces another direction, with the lowest extrema as feet, if it is not there already.

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
    """Return all candidates, with the maps of all parts."""
    maps = np.cumsum([0, *(len(one.maps) for one in parts)])
    origins = np.concatenate([one.origins + first for one, first in zip(parts, maps, strict=False)])
    columns = {
        name: np.concatenate([getattr(one, name) for one in parts]) for name in Proposals._fields if name != "origins"
    }
    return Proposals(origins=origins, **columns)


def best_of_rows(proposals: Proposals, costs: Sequence[float], most: int) -> list[int]:
    """Return the numbers of the candidates of least cost, one for each row of the database, by their lookup costs.

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
