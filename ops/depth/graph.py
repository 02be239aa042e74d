"""This module builds the graph of a frame's points: edges, components, and links (thesis, Section 8.4.2).

Two points are joined if their pixels are adjacent (8-neighbours) and they lie closer than a threshold. Small components
are noise. The largest one is the body; the others join it one by one, always the nearest next, by an edge between the
closest pair of points.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from kinedex.ops.arrays import F32, F64, I32, I64, Bool
from kinedex.ops.depth.component_links import LinkRoom, link_components, link_room
from kinedex.ops.depth.points import FrameCloud

EDGE_M = 0.06
"""Distance in metres below which neighbouring points are joined by an edge."""

FINE_EDGE_M, EDGE_PER_STEP = 0.043, 0.7
"""The threshold for a sensor of fine depth steps, and its growth per metre of a frame's depth step, up to `EDGE_M`."""

STEP_SHARE, STEP_BIN_M, STEP_BINS = 0.2, 0.001, 64
"""The quantile of depth differences that is a frame's depth step, and the width and number of its histogram bins."""

LEAST_NODES = 12
"""Minimum number of nodes of a component that is kept."""

FORWARD = 4
"""Number of neighbours of a pixel that follow it row by row: right, and three below."""


class PointGraph(NamedTuple):
    """The graph of a frame's points; its arrays are overwritten by the next graph that uses the same `GraphRoom`.

    Attributes
    ----------
    starts : int32 array (n + 1,)
        Where the edges of each node begin in the two arrays that follow.
    neighbours : int32 array (m,)
        The other node of each edge; every edge is stored for both of its nodes.
    lengths : float64 array (m,)
        The lengths of the edges in metres.
    body : bool array (n,)
        True for nodes of the body: its largest component, and those that links join to it.
    labels : int32 array (n,)
        The component of each node, numbered by the lowest node; −1 for components that were dropped.
    components : int
        The number of components that were not dropped.
    links : int
        The number of edges that join components.
    """

    starts: I32
    neighbours: I32
    lengths: F64
    body: Bool
    labels: I32
    components: int
    links: int


class GraphRoom(NamedTuple):
    """Preallocated arrays for graphs of frames with at most N points.

    Attributes
    ----------
    starts, cursors, parents, labels : int32 array (N + 1,)
        The beginnings of edges, the next free place of each node, the parents of union-find, and the components.
    ahead, spans : int32 array (N, 4), float64 array (N, 4)
        The edges of each node with nodes after it.
    neighbours, lengths : int32 array (8N + 2 · most links,), float64 array of the same length
        The edges.
    sizes : int32 array (N,)
        The number of nodes of each component.
    body : bool array (N,)
        True for nodes of the body.
    links : LinkRoom
        The arrays of links.
    """

    starts: I32
    cursors: I32
    parents: I32
    labels: I32
    ahead: I32
    spans: F64
    neighbours: I32
    lengths: F64
    sizes: I32
    body: Bool
    links: LinkRoom


def graph_room(most: int) -> GraphRoom:
    """Allocate the arrays for graphs of frames with at most the given number of points."""
    components = most // LEAST_NODES + 1
    edges = 2 * FORWARD * most + 2 * components
    return GraphRoom(
        np.zeros(most + 1, np.int32),
        np.zeros(most + 1, np.int32),
        np.zeros(most + 1, np.int32),
        np.zeros(most + 1, np.int32),
        np.zeros((most, FORWARD), np.int32),
        np.zeros((most, FORWARD)),
        np.zeros(edges, np.int32),
        np.zeros(edges),
        np.zeros(most, np.int32),
        np.zeros(most, np.bool_),
        link_room(most, components),
    )


def edge_threshold(cloud: FrameCloud) -> float:
    """Return the distance below which neighbouring points of a frame are joined, from its depth step.

    A hand at the hip is about 5 cm in front of it. Where the sensor resolves this, a lower threshold keeps both apart;
    structured-light sensors have depth steps of 2.6 cm at 3 m, two of which must not cut a limb.

    Parameters
    ----------
    cloud : FrameCloud
        The points.

    Returns
    -------
    float
        0.043 m + 0.7 × the 20th percentile of depth differences of horizontal neighbours, zeros excluded; at most
        `EDGE_M`.
    """
    step = _depth_step(cloud.pixels, cloud.depth, np.zeros(STEP_BINS + 1, np.int64))
    return min(EDGE_M, FINE_EDGE_M + EDGE_PER_STEP * float(step))


def build_graph(cloud: FrameCloud, threshold: float = EDGE_M, room: GraphRoom | None = None) -> PointGraph:
    """Return the graph of a frame's points.

    Parameters
    ----------
    cloud : FrameCloud
        The points.
    threshold : float
        Neighbouring points closer than this are joined, in metres.
    room : GraphRoom, optional
        Arrays to reuse from earlier frames; None allocates them.

    Returns
    -------
    PointGraph
        The graph, stored in arrays of `room`.
    """
    n = len(cloud.points)
    if room is None:
        room = graph_room(n)
    _join_neighbours(cloud.points, cloud.pixels, cloud.numbers, threshold, room.ahead, room.spans, room.parents)
    components = _label_components(n, room.parents, room.labels, room.sizes)
    links = link_components(cloud.points, cloud.pixels, room.labels, room.sizes, components, room.body, room.links)
    pairs, spans = room.links.pairs, room.links.spans
    _pack_edges(
        n, room.ahead, room.spans, pairs[:links], spans, room.starts, room.cursors, room.neighbours, room.lengths
    )
    edges = int(room.starts[n])
    return PointGraph(
        room.starts[: n + 1],
        room.neighbours[:edges],
        room.lengths[:edges],
        room.body[:n],
        room.labels[:n],
        components,
        links,
    )


