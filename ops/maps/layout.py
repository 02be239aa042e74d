"""This module arranges points in a map of two dimensions, so that similar points are close together, by t-SNE.

The method is that of L. van der Maaten and G. Hinton, Visualizing data using t-SNE (2008), with the approximation of
Barnes and Hut, as implemented in scikit-learn.

The module also finds clusters of the map by density, with HDBSCAN of scikit-learn (R. Campello, D. Moulavi and J.
Sander, Density-based clustering based on hierarchical density estimates, 2013), and the features that characterise each
cluster.
"""

from __future__ import annotations

import contextlib
import io
import math
import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from kinedex.ops.arrays import F32, F64, I64, Bool
from kinedex.ops.packages import extra_package

MAX_POINTS = 5_000
"""Maximum number of points that t-SNE arranges; each other point is placed beside the most similar of these points."""

PERPLEXITY = 30.0
ITERATIONS = 1_000

PURPOSE = "a map of an archive needs"
"""The beginning of the error message if scikit-learn is missing."""

_MIN_POINTS = 5
"""Number of points below which principal components are used instead of t-SNE."""

_GOLDEN = math.pi * (3 - math.sqrt(5))

Progress = Callable[[int, int], None]
"""A callback that is called with the steps done and the steps in total."""

SHARE, MIN_POINTS = 160, 8
"""A cluster has at least 1 / `SHARE` of the points, and at least `MIN_POINTS` (`python -m studies.archive_map`)."""

NO_CLUSTER = -1


@dataclass(frozen=True)
class Layout:
    """The map positions of P points.

    Attributes
    ----------
    positions : float32 array (P, 2)
        Two coordinates without unit, from −1 to 1.
    chosen : int64 array (C,)
        The indices of the points that were arranged, ascending: all points, or a random selection.
    nearest : int64 array (P,)
        For each point the index in `chosen` of the point itself if it was selected, or else of the most similar
        selected point.
    """

    positions: F32
    chosen: I64
    nearest: I64


def map_layout(numbers: F64, *, most: int = MAX_POINTS, seed: int = 0, progress: Progress | None = None) -> Layout:
    """Arrange points in two dimensions, so that points with similar numbers are close together.

    Repeated calls with the same numbers give the same layout on the same machine. If there are more than `most` points,
    a random selection of them is arranged, and each other point is placed beside the selected point with the nearest
    numbers.

    Parameters
    ----------
    numbers : float64 array (P, n)
        Standardised numbers of P points.
    most : int, optional
        The maximum number of points that are arranged.
    seed : int, optional
        Seed of the selection and of the layout.
    progress : callable, optional
        A callback that is called with the steps done and the steps in total.

    Raises
    ------
    MissingPackageError
        scikit-learn is not installed (`kinedex[map]`).

    Examples
    --------
    >>> map_layout(np.array([[0.0, 1.0], [1.0, 0.0], [1.0, 0.0]])).chosen.tolist()
    [0, 1, 2]
    """
    count = len(numbers)
    if count <= most:
        chosen = np.arange(count)
        nearest = chosen
    else:
        chosen = np.sort(np.random.default_rng(seed).choice(count, most, replace=False)).astype(np.int64)
        nearest = _nearest(numbers, chosen)
    laid = _principal(_laid_out(numbers[chosen], seed, progress))  # rotated, so that it is wide rather than high
    if len(laid):
        laid -= (laid.max(axis=0) + laid.min(axis=0)) / 2
        laid /= max(float(np.abs(laid).max()), 1e-9)
    return Layout(_apart(laid[nearest], chosen).astype(np.float32), chosen, nearest)


