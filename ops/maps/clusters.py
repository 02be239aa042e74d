"""This module finds clusters of a map by density (HDBSCAN), and the features that characterise each of them.

R. Campello, D. Moulavi, J. Sander: Density-based clustering based on hierarchical density estimates (2013), implemented
in scikit-learn.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinedex.ops.arrays import F32, F64, I64, Bool
from kinedex.ops.maps.layout import PURPOSE, Layout
from kinedex.ops.packages import extra_package

SHARE, LEAST = 160, 8
"""A cluster has at least 1 / `SHARE` of the points, and at least `LEAST` (`python -m studies.archive_map`)."""

NO_CLUSTER = -1


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
        The same mean over all other points.
    """

    feature: int
    share: float
    rest: float


def map_clusters(layout: Layout, least: int | None = None) -> I64:
    """Return the cluster of each point of a map, numbered from 0, the largest first; -1 for points in none.

    Parameters
    ----------
    layout : Layout
        A map. Points that were not laid out get the cluster of the point beside which they were put.
    least : int, optional
        The smallest number of points of a cluster among those that were laid out; None: one in `SHARE`, and at least
        `LEAST`.

    Returns
    -------
    int64 array (P,)

    Raises
    ------
    MissingPackageError
        scikit-learn is not installed (`kinedex[map]`).
    """
    cluster = extra_package("sklearn.cluster", "scikit-learn", PURPOSE, "map")
    laid = layout.places[layout.chosen].astype(np.float64)
    least = max(LEAST, len(laid) // SHARE) if least is None else least
    if len(laid) < max(2, least):
        return np.full(len(layout.places), NO_CLUSTER)
    found = cluster.HDBSCAN(min_cluster_size=least, copy=True).fit_predict(laid)
    labels = found.astype(np.int64)[layout.nearest]
    sizes = np.bincount(labels[labels >= 0], minlength=int(labels.max(initial=-1)) + 1)
    rank = np.empty(len(sizes) + 1, np.int64)
    rank[np.argsort(-sizes, kind="stable")] = np.arange(len(sizes))
    rank[NO_CLUSTER] = NO_CLUSTER
    ranked: I64 = rank[labels]
    return ranked


def outline(places: F32) -> F32:
    """Return the corners of the convex hull of points, in order; only two points if the hull has no area.

    Parameters
    ----------
    places : float32 array (P, 2)
        The points.

    Examples
    --------
    >>> len(outline(np.array([[0, 0], [1, 0], [0, 1], [0.2, 0.2]], np.float32)))
    3
    """
    spatial = extra_package("scipy.spatial", "scikit-learn", PURPOSE, "map")
    if len(places) < 3:
        return places
    try:
        corners: F32 = places[spatial.ConvexHull(places.astype(np.float64)).vertices]
    except spatial.QhullError:  # the points are collinear
        return places[np.lexsort((places[:, 1], places[:, 0]))[[0, -1]]]
    return corners


def traits(shares: F64, inside: Bool, most: int = 3, least: float = 0.1) -> list[Trait]:
    """Return the features by which the points of a cluster differ most from all others.

    The difference of the mean shares is measured in standard deviations of all points: a feature that is on for a fifth
    of the frames here and never elsewhere is more characteristic than one that is on for half of them here and a third
    elsewhere.

    Parameters
    ----------
    shares : float64 array (P, f)
        The fraction of frames of each feature, NaN where unknown.
    inside : bool array (P,)
        The points of the cluster.
    most : int, optional
        The most features to return.
    least : float, optional
        The smallest difference of the mean shares that counts.

    Returns
    -------
    list of Trait
        Those that differ most first.

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


def typical(places: F32, inside: Bool, count: int = 3) -> I64:
    """Return the points of a cluster that are nearest to its centre on the map, the nearest first.

    Parameters
    ----------
    places : float32 array (P, 2)
        The positions of the points on the map.
    inside : bool array (P,)
        True for the points of the cluster.
    count : int, optional
        The most points to return.
    """
    members = np.flatnonzero(inside)
    middle = np.median(places[members], axis=0)
    distance = ((places[members] - middle) ** 2).sum(axis=1)
    return members[np.argsort(distance, kind="stable")[:count]].astype(np.int64)
