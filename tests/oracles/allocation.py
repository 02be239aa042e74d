"""Allocation written from the thesis (Section 6.4.1) with plain loops over frames and hits."""

from __future__ import annotations

Hit = tuple[int, int, int, float, list[float]]  # motion, start, end (included), cost, column of each frame


def essential(minima: list[tuple[int, int, float]]) -> list[int]:
    """Return the places of the minima (start, end, cost) that no cheaper one taken before is close to."""
    taken: list[int] = []
    for place in sorted(range(len(minima)), key=lambda i: (minima[i][2], minima[i][1])):
        start, end, _ = minima[place]
        close = False
        for other in taken:
            shorter = min(end - start, minima[other][1] - minima[other][0])
            close = close or abs(end - minima[other][1]) < shorter / 2
        if not close:
            taken.append(place)
    return taken


def owner(hits: list[Hit], frame: int) -> int:
    """Return the hit of least cost that covers a frame, the first of equals, −1 for none."""
    best = -1
    for place, (_, start, end, cost, _) in enumerate(hits):
        if start <= frame <= end and (best < 0 or cost < hits[best][3]):
            best = place
    return best


def lender(hits: list[Hit], frame: int) -> int:
    """Return the frame that lends its pose to a frame, −1 for none."""
    mine = owner(hits, frame)
    if mine < 0:
        return -1
    motion, start, end, cost, columns = hits[mine]
    source = -1
    for place, (other, first, last, price, _) in enumerate(hits):
        if other != motion or price >= cost or (first <= end and start <= last):
            continue
        if source < 0 or price < hits[source][3]:
            source = place
    if source < 0:
        return -1
    _, first, last, _, theirs = hits[source]
    column = round(columns[frame - start])
    return min(range(first, last + 1), key=lambda t: (abs(round(theirs[t - first]) - column), t))
