"""This module looks up poses by geodesic extrema, without knowing which extremum is which body part (thesis, 8.4.3).

Before the lookup, extrema are rotated by the facing direction. If the last pose is wrong, so is its facing direction,
and the lookup cannot find the right pose. Therefore poses that face other directions are proposed as well. The first
frame tries all directions, and for two of them every assignment of end effectors to extrema, because the person may be
lying. Later, every third frame tries one other direction, the next in `TURNS_DEG`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numba as nb
import numpy as np

from kinedex.ops.arrays import F32, F64, I64
from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.copies import copy_row, copy_table
from kinedex.ops.depth.pose_distance import COMPARED, END_EFFECTORS
from kinedex.ops.depth.pose_index import PoseIndex, PoseTree, search
from kinedex.ops.depth.thinned_poses import turn_poses
from kinedex.ops.errors import ParameterError

NEAR_M = 0.5
"""Distance in metres from the previous position within which an end effector is sought among extrema (μ of Eq. 8.4)."""

JUMP_M = 0.25
"""Distance in metres; the lowest extrema are tried as feet if one is farther than this from all extrema before."""

MAX_MAPS = 12
"""Maximum number of assignments of end effectors to extrema that are tried, in order of their sums of distances."""

NEIGHBOURS = 10
"""Number of poses that are retrieved for each assignment (K)."""

APART_M = 0.1
"""Minimum root mean square distance in metres between two candidates, over the compared joints."""

_LAMBDA = 0.5  # weight of the end effectors' distance in Eq. 8.6; the previous pose's distance has the rest
_FEET = 12  # number of assignments in which the two lowest extrema are the feet
_EVERY_MAP = np.array([*itertools.permutations(range(len(END_EFFECTORS)))], np.int64)

TURNS_DEG = (90.0, -90.0, 45.0, -45.0, 135.0, -135.0, 180.0)
"""Angles in degrees by which the facing direction is rotated, in the order in which they are tried."""

ALL_MAPS_DEG = (0.0, 180.0)
"""Rotations in degrees for which the first frame tries all assignments of end effectors to extrema. For other rotations
the lowest extrema are assumed to be the feet.
"""

TURN_FRAMES = 3
"""Interval in frames at which another direction is tried."""

TURNED_SHARE = 0.85
"""A pose that faces another direction is accepted if it costs less than this share of the local hypothesis.

