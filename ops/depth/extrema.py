"""This module finds geodesic extrema, the points farthest along the body, one after the other (thesis, Algorithm 4).

The first extremum is the node farthest from the source. Each extremum becomes a further source, and the next extremum
is the node farthest from all sources. A step starts from the distances of the previous step and reduces them around the
new source, so that it visits only nodes whose distance decreases. Nodes wait in buckets of about equal distance (Dial,
1969) instead of a heap, which takes a third of the time. The results equal those of Dijkstra's algorithm started from
all sources, to the last bit, because the distance of a node is the minimum of the same sums in any order of visits.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64, I32, Bool
from kinedex.ops.copies import copy_row
from kinedex.ops.depth.graph import PointGraph
from kinedex.ops.depth.points import FrameCloud
from kinedex.ops.errors import ParameterError

SOURCE_DROP_M = 0.2
"""Distance in metres by which the mean of the points is lowered; the source is the node nearest to the lowered mean."""

COUNT = 20
"""The number of extrema (thesis, Section 8.4.4)."""

TIP_M = 0.15
"""Radius in metres; an extremum is the tip of a limb if no node within this radius is farther from the source.
"""

BUCKET_M, BUCKETS = 0.01, 128
"""Width of a bucket of distances, and the number of buckets, a power of two; their product exceeds the longest edge."""


class Extrema(NamedTuple):
    """The geodesic extrema of a frame; fewer than requested where the body has fewer nodes.

    Attributes
    ----------
    nodes : int32 array (m,)
        The nodes.
    distances : float64 array (m,)
        The distance of each extremum to the source and all earlier extrema, along the edges, in metres.
    visited : int32 array (m,)
        The number of nodes that were visited to find each extremum.
    """

    nodes: I32
    distances: F64
    visited: I32


class ExtremaBuffers(NamedTuple):
    """Preallocated arrays of the search, for graphs of at most N nodes.

    Attributes
    ----------
    distances : float64 array (N,)
        The distance of each node.
    firsts : int32 array (BUCKETS,)
        The first node of each bucket; −1 for an empty one.
    after, before : int32 array (N,)
        The next and the previous node of each node in its bucket; −1 if there is none.
    buckets : int32 array (N,)
        The bucket of each node; −1 for nodes in no bucket.
    changed : int32 array (N,)
        The last search in which the distance of each node decreased.
    from_source : float64 array (N,)
        The distance of each node to the source alone.
    """

    distances: F64
    firsts: I32
    after: I32
    before: I32
    buckets: I32
    changed: I32
    from_source: F64


def extrema_buffers(nodes: int) -> ExtremaBuffers:
    """Allocate the arrays for graphs of at most the given number of nodes."""
    return ExtremaBuffers(
        np.zeros(nodes),
        np.zeros(BUCKETS, np.int32),
        np.zeros(nodes, np.int32),
        np.zeros(nodes, np.int32),
        np.zeros(nodes, np.int32),
        np.zeros(nodes, np.int32),
        np.zeros(nodes),
    )


def find_source(cloud: FrameCloud, graph: PointGraph, drop: float = SOURCE_DROP_M) -> int:
    """Return the node of the body that is nearest to the lowered mean of all points.

    Parameters
    ----------
    cloud : FrameCloud
        The points.
    graph : PointGraph
        The graph of the points.
    drop : float
        The distance in metres by which the mean is lowered along Y; 0 for the form printed in the thesis.

    Returns
    -------
    int
        The node, the one of lowest index in a tie; −1 without a body.
    """
    return int(_nearest_to_mean(cloud.points, graph.body, drop))


def geodesic_extrema(
    graph: PointGraph, source: int, count: int = COUNT, buffers: ExtremaBuffers | None = None
) -> Extrema:
    """Return the geodesic extrema of a graph.

    Parameters
    ----------
    graph : PointGraph
        The graph.
    source : int
        The node that the search begins at.
    count : int
        The number of extrema.
    buffers : ExtremaBuffers, optional
        Arrays to reuse from earlier frames; None allocates them.

    Returns
    -------
    Extrema
        The extrema, all of them connected to the source; in a tie of distances, the node of lowest index is chosen.

    Raises
    ------
    ParameterError
        The source is not a node.
    """
    size = len(graph.body)
    if not 0 <= source < size:
        raise ParameterError("source", f"a node from 0 to {size - 1}", source)
    if buffers is None:
        buffers = extrema_buffers(size)
    nodes, distances, visited = np.empty(count, np.int32), np.empty(count), np.empty(count, np.int32)
    found = _find_extrema(graph.starts, graph.neighbours, graph.lengths, source, buffers, nodes, distances, visited)
    return Extrema(nodes[:found], distances[:found], visited[:found])


def tips_first(cloud: FrameCloud, graph: PointGraph, extrema: Extrema, buffers: ExtremaBuffers) -> Extrema:
    """Reorder extrema so that the tips of limbs come first, and keep the order among tips and among the others.

    An extremum is a tip if no point that is connected to it within `TIP_M` is farther from the source. If a hand hangs
    beside the hip, a knee or a shoulder may be among the first five extrema, but these are rarely tips.

    Parameters
    ----------
    cloud : FrameCloud
        The points.
    graph : PointGraph
        The graph of the points.
    extrema : Extrema
        The extrema of the graph.
    buffers : ExtremaBuffers
        The arrays of the search that found the extrema; no other search may have used them since.

    Returns
    -------
    Extrema
        The same extrema in the new order.
    """
    tips = np.zeros(len(extrema.nodes), np.bool_)
    _find_tips(cloud.points, graph.starts, graph.neighbours, extrema.nodes, buffers, tips)
    order = np.argsort(~tips, kind="stable")
    return Extrema(extrema.nodes[order], extrema.distances[order], extrema.visited[order])


@njit(cache=True, nogil=True)
def _find_tips(points: F64, starts: I32, neighbours: I32, nodes: I32, buffers: ExtremaBuffers, tips: Bool) -> None:
    """Search around each extremum within the radius, until a node is found that is farther from the source."""
    distances, queue, seen = buffers.from_source, buffers.after, buffers.changed
    seen[: len(points)] = -1
    for m in range(len(nodes)):
        node = nodes[m]
        x, y, z = points[node, 0], points[node, 1], points[node, 2]
        queue[0], seen[node] = node, m
        done, size, tips[m] = 0, 1, True
        while done < size and tips[m]:
            here = queue[done]
            done += 1
            for k in range(starts[here], starts[here + 1]):
                other = neighbours[k]
                dx, dy, dz = points[other, 0] - x, points[other, 1] - y, points[other, 2] - z
                if seen[other] == m or dx * dx + dy * dy + dz * dz >= TIP_M * TIP_M:
                    continue
                if distances[other] > distances[node]:
                    tips[m] = False
                    break
                seen[other], queue[size] = m, other
                size += 1


@njit(cache=True, nogil=True)
def _nearest_to_mean(points: F64, body: Bool, drop: float) -> int:
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
    starts: I32,
    neighbours: I32,
    lengths: F64,
    source: int,
    buffers: ExtremaBuffers,
    nodes: I32,
    distances: F64,
    visited: I32,
) -> int:
    """Fill in the extrema, and return their number."""
    reached = buffers.distances[: len(starts) - 1]
    reached[:] = np.inf
    buffers.changed[: len(reached)] = -1
    buffers.buckets[: len(reached)] = -1
    buffers.firsts[:] = -1
    for k in range(len(nodes)):
        visited[k] = _spread(starts, neighbours, lengths, source if k == 0 else nodes[k - 1], k, buffers)
        if k == 0:
            copy_row(buffers.from_source, reached)
        farthest = _greatest_finite(reached)
        if farthest == 0.0:
            return k
        node = 0
        while reached[node] != farthest:
            node += 1
        nodes[k], distances[k] = node, farthest
    return len(nodes)


@njit(cache=True, nogil=True, fastmath={"nnan", "nsz", "reassoc"})
def _greatest_finite(values: F64) -> float:
    """Return the greatest value that is not infinite; 0 if there is none."""
    greatest = 0.0
    for i in range(len(values)):
        value = values[i] if values[i] < np.inf else 0.0
        greatest = value if value > greatest else greatest
    return greatest


@njit(cache=True, nogil=True)
def _spread(starts: I32, neighbours: I32, lengths: F64, source: int, search: int, buffers: ExtremaBuffers) -> int:
    """Update the distances for an additional source, and return the number of nodes whose distance became less.

    Nodes wait in a ring of buckets of distances, each node in at most one bucket. If the distance of a node decreases
    while its bucket is being emptied, the node is put into it again, so that the result does not depend on the width of
    a bucket. If no edge is shorter than a bucket's width, each node is visited once.
    """
    reached, firsts, after, before, buckets = (
        buffers.distances,
        buffers.firsts,
        buffers.after,
        buffers.before,
        buffers.buckets,
    )
    scale, nearer, waiting, slot = 1.0 / BUCKET_M, 1, 1, 0
    reached[source], buffers.changed[source] = 0.0, search
    firsts[0], after[source], before[source], buckets[source] = source, -1, -1, 0
    while waiting > 0:
        node = firsts[slot]
        if node < 0:
            slot = (slot + 1) & (BUCKETS - 1)
            continue
        firsts[slot] = after[node]
        if after[node] >= 0:
            before[after[node]] = -1
        buckets[node] = -1
        waiting -= 1
        here = reached[node]
        for k in range(starts[node], starts[node + 1]):
            other, length = neighbours[k], here + lengths[k]
            if length >= reached[other]:
                continue
            reached[other] = length
            if buffers.changed[other] != search:
                buffers.changed[other] = search
                nearer += 1
            place, former = int(length * scale) & (BUCKETS - 1), buckets[other]
            if place == former:
                continue
            if former >= 0:  # remove it from its former bucket
                if before[other] >= 0:
                    after[before[other]] = after[other]
                else:
                    firsts[former] = after[other]
                if after[other] >= 0:
                    before[after[other]] = before[other]
                waiting -= 1
            first = firsts[place]
            after[other], before[other], buckets[other], firsts[place] = first, -1, place, other
            if first >= 0:
                before[first] = other
            waiting += 1
    return nearer