@njit(cache=True, nogil=True)
def _depth_step(pixels: I32, depth: F32, counts: I64) -> float:
    """Return the `STEP_SHARE` quantile of depth differences of horizontal neighbours, in metres; 0 without any."""
    total = 0
    for i in range(len(pixels) - 1):
        u, v = pixels[i, 0], pixels[i, 1]
        if pixels[i + 1, 1] == v and pixels[i + 1, 0] == u + 1:
            apart = int(abs(np.float64(depth[v, u + 1]) - np.float64(depth[v, u])) / STEP_BIN_M + 0.5)
            if apart > 0:
                counts[min(apart, STEP_BINS)] += 1
                total += 1
    below, apart = 0, 0
    while total > 0 and below <= int(STEP_SHARE * total):
        apart += 1
        below += counts[apart]
    return apart * STEP_BIN_M


@njit(cache=True, nogil=True)
def _root(parents: I32, node: int) -> int:
    """Return the root of a node in union-find, the lowest node of its component, and compress the path to it."""
    while parents[node] != node:
        parents[node] = parents[parents[node]]
        node = parents[node]
    return node


@njit(cache=True, nogil=True)
def _join_neighbours(
    points: F64, pixels: I32, numbers: I32, threshold: float, ahead: I32, spans: F64, parents: I32
) -> None:
    """Find the edges of each node with nodes after it, and unite their components."""
    height, width = numbers.shape
    most = threshold * threshold * (1.0 + 1e-12)  # with slack, as the exact comparison is made on the distance itself
    for i in range(len(points)):
        parents[i] = i
    for i in range(len(points)):
        u, v = pixels[i, 0], pixels[i, 1]
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        for k in range(FORWARD):
            ahead[i, k] = -1
            column, row = (u + 1, v) if k == 0 else (u + k - 2, v + 1)
            if column < 0 or column >= width or row >= height:
                continue
            j = numbers[row, column]
            if j < 0:
                continue
            dx, dy, dz = points[j, 0] - x, points[j, 1] - y, points[j, 2] - z
            square = dx * dx + dy * dy + dz * dz
            if square > most:
                continue
            span = np.sqrt(square)
            if span < threshold:
                ahead[i, k], spans[i, k] = j, span
                one, other = _root(parents, i), _root(parents, j)
                if one != other:
                    parents[max(one, other)] = min(one, other)


@njit(cache=True, nogil=True)
def _label_components(n: int, parents: I32, labels: I32, sizes: I32) -> int:
    """Number the components that are large enough by their lowest nodes, and return their number."""
    sizes[:n] = 0
    for i in range(n):
        parents[i] = parents[parents[i]]  # a parent is a lower node, so it already points to its root
        sizes[parents[i]] += 1
    count = 0
    for i in range(n):
        if parents[i] != i:
            labels[i] = labels[parents[i]]
        elif sizes[i] < LEAST_NODES:
            labels[i] = -1
        else:
            # a component's number is at most its lowest node, so sizes can be overwritten in place
            sizes[count], labels[i] = sizes[i], count
            count += 1
    return count


@njit(cache=True, nogil=True)
def _pack_edges(
    n: int, ahead: I32, spans: F64, pairs: I32, pair_spans: F64, starts: I32, cursors: I32, neighbours: I32,
    lengths: F64,
) -> None:  # fmt: skip
    """Write the edges of all nodes one node after the other, each node's neighbours ascending and its links last."""
    cursors[: n + 1] = 0
    for i in range(n):
        for k in range(FORWARD):
            if ahead[i, k] >= 0:
                cursors[i] += 1
                cursors[ahead[i, k]] += 1
    for one, other in pairs:
        cursors[one] += 1
        cursors[other] += 1
    total = np.int32(0)
    for i in range(n):
        starts[i] = total
        total += cursors[i]
        cursors[i] = starts[i]
    starts[n] = total
    for i in range(n):
        for k in range(FORWARD):
            j = ahead[i, k]
            if j >= 0:
                _write_edge(i, j, spans[i, k], cursors, neighbours, lengths)
    for k in range(len(pairs)):
        _write_edge(pairs[k, 0], pairs[k, 1], pair_spans[k], cursors, neighbours, lengths)


@njit(cache=True, nogil=True)
def _write_edge(one: int, other: int, span: float, cursors: I32, neighbours: I32, lengths: F64) -> None:
    neighbours[cursors[one]], lengths[cursors[one]] = other, span
    neighbours[cursors[other]], lengths[cursors[other]] = one, span
    cursors[one] += 1
    cursors[other] += 1
