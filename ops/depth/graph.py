"""This module builds the graph of a frame's points: edges, components, and links (thesis, Section 8.4.2).

Two points are joined by an edge if their pixels are adjacent (8-neighbours) and their distance is below a threshold.
Small connected components are dropped as noise. The largest component is the body. The others are linked to the body
one by one, the nearest first, by an edge between the closest pair of points. If a frame shows several people, the
components separate them, so that one person can be tracked.

To find the closest pairs, the nodes of a component are gathered in blocks, tiles of 8 × 8 pixels with a bounding box in
space. The computed distance to a box is never above the computed distance to a point in it, even with rounding errors.
Therefore blocks farther away than the closest pair so far can be skipped, and the result is exact.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from kinedex.ops.arrays import F32, F64, I32, I64, Bool
from kinedex.ops.copies import copy_row
from kinedex.ops.depth.points import FrameCloud

MAX_LINK_M = 0.5
"""Largest distance in metres from the body at which a component still belongs to the body."""

TILE_BITS = 3
"""Base-2 logarithm of a block's width and height in pixels."""

MAX_TILES = 1 << 14 >> TILE_BITS
"""Maximum number of tiles in a row: images have fewer than 2¹⁴ columns."""


EDGE_M = 0.06
"""Distance in metres below which neighbouring points are joined by an edge."""

FINE_EDGE_M, EDGE_PER_STEP = 0.043, 0.7
"""The edge threshold without a depth step, in metres, and its increase per metre of depth step, up to `EDGE_M`."""

STEP_SHARE, STEP_BIN_M, STEP_BINS = 0.2, 0.001, 64
"""The quantile of depth differences that is a frame's depth step, and the width and number of its histogram bins."""

MIN_NODES = 12
"""Minimum number of nodes of a component that is kept."""

FORWARD = 4
"""Number of a pixel's neighbours that come after it in row-major order: the right one and the three below."""

PERSON_POINTS, APART_M = 500, 0.3
"""Two components with more points than the first, and farther apart in metres than the second, are two people."""

_SAMPLE = 400  # points of a component, up to twice as many, between which distances are measured


class LinkBuffers(NamedTuple):
    """Preallocated arrays for finding links, for at most N points and K components.

    Attributes
    ----------
    order, keys, counts : int32 array (N,), (2, N), at least (N + 1,)
        The nodes sorted by component and tile; the tile of each node and a preliminary order; counts of the sort.
    blocks, firsts : int32 array (N + 1,), (K + 1,)
        The offset of each block in the order, and the index of the first block of each component.
    boxes : float64 array (N, 2, 3)
        The minimum and maximum coordinates of each block.
    squares : float64 array (K,)
        The squared distance of each component to the body, that is, to the components linked so far.
    closest : int32 array (K, 2)
        For each component the closest pair of nodes, of which the first belongs to the body.
    joined : bool array (K,)
        True for components that are linked to the body.
    pairs, spans : int32 array (K, 2), float64 array (K,)
        The links: both nodes, and the distance in metres.
    """

    order: I32
    keys: I32
    counts: I32
    blocks: I32
    firsts: I32
    boxes: F64
    squares: F64
    closest: I32
    joined: Bool
    pairs: I32
    spans: F64


def link_buffers(most: int, components: int) -> LinkBuffers:
    """Allocate the arrays for frames with at most the given numbers of points and components."""
    return LinkBuffers(
        np.zeros(most, np.int32),
        np.zeros((2, most), np.int32),
        np.zeros(max(most, MAX_TILES) + 1, np.int32),
        np.zeros(most + 1, np.int32),
        np.zeros(components + 1, np.int32),
        np.zeros((most, 2, 3)),
        np.zeros(components),
        np.zeros((components, 2), np.int32),
        np.zeros(components, np.bool_),
        np.zeros((components, 2), np.int32),
        np.zeros(components),
    )