def _laid_out(numbers: F64, seed: int, progress: Progress | None) -> F64:
    """Return two coordinates of each point by t-SNE, or by principal components if there are few points."""
    manifold = extra_package("sklearn.manifold", "scikit-learn", PURPOSE, "map")
    if len(numbers) < _MIN_POINTS or not np.ptp(numbers, axis=0).any():
        return _principal(numbers)
    made = manifold.TSNE(
        perplexity=min(PERPLEXITY, (len(numbers) - 1) / 3),
        max_iter=ITERATIONS,
        init="pca",
        random_state=seed,
        n_jobs=1,
        verbose=0 if progress is None else 2,
    )
    with contextlib.nullcontext() if progress is None else contextlib.redirect_stdout(_Iterations(progress)):
        found: F64 = made.fit_transform(numbers).astype(np.float64)
    return found


def _principal(numbers: F64) -> F64:
    """Return the first two principal components."""
    found = np.zeros((len(numbers), 2))
    if len(numbers):
        left, sizes, _ = np.linalg.svd(numbers - numbers.mean(axis=0), full_matrices=False)
        found[:, : min(2, len(sizes))] = (left * sizes)[:, :2]
    return found


class _Iterations(io.TextIOBase):
    """A text stream that parses progress from the output of scikit-learn, which has no callback for it."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress

    def write(self, text: str) -> int:
        """Report progress for each "Iteration <number>" in a text, and return the text's length, as streams do."""
        for found in re.finditer(r"Iteration (\d+)", text):
            self._progress(min(int(found.group(1)), ITERATIONS), ITERATIONS)
        return len(text)


def _nearest(numbers: F64, chosen: I64) -> I64:
    """Return for each point the index in `chosen` of the point nearest to it, which is itself if it was chosen."""
    neighbours = extra_package("sklearn.neighbors", "scikit-learn", PURPOSE, "map")
    search = neighbours.NearestNeighbors(n_neighbors=1, algorithm="brute", n_jobs=1).fit(numbers[chosen])
    found: I64 = search.kneighbors(numbers, return_distance=False)[:, 0].astype(np.int64)
    found[chosen] = np.arange(len(chosen))
    return found


def _apart(positions: F64, chosen: I64) -> F64:
    """Spread points with equal positions on a small spiral, so that each can be seen and pointed at."""
    order = np.ones(len(positions), np.int64)
    order[chosen] = 0  # points that were arranged keep their positions
    keys = np.round(positions, 9)
    by_place = np.lexsort((order, keys[:, 1], keys[:, 0]))
    same = (np.diff(keys[by_place], axis=0) == 0).all(axis=1)
    starts = np.flatnonzero(np.concatenate([[True], ~same])) if len(positions) else np.empty(0, np.int64)
    number = np.arange(len(positions)) - np.repeat(starts, np.diff(np.append(starts, len(positions))))
    turn, radius = number * _GOLDEN, 0.003 * np.sqrt(number)
    found = positions.copy()
    found[by_place] += np.stack([radius * np.cos(turn), radius * np.sin(turn)], axis=1)
    return found


@dataclass(frozen=True)
class Trait:
    """A feature that distinguishes a cluster from all other points.

    Attributes
    ----------
    feature : int
        The index of the feature, from 0.
    share : float
        The mean, over the cluster's points, of the fraction of frames in which the feature is on.
    rest : float
        The mean of this fraction over all other points.
    """

    feature: int
    share: float
    rest: float


