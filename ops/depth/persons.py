"""This module separates several people in a frame, so that the points of one of them can be tracked."""

from __future__ import annotations

import numpy as np

from kinedex.ops.arrays import F64, I64
from kinedex.ops.depth.graph import PointGraph
from kinedex.ops.depth.points import FrameCloud

PERSON_POINTS, APART_M = 500, 0.3
"""Two components with more points than the first, and farther apart in metres than the second, are two people."""

_SAMPLE = 400  # most points of a component between which distances are measured


def split_people(cloud: FrameCloud, graph: PointGraph) -> list[I64]:
    """Return the points of each person in a frame, ordered by their lowest point; empty for one person or none.

    Parameters
    ----------
    cloud : FrameCloud
        The points.
    graph : PointGraph
        Their graph.

    Returns
    -------
    list of int64 array
        Ascending indices of points; those of small components belong to the nearest person.
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
    """Return a copy of a frame that is restricted to some of its points.

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
    """Merge components that are not far apart."""
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
