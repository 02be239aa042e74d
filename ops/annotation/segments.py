"""This module makes annotated segments from the minima of distance curves (thesis, Section 5.2).

Templates match in few places, so a class's modified curve is ∞ nearly everywhere. Only its finite parts are stored, as
*islands* of neighbouring frames, and the computations run over these.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numba as nb
import numpy as np

from kinedex.ops.arrays import F64, I64, Bool
from kinedex.ops.errors import ParameterError

TOLERANCE = 1e-9

_BLOCK = 64  # frames that are skipped at once where all values are infinite


@dataclass(frozen=True, order=True)
class Segment:
    """A segment of a take, frames [start, stop), labelled with a class.

    Parameters
    ----------
    start, stop : int
        The half-open range of frames.
    class_index : int
        The class.
    cost : float
        The smallest distance in the segment.
    subclass : int
        The index of the curve that attains it.
    margin : float
        A number from 0 (another class or the background explains the frames as well) to 1 (no other explanation comes
        near).
    value : float
        The value of the segment in an explanation of the take (`ops.annotation.decoding`); NaN for other methods.
    """

    start: int
    stop: int
    class_index: int
    cost: float
    subclass: int
    margin: float = field(default=1.0, compare=False)
    value: float = field(default=np.nan, compare=False)


@dataclass(frozen=True)
class Matches:
    """The local minima of each template's distance curve below its threshold, with their paths.

    Parameters
    ----------
    offsets : int64 array (S + 1,)
        Template s has the minima offsets[s] to offsets[s + 1] − 1.
    starts, ends : int64 array (M,)
        The first and the last frame of the best path, both included, by ascending ends within a template.
    costs : float64 array (M,)
        The distances.
    """

    offsets: I64
    starts: I64
    ends: I64
    costs: F64

    def __len__(self) -> int:
        return len(self.offsets) - 1

    def parts(self) -> list[tuple[I64, I64, F64]]:
        """Return one (starts, ends, costs) tuple for each template."""
        pieces = [slice(start, stop) for start, stop in pairwise(self.offsets.tolist())]
        return [(self.starts[piece], self.ends[piece], self.costs[piece]) for piece in pieces]

    @staticmethod
    def of(parts: Sequence[tuple[I64, I64, F64]]) -> Matches:
        """Concatenate the (starts, ends, costs) tuples of templates into `Matches`."""
        offsets = np.cumsum([0, *(len(costs) for _, _, costs in parts)]).astype(np.int64)
        starts = np.concatenate([np.empty(0, np.int64), *(one for one, _, _ in parts)])
        ends = np.concatenate([np.empty(0, np.int64), *(one for _, one, _ in parts)])
        return Matches(offsets, starts, ends, np.concatenate([np.empty(0), *(one for _, _, one in parts)]))


def local_minima(curve: F64, threshold: float) -> I64:
    """Return the frames where a distance curve has a local minimum below a threshold.

    A minimum is finite and not above its neighbours; the curve is taken as ∞ beyond its ends. All frames of a plateau
    that is a minimum are returned. Costs that differ by less than 1e-9 are treated as equal.

    Parameters
    ----------
    curve : float64 array (L,)
        Distances; ∞ if no path ends in a frame.
    threshold : float
        τ > 0.

    Returns
    -------
    int64 array (M,)
        Ascending frames.

    Raises
    ------
    ParameterError
        If the threshold is not above 0.
    """
    if not threshold > 0:
        raise ParameterError("threshold", "above 0", threshold)
    beyond = np.concatenate(([np.inf], curve, [np.inf]))
    low = curve < threshold - TOLERANCE
    low &= curve <= beyond[:-2] + TOLERANCE
    low &= curve <= beyond[2:] + TOLERANCE
    return np.flatnonzero(low).astype(np.int64)


def annotate(matches: Matches, classes: I64, offsets: I64, threshold: float | F64 = np.inf) -> list[list[Segment]]:
    """Label every frame with the class of the lowest distance, and extend the labelled runs (thesis, Eq. 5.4 to 5.7).

    A template's modified curve is, in each frame, the lowest cost of all minima whose paths contain the frame (Eq.
    5.4). The modified curve of a class is the minimum over its subclasses (Eq. 5.5 and 5.6). In a tie, the first class
    and the first subclass are chosen. A run of frames with one label (Eq. 5.7) is extended to the left and to the right
    as long as the class's modified curve is finite and does not rise in that direction. Extended segments of one class
    that overlap or touch are merged.

    Parameters
    ----------
    matches : Matches
        The minima of each of S subclasses, in frames of the concatenated takes.
    classes : int64 array (S,)
        The class of each subclass, 0 … P − 1.
    offsets : int64 array (T + 1,)
        The first frame of each take, and the end. No path and no segment extends over two takes.
    threshold : float or float64 array (P,)
        The threshold τ of all classes or of each class, for the margins. A margin is 1 − cost / rival, where rival is
        the mean over the segment's frames of the nearest other class's modified curve, limited to the class's τ.

    Returns
    -------
    list of list of Segment
        The segments of each take in frames of the take, ordered by start, stop and class. Segments of different classes
        may overlap.

    Raises
    ------
    ParameterError
        If there is not one class for each subclass, or not one threshold for each class.
    """
    if len(classes) != len(matches) or (len(classes) and classes.min() < 0):
        raise ParameterError("classes", f"one index for each of {len(matches)} subclasses", len(classes))
    count = int(classes.max()) + 1 if len(classes) else 0
    given = np.asarray(threshold, np.float64)
    if given.ndim and len(given) < count:
        raise ParameterError("threshold", f"one for each of {count} classes", len(given))
    taus = np.ascontiguousarray(given if given.ndim else np.full(count, given))
    members = np.argsort(classes, kind="stable")
    edges = np.searchsorted(classes[members], np.arange(count + 1)).astype(np.int64)
    begins = np.zeros(int(offsets[-1]) + 1, np.bool_)
    begins[offsets] = True
    islands, curves = class_curves(matches.offsets, matches.starts, matches.ends, matches.costs, members, edges, begins)
    labels, *nearest = nearest_classes(islands, curves, int(offsets[-1]))
    positions, costs, sure = grow_runs(islands, curves, labels, *nearest, taus)
    takes = np.searchsorted(offsets, positions[:, 1], side="right") - 1
    subclasses = first_members(
        positions, costs, matches.offsets, matches.starts, matches.ends, matches.costs, members, edges
    )
    order = np.lexsort((positions[:, 0], positions[:, 2], positions[:, 1]))
    bounds = np.searchsorted(takes[order], np.arange(len(offsets)))
    rows = zip(
        (positions[order, 1] - offsets[takes[order]]).tolist(), (positions[order, 2] - offsets[takes[order]]).tolist(),
        positions[order, 0].tolist(), costs[order].tolist(), subclasses[order].tolist(), sure[order].tolist(),
        strict=True,
    )  # fmt: skip
    segments = [Segment(*row) for row in rows]
    return [segments[start:stop] for start, stop in zip(bounds[:-1].tolist(), bounds[1:].tolist(), strict=True)]


@nb.njit(cache=True, nogil=True)
def class_curves(
    offsets: I64, starts: I64, ends: I64, costs: F64, members: I64, edges: I64, begins: Bool
) -> tuple[I64, F64]:
    """Return the finite parts of the modified curves of classes (kernel).

    Parameters
    ----------
    offsets, starts, ends, costs
        See `Matches`.
    members : int64 array (S,)
        The indices of the subclasses, sorted by class.
    edges : int64 array (P + 1,)
        Class p has the subclasses members[edges[p]] to members[edges[p + 1] - 1].
    begins : bool array (L + 1,)
        The frames where a take begins, and the end.

    Returns
    -------
    islands : int64 array (I, 4)
        The class, the half-open range of frames, and the index of the first value of each island, by class and frame.
    values : float64 array
        The values of all islands.
    """
    frames = len(begins) - 1
    curve, touched = np.full(frames, np.inf), np.zeros(frames // _BLOCK + 1, np.bool_)
    islands, found = np.empty((256, 4), np.int64), 0
    values, filled = np.empty(4096), 0
    for p in range(len(edges) - 1):
        for member in range(edges[p], edges[p + 1]):
            s = members[member]
            for place in range(offsets[s], offsets[s + 1]):
                start, end, cost = starts[place], ends[place], costs[place]
                for frame in range(start, end + 1):
                    curve[frame] = min(curve[frame], cost)
                touched[start // _BLOCK : end // _BLOCK + 1] = True
        inside = False
        for block in range(len(touched)):
            if not touched[block]:
                inside = False
                continue
            touched[block] = False
            if filled + _BLOCK > len(values):
                values = np.concatenate((values, values))
            if found + _BLOCK > len(islands):
                islands = np.concatenate((islands, islands))
            for frame in range(block * _BLOCK, min((block + 1) * _BLOCK, frames)):
                if curve[frame] == np.inf:
                    inside = False
                    continue
                if not inside or begins[frame]:
                    islands[found, 0], islands[found, 1], islands[found, 3] = p, frame, filled
                    found += 1
                    inside = True
                islands[found - 1, 2] = frame + 1
                values[filled] = curve[frame]
                filled += 1
                curve[frame] = np.inf
    return islands[:found].copy(), values[:filled].copy()


@nb.njit(cache=True, nogil=True)
def nearest_classes(islands: I64, values: F64, frames: int) -> tuple[I64, I64, F64, F64]:
    """Return each frame's label, nearest class, that class's cost and the next class's cost (kernel).

    The label is −1 in frames without a label.
    """
    labels, nearest = np.full(frames, -1, np.int64), np.full(frames, -1, np.int64)
    least, second = np.full(frames, np.inf), np.full(frames, np.inf)
    for island in range(len(islands)):
        shift = islands[island, 3] - islands[island, 1]
        for frame in range(islands[island, 1], islands[island, 2]):
            value = values[frame + shift]
            if value < least[frame]:
                second[frame] = least[frame]
                least[frame], nearest[frame] = value, islands[island, 0]
            elif value < second[frame]:
                second[frame] = value
    for island in range(len(islands)):
        shift = islands[island, 3] - islands[island, 1]
        for frame in range(islands[island, 1], islands[island, 2]):
            if labels[frame] < 0 and values[frame + shift] <= least[frame] + TOLERANCE:
                labels[frame] = islands[island, 0]
    return labels, nearest, least, second


@nb.njit(cache=True, nogil=True)
def grow_runs(
    islands: I64, values: F64, labels: I64, nearest: I64, least: F64, second: F64, taus: F64
) -> tuple[I64, F64, F64]:
    """Grow runs of labelled frames into segments (kernel).

    A run is extended to the left and to the right as long as the curve of its class does not rise, within its island.
    If a run reaches the previous segment, it extends that segment.

    Returns
    -------
    places : int64 array (R, 4)
        The class, the half-open range of frames, and the first frame of the lowest cost of each segment.
    costs : float64 array (R,)
        The lowest cost of each segment.
    margins : float64 array (R,)
        Margins from 0 to 1: 1 − cost / rival, where rival is the mean cost of the nearest other class, at most τ.
    """
    positions, found = np.empty((256, 4), np.int64), 0
    for island in range(len(islands)):
        p, begin, stop = islands[island, 0], islands[island, 1], islands[island, 2]
        curve = values[islands[island, 3] : islands[island, 3] + stop - begin]
        before = found
        frame = begin
        while frame < stop:
            if labels[frame] != p:
                frame += 1
                continue
            left, right = frame, frame + 1
            while right < stop and labels[right] == p:
                right += 1
            frame = right
            # A segment that grows into the previous segment ends where that segment ends, or later.
            wall = positions[found - 1, 2] if found > before else begin
            while left > wall and not curve[left - 1 - begin] > curve[left - begin] + TOLERANCE:
                left -= 1
            right = max(right, wall)
            while right < stop and not curve[right - begin] > curve[right - 1 - begin] + TOLERANCE:
                right += 1
            if found > before and left <= wall:
                positions[found - 1, 2] = right
                continue
            if found == len(positions):
                positions = np.concatenate((positions, positions))
            positions[found, 0], positions[found, 1], positions[found, 2], positions[found, 3] = p, left, right, island
            found += 1
    costs, sure = np.empty(found), np.empty(found)
    for place in range(found):
        p, island = positions[place, 0], positions[place, 3]
        shift = islands[island, 3] - islands[island, 1]
        at, rivals = positions[place, 1], 0.0
        for frame in range(positions[place, 1], positions[place, 2]):
            if values[frame + shift] < values[at + shift]:
                at = frame
            rivals += min(second[frame] if nearest[frame] == p else least[frame], taus[p])
        rival = rivals / (positions[place, 2] - positions[place, 1])
        costs[place] = values[at + shift]
        sure[place] = 1.0 - min(costs[place] / rival, 1.0) if rival > 0 else 0.0
        positions[place, 3] = at
    return positions[:found].copy(), costs, sure


@nb.njit(cache=True, nogil=True)
def first_members(
    positions: I64, least: F64, offsets: I64, starts: I64, ends: I64, costs: F64, members: I64, edges: I64
) -> I64:
    """Return for each segment the first subclass with a path of lowest cost through its cheapest frame (kernel)."""
    longest = np.zeros(len(offsets) - 1, np.int64)
    for s in range(len(longest)):
        for place in range(offsets[s], offsets[s + 1]):
            longest[s] = max(longest[s], ends[place] - starts[place])
    result = np.full(len(positions), -1, np.int64)
    for segment in range(len(positions)):
        p, at = positions[segment, 0], positions[segment, 3]
        for member in range(edges[p], edges[p + 1]):
            s = members[member]
            place = offsets[s] + np.searchsorted(ends[offsets[s] : offsets[s + 1]], at)
            while result[segment] < 0 and place < offsets[s + 1] and ends[place] <= at + longest[s]:
                if starts[place] <= at and costs[place] <= least[segment] + TOLERANCE:
                    result[segment] = s
                place += 1
    return result