@njit(cache=True, nogil=True)
def link_components(
    points: F64, pixels: I32, labels: I32, sizes: I32, components: int, body: Bool, buffers: LinkBuffers
) -> int:
    """Link components to the largest one, the nearest first, and return the number of links.

    Parameters
    ----------
    points : float64 array (n, 3)
        Positions in metres.
    pixels : int32 array (n, 2)
        Column and row of each point.
    labels : int32 array (N,)
        The component of each point; −1 for none.
    sizes : int32 array (N,)
        The number of points of each component.
    components : int
        The number of components.
    body : bool array (N,)
        Output: True for points of the body.
    buffers : LinkBuffers
        Output: the links in `pairs` and `spans`.

    Returns
    -------
    int
        The number of links.
    """
    n, links = len(points), 0
    if components == 0:
        body[:n] = False
        return 0
    joined, squares = buffers.joined, buffers.squares
    joined[:components] = False
    newest = 0
    for c in range(components):
        newest = c if sizes[c] > sizes[newest] else newest
        squares[c] = MAX_LINK_M * MAX_LINK_M
        buffers.closest[c, 0] = -1
    joined[newest] = True
    if components > 1:
        _gather_blocks(points, pixels, labels, components, buffers)
    while components > 1:
        nearest = -1
        for c in range(components):
            if not joined[c]:
                _update_closest(points, np.int64(newest), c, buffers)
                if buffers.closest[c, 0] >= 0 and (nearest < 0 or squares[c] < squares[nearest]):
                    nearest = c
        if nearest < 0:
            break
        copy_row(buffers.pairs[links], buffers.closest[nearest])
        buffers.spans[links] = np.sqrt(squares[nearest])
        joined[nearest] = True
        newest = nearest
        links += 1
    for i in range(n):
        body[i] = labels[i] >= 0 and joined[labels[i]]
    return links


@njit(cache=True, nogil=True)
def _gather_blocks(points: F64, pixels: I32, labels: I32, components: int, buffers: LinkBuffers) -> None:
    """Sort the nodes by component and tile, and compute the bounding boxes of their blocks."""
    order, blocks, firsts, boxes = buffers.order, buffers.blocks, buffers.firsts, buffers.boxes
    kept = _sort_nodes(pixels, labels, components, buffers)
    count, component, tile = 0, -1, -1
    for k in range(kept):
        i = order[k]
        if labels[i] != component or buffers.keys[0, i] != tile:
            if labels[i] != component:
                firsts[labels[i]] = count
            component, tile = labels[i], buffers.keys[0, i]
            blocks[count] = k
            copy_row(boxes[count, 0], points[i])
            copy_row(boxes[count, 1], points[i])
            count += 1
        for axis in range(3):
            boxes[count - 1, 0, axis] = min(boxes[count - 1, 0, axis], points[i, axis])
            boxes[count - 1, 1, axis] = max(boxes[count - 1, 1, axis], points[i, axis])
    blocks[count], firsts[components] = kept, count


@njit(cache=True, nogil=True)
def _sort_nodes(pixels: I32, labels: I32, components: int, buffers: LinkBuffers) -> int:
    """Sort the nodes by component, column of tiles and row of tiles, and return their number."""
    n = len(pixels)
    order, (tiles, passing), counts = buffers.order, buffers.keys, buffers.counts
    left, right, top = pixels[0, 0], pixels[0, 0], pixels[0, 1]
    for i in range(n):
        left, right = min(left, pixels[i, 0]), max(right, pixels[i, 0])
    columns = ((right - left) >> TILE_BITS) + 1
    counts[: columns + 1] = 0
    for i in range(n):
        counts[((pixels[i, 0] - left) >> TILE_BITS) + 1] += 1
    for column in range(columns):
        counts[column + 1] += counts[column]
    for i in range(n):  # rows ascend with the nodes, so a stable sort by column leaves rows of tiles together
        column = (pixels[i, 0] - left) >> TILE_BITS
        tiles[i] = ((pixels[i, 1] - top) >> TILE_BITS) * columns + column
        passing[counts[column]] = i
        counts[column] += 1
    counts[: components + 1] = 0
    for i in range(n):
        if labels[i] >= 0:
            counts[labels[i] + 1] += 1
    for c in range(components):
        counts[c + 1] += counts[c]
    kept = counts[components]
    for k in range(n):
        i = passing[k]
        if labels[i] >= 0:
            order[counts[labels[i]]] = i
            counts[labels[i]] += 1
    return kept