def map_clusters(layout: Layout, least: int | None = None) -> I64:
    """Return the cluster of each point of a map, numbered from 0, the largest first; -1 for points in no cluster.

    Parameters
    ----------
    layout : Layout
        A map. Points that were not arranged get the cluster of the point beside which they were placed.
    least : int, optional
        The minimum number of arranged points of a cluster; by default 1 / `SHARE` of the arranged points, and at least
        `MIN_POINTS`.

    Returns
    -------
    int64 array (P,)

    Raises
    ------
    MissingPackageError
        scikit-learn is not installed (`kinedex[map]`).
    """
    cluster = extra_package("sklearn.cluster", "scikit-learn", PURPOSE, "map")
    laid = layout.positions[layout.chosen].astype(np.float64)
    least = max(MIN_POINTS, len(laid) // SHARE) if least is None else least
    if len(laid) < max(2, least):
        return np.full(len(layout.positions), NO_CLUSTER)
    found = cluster.HDBSCAN(min_cluster_size=least, copy=True).fit_predict(laid)
    labels = found.astype(np.int64)[layout.nearest]
    sizes = np.bincount(labels[labels >= 0], minlength=int(labels.max(initial=-1)) + 1)
    rank = np.empty(len(sizes) + 1, np.int64)
    rank[np.argsort(-sizes, kind="stable")] = np.arange(len(sizes))
    rank[NO_CLUSTER] = NO_CLUSTER
    ranked: I64 = rank[labels]
    return ranked


def outline(positions: F32) -> F32:
    """Return the corners of the convex hull of points, in order; two points at most if the hull has no area.

    Parameters
    ----------
    positions : float32 array (P, 2)
        The points.

    Examples
    --------
    >>> len(outline(np.array([[0, 0], [1, 0], [0, 1], [0.2, 0.2]], np.float32)))
    3
    """
    spatial = extra_package("scipy.spatial", "scikit-learn", PURPOSE, "map")
    if len(positions) < 3:
        return positions
    try:
        corners: F32 = positions[spatial.ConvexHull(positions.astype(np.float64)).vertices]
    except spatial.QhullError:  # the points are collinear
        return positions[np.lexsort((positions[:, 1], positions[:, 0]))[[0, -1]]]
    return corners


def traits(shares: F64, inside: Bool, most: int = 3, least: float = 0.1) -> list[Trait]:
    """Return the features by which the points of a cluster differ most from all other points.

    The difference of the mean shares is measured in standard deviations over all points. Hence a feature that is on in
    a fifth of the cluster's frames and never elsewhere is more characteristic than a feature that is on in half of the
    cluster's frames and in a third of the others.

    Parameters
    ----------
    shares : float64 array (P, f)
        The fraction of frames in which each feature is on; NaN if unknown.
    inside : bool array (P,)
        The points of the cluster.
    most : int, optional
        The maximum number of features to return.
    least : float, optional
        The minimum difference of the mean shares of a feature that is returned.

    Returns
    -------
    list of Trait
        The features, in order of decreasing difference.

    Examples
    --------
    >>> shares = np.array([[0.9, 0.5], [0.7, 0.5], [0.2, 0.5]])
    >>> traits(shares, np.array([True, True, False]))
    [Trait(feature=0, share=0.8, rest=0.2)]
    """
    own, rest, mean = (_means(shares[chosen]) for chosen in (inside, ~inside, slice(None)))
    spread = np.sqrt(_means((shares - mean) ** 2))
    difference = np.nan_to_num(np.abs(own - rest))
    order = np.argsort(-difference / np.maximum(np.nan_to_num(spread), 0.02), kind="stable")
    found = [i for i in order.tolist() if difference[i] >= least][:most]
    return [Trait(i, round(float(own[i]), 6), round(float(rest[i]), 6)) for i in found]


def _means(shares: F64) -> F64:
    there = ~np.isnan(shares)
    count = there.sum(axis=0)
    sums: F64 = np.where(there, shares, 0.0).sum(axis=0)
    return np.where(count > 0, sums / np.maximum(count, 1), np.nan)


def typical(positions: F32, inside: Bool, count: int = 3) -> I64:
    """Return the points of a cluster that are nearest to its centre on the map, the nearest first.

    Parameters
    ----------
    positions : float32 array (P, 2)
        The positions of the points on the map.
    inside : bool array (P,)
        True for the points of the cluster.
    count : int, optional
        The maximum number of points to return.
    """
    members = np.flatnonzero(inside)
    middle = np.median(positions[members], axis=0)
    distance = ((positions[members] - middle) ** 2).sum(axis=1)
    return members[np.argsort(distance, kind="stable")[:count]].astype(np.int64)
