"""Points, graph and extrema of a depth image by their definitions: loops over pixels, and searches that start anew."""

from __future__ import annotations

import heapq
from collections import deque
from itertools import product

import numpy as np

WINDOW = [(dv, du) for dv, du in product((-1, 0, 1), repeat=2)]


def foreground(
    image: np.ndarray, background: np.ndarray | None, rays: np.ndarray, floor: float | None, near: float, far: float
) -> np.ndarray:
    """Return the depths of foreground pixels of a level camera, 0 elsewhere."""
    kept = np.zeros(image.shape)
    for v, u in product(*map(range, image.shape)):
        z = float(image[v, u])
        wall = 0.0 if background is None else float(background[v, u])
        before = wall <= 0 or wall - z > 0.06 + 0.015 * z
        above = floor is None or -z * rays[v, u, 1] > floor + 0.01
        if near < z < far and before and above:
            kept[v, u] = z
    return kept


def cleaned(kept: np.ndarray) -> np.ndarray:
    """Return the median of the window of each pixel that stays, 0 elsewhere."""
    result = np.zeros(kept.shape)
    for v, u in np.argwhere(kept > 0):
        window = sorted(
            kept[v + dv, u + du]
            for dv, du in WINDOW
            if 0 <= v + dv < kept.shape[0] and 0 <= u + du < kept.shape[1] and kept[v + dv, u + du] > 0
        )
        median = window[(len(window) - 1) // 2]
        # In whole micrometres: sensors report millimetres, and 0.10 m is not below 0.10 m.
        if len(window) >= 6 and round(abs(kept[v, u] - median) * 1e6) < 100_000:
            result[v, u] = median
    return result


def nearest(pixels: np.ndarray, u: int, v: int) -> int:
    """Return the point whose pixel is nearest, ties to the lowest column, then the lowest row."""
    squares = ((pixels.astype(np.int64) - (u, v)) ** 2).sum(axis=1)
    return int(np.lexsort((pixels[:, 1], pixels[:, 0], squares))[0])


def edges(points: np.ndarray, numbers: np.ndarray, threshold: float) -> list[dict[int, float]]:
    """Return the neighbours of each node with their distances."""
    found: list[dict[int, float]] = [{} for _ in points]
    for v, u in np.argwhere(numbers >= 0):
        for dv, du in WINDOW:
            row, column = v + dv, u + du
            if (dv, du) == (0, 0) or not (0 <= row < numbers.shape[0] and 0 <= column < numbers.shape[1]):
                continue
            i, j = int(numbers[v, u]), int(numbers[row, column])
            if j >= 0 and (span := distance(points[i], points[j])) < threshold:
                found[i][j] = span
    return found


def distance(one: np.ndarray, other: np.ndarray) -> float:
    """Return the distance of two points, summed axis by axis."""
    x, y, z = other - one
    return float(np.sqrt(x * x + y * y + z * z))


def components(neighbours: list[dict[int, float]], least: int = 12) -> list[list[int]]:
    """Return the components that are large enough, by their lowest nodes."""
    seen, found = set(), []
    for start in range(len(neighbours)):
        if start in seen:
            continue
        todo, members = deque([start]), {start}
        while todo:
            fresh = set(neighbours[todo.popleft()]) - members
            members |= fresh
            todo.extend(fresh)
        seen |= members
        if len(members) >= least:
            found.append(sorted(members))
    return found


def links(points: np.ndarray, parts: list[list[int]], most: float = 0.5) -> tuple[set[int], list[tuple[int, int]]]:
    """Return the nodes of the body, and the links that made it grow, by all pairs of points."""
    if not parts:
        return set(), []
    first = max(range(len(parts)), key=lambda c: (len(parts[c]), -c))
    body, left, found = set(parts[first]), [c for c in range(len(parts)) if c != first], []
    while left:
        closest = []
        for c in left:
            inside, outside = np.array(sorted(body)), np.array(parts[c])
            gaps = points[outside][None] - points[inside][:, None]
            squares = gaps[..., 0] ** 2 + gaps[..., 1] ** 2 + gaps[..., 2] ** 2
            i, j = np.unravel_index(squares.argmin(), squares.shape)
            closest.append((squares[i, j], c, int(inside[i]), int(outside[j])))
        square, c, i, j = min(closest)
        if square >= most * most:
            break
        found.append((i, j))
        body |= set(parts[c])
        left.remove(c)
    return body, found


def restarted_extrema(
    neighbours: list[dict[int, float]], source: int, count: int
) -> tuple[list[int], list[float], list[int]]:
    """Return extrema, their distances, and how many nodes came nearer in each search, all searches from the start."""
    sources, nodes, distances, nearer = [source], [], [], []
    before = np.full(len(neighbours), np.inf)
    for _ in range(count):
        now = shortest(neighbours, sources)
        farthest = max(d for d in now if d < np.inf)
        if farthest == 0:
            break
        nodes.append(int(np.flatnonzero(now == farthest)[0]))
        distances.append(farthest)
        nearer.append(int((now < before).sum()))
        before = now
        sources.append(nodes[-1])
    return nodes, distances, nearer


def shortest(neighbours: list[dict[int, float]], sources: list[int]) -> np.ndarray:
    """Return the distance of each node to the nearest source, by Dijkstra's algorithm."""
    distances = np.full(len(neighbours), np.inf)
    distances[sources] = 0.0
    heap = [(0.0, node) for node in sources]
    while heap:
        length, node = heapq.heappop(heap)
        if length > distances[node]:
            continue
        for other, span in neighbours[node].items():
            if length + span < distances[other]:
                distances[other] = length + span
                heapq.heappush(heap, (length + span, other))
    return distances


def is_tip(
    points: np.ndarray, neighbours: list[dict[int, float]], node: int, from_source: np.ndarray, radius: float
) -> bool:
    """Return True where no node that is connected to a node inside a ball around it is farther from the source."""
    inside = ((points - points[node]) ** 2).sum(axis=1) < radius * radius
    todo, members = deque([node]), {node}
    while todo:
        fresh = {other for other in neighbours[todo.popleft()] if inside[other]} - members
        members |= fresh
        todo.extend(fresh)
    return bool(from_source[node] >= max(from_source[list(members)]))