@njit(cache=True, nogil=True)
def _update_closest(points: F64, grown: int, component: int, buffers: LinkBuffers) -> None:
    """Update the closest pairs after a component joined the body; ties go to the lowest nodes, the body's first."""
    boxes, firsts = buffers.boxes, buffers.firsts
    for skip_far in (True, False):  # the nearest pair of blocks first: its distance excludes most other blocks
        near, near_a, near_b = np.inf, -1, -1
        for a in range(firsts[grown], firsts[grown + 1]):
            for b in range(firsts[component], firsts[component + 1]):
                bound = _box_square(boxes[a], boxes[b])
                if skip_far and bound < near:
                    near, near_a, near_b = bound, a, b
                elif not skip_far and bound <= buffers.squares[component]:
                    _compare_blocks(points, np.int64(a), np.int64(b), component, buffers)
        if skip_far and near <= buffers.squares[component]:
            _compare_blocks(points, np.int64(near_a), np.int64(near_b), component, buffers)


@njit(cache=True, nogil=True)
def _compare_blocks(points: F64, a: int, b: int, component: int, buffers: LinkBuffers) -> None:
    order, blocks, closest, squares = buffers.order, buffers.blocks, buffers.closest, buffers.squares
    low, high = buffers.boxes[b, 0], buffers.boxes[b, 1]
    for k in range(blocks[a], blocks[a + 1]):
        i = order[k]
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        dx, dy, dz = (
            max(low[0] - x, x - high[0], 0.0),
            max(low[1] - y, y - high[1], 0.0),
            max(low[2] - z, z - high[2], 0.0),
        )
        if dx * dx + dy * dy + dz * dz > squares[component]:
            continue
        for m in range(blocks[b], blocks[b + 1]):
            j = order[m]
            dx, dy, dz = points[j, 0] - x, points[j, 1] - y, points[j, 2] - z
            square = dx * dx + dy * dy + dz * dz
            if square < squares[component] or (
                square == squares[component]
                and closest[component, 0] >= 0
                and (i < closest[component, 0] or (i == closest[component, 0] and j < closest[component, 1]))
            ):
                squares[component] = square
                closest[component, 0], closest[component, 1] = i, j


@njit(cache=True, nogil=True)
def _box_square(one: F64, other: F64) -> float:
    """Return the squared distance between two boxes."""
    total = 0.0
    for axis in range(3):
        gap = max(one[0, axis] - other[1, axis], other[0, axis] - one[1, axis], 0.0)
        total += gap * gap
    return total


class PointGraph(NamedTuple):
    """The graph of a frame's points; its arrays are overwritten by the next graph that uses the same `GraphBuffers`.

    Attributes
    ----------
    starts : int32 array (n + 1,)
        The edges of node i are starts[i] to starts[i + 1] − 1 in the next two arrays.
    neighbours : int32 array (m,)
        The other node of each edge; every edge is stored for both of its nodes.
    lengths : float64 array (m,)
        The lengths of the edges in metres.
    body : bool array (n,)
        True for nodes of the body: those of the largest component, and of components that are linked to it.
    labels : int32 array (n,)
        The component of each node; −1 for a component that was dropped. Components are numbered by their lowest node.
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


class GraphBuffers(NamedTuple):
    """Preallocated arrays for graphs of frames with at most N points.

    Attributes
    ----------
    starts, cursors, parents, labels : int32 array (N + 1,)
        The first edge of each node, the next free place for an edge, the parents of union-find, and the components.
    ahead, spans : int32 array (N, 4), float64 array (N, 4)
        The edges of each node to nodes of higher index: the other node, and the length.
    neighbours, lengths : int32 array (8N + 2 · most links,), float64 array of the same length
        The edges.
    sizes : int32 array (N,)
        The number of nodes of each component.
    body : bool array (N,)
        True for nodes of the body.
    links : LinkBuffers
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
    links: LinkBuffers