A person looks almost the same from behind and from the front, so that small differences of the costs are due to chance.
"""


class Proposals(NamedTuple):
    """Candidates from the database, cheapest first, and the maps of end effectors to extrema that were tried.

    Attributes
    ----------
    poses : float64 array (C, 24, 3)
        The poses, placed in the frame, in metres.
    rows : int64 array (C,)
        The rows of the poses in the database.
    costs : float64 array (C,)
        The costs of the poses (thesis, Eq. 8.6, with root mean squares).
    ends : float64 array (C,)
        Root mean square distances of the end effectors from the extrema in metres.
    origins : int64 array (C,)
        The map by which each pose was found.
    maps : int64 array (M, 5)
        For each map the extremum that is assigned to each of the five end effectors.
    sums : float64 array (M,)
        For each map the sum of distances of the extrema from the previous end effectors in metres; NaN for a map that
        was found without them.
    rotations : float64 array (C,)
        The angle in degrees by which the facing direction was rotated for each pose.
    """

    poses: F64
    rows: I64
    costs: F64
    ends: F64
    origins: I64
    maps: I64
    sums: F64
    rotations: F64


class LookupBuffers(NamedTuple):
    """Preallocated arrays for C candidates of at most M maps, with the K nearest poses of each map.

    Parameters
    ----------
    maps : int64 array (M, 5)
        The extremum of each end effector.
    queries : float32 array (M, 15)
        The end effectors of each map, facing +Z, relative to the centre.
    rows, squares, costs : int64, float32 and float64 array (M, K)
        The nearest poses, their squared distances and their costs.
    placed : float64 array (C, 24, 3)
        The candidates.
    found : int64 array (C, 2)
        For each candidate the map, and the index among the nearest poses of the map.
    """

    maps: I64
    queries: F32
    rows: I64
    squares: F32
    costs: F64
    placed: F64
    found: I64


class Lookup:
    """Proposes poses of a database for the geodesic extrema of frames.

    Parameters
    ----------
    index : PoseIndex
        The poses of the database, with the bone lengths of the person.
    candidates : int, optional
        The maximum number of candidates of a frame.
    among : int, optional
        The number of extrema, from the first, among which end effectors are sought; the thesis uses 5.

    Raises
    ------
    ParameterError
        There is no candidate, or the number of extrema is not from 5 to 20.
    """

    def __init__(self, index: PoseIndex, candidates: int = 3, among: int = 6) -> None:
        if candidates < 1:
            raise ParameterError("candidates", "at least 1", candidates)
        if not 5 <= among <= 20:
            raise ParameterError("among", "from 5 to 20", among)
        self.index = index
        self.among = among
        count = min(NEIGHBOURS, len(index.poses))
        most = max(MAX_MAPS + _FEET, len(_EVERY_MAP))
        self._sums = np.empty(most)
        self._buffers = LookupBuffers(
            np.empty((most, 5), np.int64), np.empty((most, 15), np.float32), np.empty((most, count), np.int64),
            np.empty((most, count), np.float32), np.empty((most, count)), np.empty((candidates, len(JOINTS), 3)),
            np.empty((candidates, 2), np.int64),
        )  # fmt: skip

    def propose(
        self,
        extrema: F64,
        centre: F64,
        facing: F64,
        previous: F64 | None,
        *,
        compare: bool = True,
        jumped: bool = False,
        every: bool = False,
        turn_deg: float = 0.0,
    ) -> Proposals:
        """Propose poses of the database for a frame.

        Parameters
        ----------
        extrema : float64 array (N, 3)
            The geodesic extrema in their order, in metres; if there are fewer than five, no pose is proposed.
        centre : float64 array (3,)
            The centre of the points.
        facing : float64 array (3,)
            The horizontal unit direction that the person faces.
        previous : float64 array (24, 3) or None
            The pose of the previous frame; None if there is none.
        compare : bool, optional
            False for costs without the distance from the previous pose.
        jumped : bool, optional
            True to try also the two lowest extrema as feet, as is done without a previous pose.
        every : bool, optional
            True to try all assignments of the five end effectors to the first five extrema, and no others.
        turn_deg : float, optional
            The angle in degrees by which the facing direction is rotated, from Z towards X.

        Returns
        -------
        Proposals
            The candidates and the maps that were tried.
        """
        buffers, maps = self._buffers, 0
        if len(extrema) >= 5 and every:
            maps = len(_EVERY_MAP)
            buffers.maps[:maps], self._sums[:maps] = _EVERY_MAP, np.nan
        elif len(extrema) >= 5 and previous is not None:
            ends = np.ascontiguousarray(previous[END_EFFECTORS])
            maps = near_maps(extrema[: self.among], ends, buffers.maps, self._sums)
        if len(extrema) >= 5 and not every and (previous is None or jumped or not maps):
            maps = feet_maps(extrema[:5], buffers.maps, self._sums, maps)
        found = _propose(
            extrema, centre, turned_direction(facing, turn_deg),
            np.zeros((len(JOINTS), 3)) if previous is None else previous,
            previous is not None and compare, maps, self.index.tree, buffers,
        )  # fmt: skip
        chosen, positions = buffers.found[:found, 0].copy(), buffers.found[:found, 1]
        return Proposals(
            buffers.placed[:found].copy(),
            buffers.rows[chosen, positions],
            buffers.costs[chosen, positions],
            np.sqrt(buffers.squares[chosen, positions].astype(np.float64) / len(END_EFFECTORS)),
            chosen,
            buffers.maps[:maps].copy(),
            self._sums[:maps].copy(),
            np.full(found, turn_deg),
        )


def turned_direction(facing: F64, degrees: float) -> F64:
    """Return a horizontal direction (3,) rotated about Y by an angle in degrees, from Z towards X."""
    if degrees == 0.0:
        return facing
    cosine, sine = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return np.array([cosine * facing[0] + sine * facing[2], 0.0, cosine * facing[2] - sine * facing[0]])


@nb.njit(cache=True, nogil=True)
def near_maps(extrema: F64, ends: F64, maps: I64, sums: F64) -> int:
    """Write the injective maps of five end effectors to extrema with the smallest sums of distances.

    At most `MAX_MAPS` maps are written, and all of their distances are below `NEAR_M`.

    Parameters
    ----------
    extrema : float64 array (N, 3)
        The extrema to choose from.
    ends : float64 array (5, 3)
        The previous positions of the end effectors.
    maps : int64 array (M, 5)
        Output: the maps, ordered by their sums, and for equal sums by the indices of their extrema.
    sums : float64 array (M,)
        Output: the sums of distances.

    Returns
    -------
    int
        The number of maps.
    """
    count = len(extrema)
    distances = np.empty((5, count))
    for e in range(5):
        for n in range(count):
            x, y, z = ends[e, 0] - extrema[n, 0], ends[e, 1] - extrema[n, 1], ends[e, 2] - extrema[n, 2]
            distances[e, n] = np.sqrt(x * x + y * y + z * z)
    used, choice, partial = np.zeros(count, np.bool_), np.full(5, -1, np.int64), np.zeros(6)
    found, e = 0, 0
    while e >= 0:  # depth-first search over end effectors, extrema in ascending order
        if choice[e] >= 0:
            used[choice[e]] = False
        choice[e] += 1
        while choice[e] < count and (used[choice[e]] or not distances[e, choice[e]] < NEAR_M):
            choice[e] += 1
        if choice[e] == count:
            choice[e] = -1
            e -= 1
            continue
        partial[e + 1] = partial[e] + distances[e, choice[e]]
        if e < 4:
            used[choice[e]] = True
            e += 1
            continue
        if found == MAX_MAPS and not partial[5] < sums[found - 1]:
            continue
        found = min(found + 1, MAX_MAPS)
        place = found - 1
        while place > 0 and sums[place - 1] > partial[5]:
            sums[place] = sums[place - 1]
            copy_row(maps[place], maps[place - 1])
            place -= 1
        sums[place] = partial[5]
        copy_row(maps[place], choice)
    return found


@nb.njit(cache=True, nogil=True)
def feet_maps(extrema: F64, maps: I64, sums: F64, count: int) -> int:
    """Append the 12 maps of end effectors to extrema in which the two lowest are the feet; return the new number."""
    lowest = np.argsort(extrema[:, 1].copy(), kind="mergesort")
    feet, others = lowest[:2], lowest[2:]
    _sort_few(feet)
    _sort_few(others)
    for swap in range(2):
        for first in range(3):
            for second in range(3):
                if first != second:
                    maps[count, 0], maps[count, 1] = others[first], others[second]
                    maps[count, 2], maps[count, 3] = feet[swap], feet[1 - swap]
                    maps[count, 4] = others[3 - first - second]
                    sums[count] = np.nan
                    count += 1
    return count


@nb.njit(cache=True, nogil=True)
def _sort_few(numbers: I64) -> None:
    """Sort a short array in place."""
    for i in range(1, len(numbers)):
        number, place = numbers[i], i
        while place > 0 and numbers[place - 1] > number:
            numbers[place] = numbers[place - 1]
            place -= 1
        numbers[place] = number


@nb.njit(cache=True, nogil=True)
def _distance(pose: F64, other: F64) -> float:
    """Return the root mean square distance of two poses, see `ops.depth.pose_distance`."""
    total = 0.0
    for j in COMPARED:
        for axis in range(3):
            total += (pose[j, axis] - other[j, axis]) ** 2
    return np.sqrt(total / len(COMPARED))


@nb.njit(cache=True, nogil=True)
def _propose(
    extrema: F64,
    centre: F64,
    facing: F64,
    previous: F64,
    compare: bool,
    count: int,
    tree: PoseTree,
    buffers: LookupBuffers,
) -> int:
    """Retrieve poses for every map, place the cheapest ones that differ enough, and return their number."""
    poses, centres = tree.poses, tree.centres
    maps, queries, rows, squares, costs, placed, found = buffers
    turned = extrema - centre
    turn_poses(turned, -facing[0], facing[2])
    before = previous - centre
    turn_poses(before, -facing[0], facing[2])
    for m in range(count):
        for e in range(5):
            for axis in range(3):
                queries[m, 3 * e + axis] = turned[maps[m, e], axis]
    rows[:count], squares[:count] = -1, np.inf
    search(queries[:count], tree, rows[:count], squares[:count])
    for m in range(count):
        for k in range(rows.shape[1]):
            costs[m, k] = np.sqrt(float(squares[m, k]) / 5.0)
            if compare:
                pose = poses[rows[m, k]] - centres[rows[m, k]]
                costs[m, k] = _LAMBDA * costs[m, k] + (1.0 - _LAMBDA) * _distance(pose, before)
            else:
                costs[m, k] *= _LAMBDA
    taken = 0
    for flat in np.argsort(costs[:count].copy().ravel(), kind="mergesort"):
        if taken == len(placed):
            break
        m, k = flat // rows.shape[1], flat % rows.shape[1]
        pose = poses[rows[m, k]] - centres[rows[m, k]]
        turn_poses(pose, facing[0], facing[2])
        pose += centre
        apart = True
        for other in range(taken):
            apart &= _distance(pose, placed[other]) > APART_M
        if apart:
            copy_table(placed[taken], pose)
            found[taken, 0], found[taken, 1] = m, k
            taken += 1
    return taken


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
        The direction that the person probably faces, which is tried first.

    Returns
    -------
    Proposals
        The candidates of all directions, one direction after the other.
    """
    rotations = (0.0, *TURNS_DEG)
    return _joined(
        [lookup.propose(extrema, centre, facing, None, every=turn in ALL_MAPS_DEG, turn_deg=turn) for turn in rotations]
    )


def add_rotated(proposals: Proposals, lookup: Lookup, extrema: F64, centre: F64, facing: F64, number: int) -> Proposals:
    """Add the best pose that faces another direction and is not yet a candidate, with the lowest extrema as feet.

    Parameters
    ----------
    proposals : Proposals
        The candidates of the facing direction.
    lookup, extrema, centre, facing
        See `propose_start`.
    number : int
        The number of the search, which determines the direction: each search uses the next angle of `TURNS_DEG`.

    Returns
    -------
    Proposals
        The candidates, with the new one at the end.
    """
    turn = TURNS_DEG[number % len(TURNS_DEG)]
    other = lookup.propose(extrema, centre, facing, None, turn_deg=turn)
    new = np.flatnonzero(~np.isin(other.rows, proposals.rows))[:1]
    picked = {name: getattr(other, name)[new] for name in ("poses", "rows", "costs", "ends", "origins", "rotations")}
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
        The costs of the candidates in the vote.
    most : int
        The maximum number of results.
    """
    best: dict[int, int] = {}
    for number in np.argsort(costs, kind="stable").tolist():
        best.setdefault(int(proposals.rows[number]), number)
    return sorted([*best.values()][:most], key=lambda number: (float(proposals.costs[number]), number))
