"""This module links the components of a frame's point graph by edges between the closest pairs of points.

The nodes of a component are gathered in blocks: tiles of 8 × 8 pixels, with the box in space that holds their points.
The computed distance to a box is never above the computed distance to a point in it, even with rounding errors. So
blocks farther than the closest pair so far are skipped, and the result is exact.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64, I32, Bool
from kinedex.ops.copies import copy_row

MOST_LINK_M = 0.5
"""Greatest distance in metres from the body at which a component still belongs to it."""

TILE_BITS = 3
"""Base-2 logarithm of a block's width and height in pixels."""

MOST_TILES = 1 << 14 >> TILE_BITS
"""Maximum number of tiles in a row: images have fewer than 2¹⁴ columns."""


class LinkRoom(NamedTuple):
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
        The squared distance of each component to the components linked so far (the body).
    closest : int32 array (K, 2)
        For each component the closest pair of nodes: one of the body, one of the component.
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


def link_room(most: int, components: int) -> LinkRoom:
    """Allocate the arrays for frames with at most the given numbers of points and components."""
    return LinkRoom(
        np.zeros(most, np.int32),
        np.zeros((2, most), np.int32),
        np.zeros(max(most, MOST_TILES) + 1, np.int32),
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
    points: F64, pixels: I32, labels: I32, sizes: I32, components: int, body: Bool, room: LinkRoom
) -> int:
    """Link components to the largest one, the nearest first, and return the number of links.

    Parameters
    ----------
    points : float64 array (n, 3)
        Places in metres.
    pixels : int32 array (n, 2)
        Column and row of each.
    labels : int32 array (N,)
        The component of each point; −1 for none.
    sizes : int32 array (N,)
        The number of points of each component.
    components : int
        Their number.
    body : bool array (N,)
        Out: True for points of the body.
    room : LinkRoom
        Out: the links in `pairs` and `spans`.

    Returns
    -------
    int
        The number of links.
    """
    n, links = len(points), 0
    if components == 0:
        body[:n] = False
        return 0
    joined, squares = room.joined, room.squares
    joined[:components] = False
    newest = 0
    for c in range(components):
        newest = c if sizes[c] > sizes[newest] else newest
        squares[c] = MOST_LINK_M * MOST_LINK_M
        room.closest[c, 0] = -1
    joined[newest] = True
    if components > 1:
        _gather_blocks(points, pixels, labels, components, room)
    while components > 1:
        nearest = -1
        for c in range(components):
            if not joined[c]:
                _update_closest(points, np.int64(newest), c, room)
                if room.closest[c, 0] >= 0 and (nearest < 0 or squares[c] < squares[nearest]):
                    nearest = c
        if nearest < 0:
            break
        copy_row(room.pairs[links], room.closest[nearest])
        room.spans[links] = np.sqrt(squares[nearest])
        joined[nearest] = True
        newest = nearest
        links += 1
    for i in range(n):
        body[i] = labels[i] >= 0 and joined[labels[i]]
    return links


@njit(cache=True, nogil=True)
def _gather_blocks(points: F64, pixels: I32, labels: I32, components: int, room: LinkRoom) -> None:
    """Sort the nodes by component and tile, and compute the bounding boxes of their blocks."""
    order, blocks, firsts, boxes = room.order, room.blocks, room.firsts, room.boxes
    kept = _sort_nodes(pixels, labels, components, room)
    count, component, tile = 0, -1, -1
    for k in range(kept):
        i = order[k]
        if labels[i] != component or room.keys[0, i] != tile:
            if labels[i] != component:
                firsts[labels[i]] = count
            component, tile = labels[i], room.keys[0, i]
            blocks[count] = k
            copy_row(boxes[count, 0], points[i])
            copy_row(boxes[count, 1], points[i])
            count += 1
        for axis in range(3):
            boxes[count - 1, 0, axis] = min(boxes[count - 1, 0, axis], points[i, axis])
            boxes[count - 1, 1, axis] = max(boxes[count - 1, 1, axis], points[i, axis])
    blocks[count], firsts[components] = kept, count


@njit(cache=True, nogil=True)
def _sort_nodes(pixels: I32, labels: I32, components: int, room: LinkRoom) -> int:
    """Sort the nodes by component, column of tiles and row of tiles, and return their number."""
    n = len(pixels)
    order, (tiles, passing), counts = room.order, room.keys, room.counts
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
def _update_closest(points: F64, grown: int, component: int, room: LinkRoom) -> None:
    """Update the closest pairs after a component joined the body; ties go to the lowest nodes, the body's first."""
    boxes, firsts = room.boxes, room.firsts
    for skip_far in (True, False):  # the nearest pair of blocks first: its distance excludes most other blocks
        near, near_a, near_b = np.inf, -1, -1
        for a in range(firsts[grown], firsts[grown + 1]):
            for b in range(firsts[component], firsts[component + 1]):
                bound = _box_square(boxes[a], boxes[b])
                if skip_far and bound < near:
                    near, near_a, near_b = bound, a, b
                elif not skip_far and bound <= room.squares[component]:
                    _compare_blocks(points, np.int64(a), np.int64(b), component, room)
        if skip_far and near <= room.squares[component]:
            _compare_blocks(points, np.int64(near_a), np.int64(near_b), component, room)


@njit(cache=True, nogil=True)
def _compare_blocks(points: F64, a: int, b: int, component: int, room: LinkRoom) -> None:
    order, blocks, closest, squares = room.order, room.blocks, room.closest, room.squares
    low, high = room.boxes[b, 0], room.boxes[b, 1]
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
