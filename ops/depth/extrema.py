"""Geodesic extrema: the points that are farthest along the body, one after the other (thesis, Algorithm 4).

The first is the node farthest from the source. Each found node becomes a further source, and the next extremum is the
node farthest from all of them. The distances of one step are those of the step before, made smaller around the new
source: Dijkstra's algorithm is continued, and visits only nodes that come nearer. Distances equal those of a search
that starts anew from all sources, to the last bit.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from kinedex.ops.depth.graph import PointGraph
from kinedex.ops.depth.points import FrameCloud
from kinedex.ops.errors import ParameterError

F64 = npt.NDArray[np.float64]
I32 = npt.NDArray[np.int32]

SOURCE_DROP_M = 0.2
"""The source is the node nearest to the mean of the points, lowered by this."""

COUNT = 20
"""The number of extrema (thesis, Section 8.4.4)."""


class Extrema(NamedTuple):
    """The geodesic extrema of a frame; fewer than asked for where the body has fewer nodes.

    Attributes
    ----------
    nodes : int32 array (m,)
        The nodes.
    distances : float64 array (m,)
        The distance of each to the source and all earlier extrema, along the edges, in metres.
    visited : int32 array (m,)
        The number of nodes that the search before each of them has visited.
    """

    nodes: I32
    distances: F64
    visited: I32


class ExtremaRoom(NamedTuple):
    """The arrays of the search, for graphs of at most N nodes and M edges.

    Attributes
    ----------
    distances : float64 array (N,)
        The distance of each node.
    keys, heap : float64 array (M + 1,), int32 array (M + 1,)
        The heap: distances and nodes.
    """

    distances: F64
    keys: F64
    heap: I32


def extrema_room(nodes: int, edges: int) -> ExtremaRoom:
    """Return room for graphs of at most so many nodes and edges, each edge counted from both of its nodes."""
    return ExtremaRoom(np.zeros(nodes), np.zeros(edges + 1), np.zeros(edges + 1, np.int32))


def find_source(cloud: FrameCloud, graph: PointGraph, drop: float = SOURCE_DROP_M) -> int:
    """Return the node of the body that is nearest to the lowered mean of all points.

    Parameters
    ----------
    cloud : FrameCloud
        The points.
    graph : PointGraph
        Their graph.
    drop : float
        The distance that the mean is lowered by, along Y, in metres; 0 for the printed form.

    Returns
    -------
    int
        The node, ties to the lowest; −1 without a body.
    """
    return int(_nearest_to_mean(cloud.points, graph.body, drop))


def geodesic_extrema(graph: PointGraph, source: int, count: int = COUNT, room: ExtremaRoom | None = None) -> Extrema:
    """Return the geodesic extrema of a graph.

    Parameters
    ----------
    graph : PointGraph
        The graph.
    source : int
        The node that the search begins at.
    count : int
        The number of extrema.
    room : ExtremaRoom, optional
        Room of earlier frames, which is used again; None: it is made.

    Returns
    -------
    Extrema
        The extrema, ties in distance to the lowest node; only nodes that the source reaches.

    Raises
    ------
    ParameterError
        The source is not a node.
    """
    size = len(graph.body)
    if not 0 <= source < size:
        raise ParameterError("source", f"a node from 0 to {size - 1}", source)
    if room is None:
        room = extrema_room(size, len(graph.neighbours))
    nodes, distances, visited = np.empty(count, np.int32), np.empty(count), np.empty(count, np.int32)
    found = _find_extrema(
        graph.starts, graph.neighbours, graph.lengths, source, room.distances[:size], room.keys, room.heap,
        nodes, distances, visited,
    )  # fmt: skip
    return Extrema(nodes[:found], distances[:found], visited[:found])


@njit(cache=True, nogil=True)
def _nearest_to_mean(points: F64, body: npt.NDArray[np.bool_], drop: float) -> int:
    x, y, z = 0.0, 0.0, 0.0
    for i in range(len(points)):
        x, y, z = x + points[i, 0], y + points[i, 1], z + points[i, 2]
    count = max(len(points), 1)
    x, y, z = x / count, y / count - drop, z / count
    best, nearest = np.inf, -1
    for i in range(len(points)):
        if body[i]:
            dx, dy, dz = points[i, 0] - x, points[i, 1] - y, points[i, 2] - z
            square = dx * dx + dy * dy + dz * dz
            if square < best:
                best, nearest = square, i
    return nearest


@njit(cache=True, nogil=True)
def _find_extrema(
    starts: I32, neighbours: I32, lengths: F64, source: int, reached: F64, keys: F64, heap: I32,
    nodes: I32, distances: F64, visited: I32,
) -> int:  # fmt: skip
    """Fill the extrema, and return how many there are."""
    reached[:] = np.inf
    for k in range(len(nodes)):
        visited[k] = spread(starts, neighbours, lengths, source if k == 0 else nodes[k - 1], reached, keys, heap)
        farthest = 0.0
        nodes[k] = -1
        for i in range(len(reached)):
            if farthest < reached[i] < np.inf:
                farthest, nodes[k] = reached[i], i
        if nodes[k] < 0:
            return k
        distances[k] = farthest
    return len(nodes)


@njit(cache=True, nogil=True)
def spread(starts: I32, neighbours: I32, lengths: F64, source: int, reached: F64, keys: F64, heap: I32) -> int:
    """Add a source to distances along edges, by Dijkstra's algorithm with a binary heap.

    Parameters
    ----------
    starts, neighbours, lengths : int32 array (n + 1,), int32 array (m,), float64 array (m,)
        The graph, see `PointGraph`.
    source : int
        The node that gets the distance 0.
    reached : float64 array (n,)
        In and out: the distance of each node to the nearest source; infinite where none reaches it.
    keys, heap : float64 array (m + 1,), int32 array (m + 1,)
        Room for the heap.

    Returns
    -------
    int
        The number of visited nodes: those that leave the heap with their present distance.
    """
    reached[source] = 0.0
    keys[0], heap[0] = 0.0, source
    size, visited = 1, 0
    while size > 0:
        key, node = keys[0], heap[0]
        size -= 1
        _sift_down(keys, heap, size)
        if key > reached[node]:
            continue
        visited += 1
        for k in range(starts[node], starts[node + 1]):
            other, length = neighbours[k], key + lengths[k]
            if length < reached[other]:
                reached[other] = length
                _sift_up(keys, heap, size, length, other)
                size += 1
    return visited


@njit(cache=True, nogil=True)
def _sift_up(keys: F64, heap: I32, place: int, key: float, node: int) -> None:
    while place > 0:
        above = (place - 1) >> 1
        if keys[above] <= key:
            break
        keys[place], heap[place] = keys[above], heap[above]
        place = above
    keys[place], heap[place] = key, node


@njit(cache=True, nogil=True)
def _sift_down(keys: F64, heap: I32, size: int) -> None:
    """Put the last entry in the place of the first."""
    key, node, place = keys[size], heap[size], 0
    while True:
        below = 2 * place + 1
        if below >= size:
            break
        if below + 1 < size and keys[below + 1] < keys[below]:
            below += 1
        if keys[below] >= key:
            break
        keys[place], heap[place] = keys[below], heap[below]
        place = below
    keys[place], heap[place] = key, node