def graph_buffers(most: int) -> GraphBuffers:
    """Allocate the arrays for graphs of frames with at most the given number of points."""
    components = most // MIN_NODES + 1
    edges = 2 * FORWARD * most + 2 * components
    return GraphBuffers(
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
        link_buffers(most, components),
    )


def edge_threshold(cloud: FrameCloud) -> float:
    """Return the distance below which neighbouring points of a frame are joined, from its depth step.

    A hand beside the hip is about 5 cm in front of it. If the sensor resolves this distance, a lower threshold keeps
    the hand and the hip apart. Structured-light sensors have depth steps of 2.6 cm at 3 m, and two such steps must not
    separate parts of a limb.

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


def build_graph(cloud: FrameCloud, threshold: float = EDGE_M, buffers: GraphBuffers | None = None) -> PointGraph:
    """Return the graph of a frame's points.

    Parameters
    ----------
    cloud : FrameCloud
        The points.
    threshold : float
        Neighbouring points closer than this are joined, in metres.
    buffers : GraphBuffers, optional
        Arrays to reuse from earlier frames; None allocates them.

    Returns
    -------
    PointGraph
        The graph, stored in arrays of `buffers`.
    """
    n = len(cloud.points)
    if buffers is None:
        buffers = graph_buffers(n)
    _join_neighbours(
        cloud.points, cloud.pixels, cloud.numbers, threshold, buffers.ahead, buffers.spans, buffers.parents
    )
    components = _label_components(n, buffers.parents, buffers.labels, buffers.sizes)
    links = link_components(
        cloud.points, cloud.pixels, buffers.labels, buffers.sizes, components, buffers.body, buffers.links
    )
    _pack_edges(n, links, buffers)
    edges = int(buffers.starts[n])
    return PointGraph(
        buffers.starts[: n + 1],
        buffers.neighbours[:edges],
        buffers.lengths[:edges],
        buffers.body[:n],
        buffers.labels[:n],
        components,
        links,
    )


@njit(cache=True, nogil=True)
def _depth_step(pixels: I32, depth: F32, counts: I64) -> float:
    """Return the `STEP_SHARE` quantile of depth steps between horizontal neighbours, in metres; 0 if there are none."""
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
    """Find the edges of each node to nodes of higher index, and unite the components of both."""
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
    """Number all large enough components from 0, in the order of their lowest nodes; return how many there are."""
    sizes[:n] = 0
    for i in range(n):
        parents[i] = parents[parents[i]]  # a parent is a lower node, so it already points to its root
        sizes[parents[i]] += 1
    count = 0
    for i in range(n):
        if parents[i] != i:
            labels[i] = labels[parents[i]]
        elif sizes[i] < MIN_NODES:
            labels[i] = -1
        else:
            # a component's number is at most its lowest node, so sizes can be overwritten in place
            sizes[count], labels[i] = sizes[i], count
            count += 1
    return count


@njit(cache=True, nogil=True)
def _pack_edges(n: int, links: int, buffers: GraphBuffers) -> None:
    """Write the edges sorted by node; the neighbours of a node ascend, and its links come last."""
    ahead, starts, cursors, pairs = buffers.ahead, buffers.starts, buffers.cursors, buffers.links.pairs[:links]
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
                _write_edge(i, j, buffers.spans[i, k], buffers)
    for k in range(len(pairs)):
        _write_edge(pairs[k, 0], pairs[k, 1], buffers.links.spans[k], buffers)


@njit(cache=True, nogil=True)
def _write_edge(one: int, other: int, span: float, buffers: GraphBuffers) -> None:
    cursors, neighbours, lengths = buffers.cursors, buffers.neighbours, buffers.lengths
    neighbours[cursors[one]], lengths[cursors[one]] = other, span
    neighbours[cursors[other]], lengths[cursors[other]] = one, span
    cursors[one] += 1
    cursors[other] += 1


def split_people(cloud: FrameCloud, graph: PointGraph) -> list[I64]:
    """Return the points of each person in a frame, ordered by their lowest index; empty for fewer than two people.

    Parameters
    ----------
    cloud : FrameCloud
        The points.
    graph : PointGraph
        The graph of the points.

    Returns
    -------
    list of int64 array
        Ascending indices of the points of each person. Points of small components are assigned to the nearest person;
        points of dropped components belong to nobody.
    """
    sizes = np.bincount(graph.labels[graph.labels >= 0], minlength=graph.components)
    large = np.flatnonzero(sizes > PERSON_POINTS)
    if len(large) < 2:
        return []
    members = {label: np.flatnonzero(graph.labels == label) for label in range(graph.components)}
    people = _united(cloud.points, [members[label] for label in large.tolist()])
    if len(people) < 2:
        return []
    samples = [_sampled(cloud.points, own) for own in people]
    for label in np.setdiff1d(np.arange(graph.components), large).tolist():
        some = _sampled(cloud.points, members[label])
        nearest = int(np.argmin([_apart(some, sample) for sample in samples]))
        people[nearest] = np.concatenate([people[nearest], members[label]])
    return [np.sort(own) for own in people]


def nearest_person(cloud: FrameCloud, people: list[I64], pose: F64 | None) -> int:
    """Return the index of the person nearest to a pose (24, 3), or to the image centre if there is no pose."""
    if pose is not None:
        middle = pose.mean(axis=0)
        return int(np.argmin([np.linalg.norm(cloud.points[own].mean(axis=0) - middle) for own in people]))
    height, width = cloud.numbers.shape
    centre = np.array([(width - 1) / 2, (height - 1) / 2])
    return int(np.argmin([np.linalg.norm(cloud.pixels[own].mean(axis=0) - centre) for own in people]))


def restrict_cloud(cloud: FrameCloud, rows: I64) -> FrameCloud:
    """Return a copy of a frame that is restricted to the given points.

    Parameters
    ----------
    cloud : FrameCloud
        The points.
    rows : int64 array (n,)
        Ascending indices of the points to keep, at least one.
    """
    pixels = cloud.pixels[rows]
    numbers, depth = np.full_like(cloud.numbers, -1), np.zeros_like(cloud.depth)
    at = (pixels[:, 1], pixels[:, 0])
    numbers[at] = np.arange(len(rows), dtype=np.int32)
    depth[at] = cloud.depth[at]
    (u0, v0), (u1, v1) = pixels.min(axis=0).tolist(), (pixels.max(axis=0) + 1).tolist()
    return cloud._replace(points=cloud.points[rows], pixels=pixels, numbers=numbers, depth=depth, box=(u0, v0, u1, v1))


def _united(points: F64, components: list[I64]) -> list[I64]:
    """Merge components, given by the indices of their points, whose distance is at most `APART_M`."""
    people: list[I64] = []
    for own in components:
        sample = _sampled(points, own)
        near = [k for k, other in enumerate(people) if _apart(sample, _sampled(points, other)) <= APART_M]
        joined = np.concatenate([own, *(people[k] for k in near)])
        people = [joined if near and k == near[0] else other for k, other in enumerate(people) if k not in near[1:]]
        if not near:
            people.append(joined)
    return people


def _sampled(points: F64, rows: I64) -> F64:
    return points[rows[:: max(1, len(rows) // _SAMPLE)]]


def _apart(one: F64, other: F64) -> float:
    """Return the smallest distance between two samples of points, in metres."""
    squares = ((one[:, None] - other[None]) ** 2).sum(axis=2)
    return float(np.sqrt(squares.min()))
