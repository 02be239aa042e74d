"""Compute the map of a store's takes, or of windows of takes: positions by words, clusters, and their traits."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from kinedex.ops.arrays import F32, F64, I64
from kinedex.ops.intervals import in_seconds
from kinedex.ops.maps.interval_numbers import interval_numbers, standardised
from kinedex.ops.maps.layout import Layout, Progress, Trait, map_clusters, map_layout, outline, traits, typical
from kinedex.pipelines.keyframes.slice_search import stored_words

if TYPE_CHECKING:
    from kinedex.storage.store.store import Store

Unit = Literal["takes", "windows"]

WINDOW_SECONDS = 4.0
"""The approximate length of windows in seconds; a take is divided into windows of equal length."""

MAX_POINTS = 100_000
"""The largest number of windows; the length is doubled until there are no more."""


@dataclass(frozen=True)
class Cluster:
    """A cluster of a map.

    Attributes
    ----------
    points, takes : int
        The number of its points, and of takes with points in it.
    hours : float
        The duration of its points.
    traits : tuple of Trait
        The features that distinguish it from the other points.
    classes : tuple of (str or None, int)
        The classes of its takes with their numbers of takes, the most frequent first; None for takes without a class.
    typical : tuple of int
        The indices of three points near its centre.
    outline : float32 array (C, 2)
        The vertices of its convex hull.
    """

    points: int
    takes: int
    hours: float
    traits: tuple[Trait, ...]
    classes: tuple[tuple[str | None, int], ...]
    typical: tuple[int, ...]
    outline: F32


@dataclass(frozen=True)
class ArchiveMap:
    """A map of P points.

    Attributes
    ----------
    take_ids, starts, stops : int64 array (P,)
        The take and the half-open range of analysis frames of each point, ascending.
    positions : float32 array (P, 2)
        The positions, with coordinates between −1 and 1.
    numbers : int64 array (P,)
        The cluster of each point, −1 for none.
    clusters : tuple of Cluster
        The clusters, the largest first.
    laid_out : int
        The number of points placed by t-SNE; each other point lies beside the most similar one of these.
    window_seconds : float or None
        The length of windows, None for a map of takes.
    """

    take_ids: I64
    starts: I64
    stops: I64
    positions: F32
    numbers: I64
    clusters: tuple[Cluster, ...]
    laid_out: int
    window_seconds: float | None

    @property
    def remarks(self) -> tuple[str, ...]:
        """Sentences about limitations of the map."""
        found = []
        noun = "takes" if self.window_seconds is None else "windows"
        if self.window_seconds is not None and self.window_seconds > WINDOW_SECONDS:
            found.append(
                f"Windows are of {self.window_seconds:g} s: of {WINDOW_SECONDS:g} s there would be more than "
                f"{MAX_POINTS:,}."
            )
        if self.laid_out < len(self.take_ids):
            found.append(
                f"{self.laid_out:,} of {len(self.take_ids):,} {noun}, drawn at random, were laid out; each of the "
                "others lies beside the one of these whose words are most like its own."
            )
        return tuple(found)


def archive_map(store: Store, unit: Unit = "takes", progress: Progress | None = None) -> ArchiveMap:
    """Compute the map of a store.

    Parameters
    ----------
    store : Store
        The store.
    unit : {"takes", "windows"}, optional
        The unit that a point represents.
    progress : callable, optional
        Called with steps done and steps in all.

    Raises
    ------
    MissingPackageError
        scikit-learn is not installed (`kinedex[map]`).
    StoreError
        A part of the store cannot be read.
    """
    features = len(store.feature_set.features)
    words = stored_words(store, store.take_rows.column("take_id").to_pylist())
    window = None if unit == "takes" else window_seconds(words.frames, store.rate_hz)
    owner, bounds = windows(words.frames, None if window is None else window * store.rate_hz)
    known = None if words.known is None else words.known[owner]
    numbers = interval_numbers(words.words, bounds, features, known)
    starts = bounds[:-1] - words.offsets[owner]
    stops = bounds[1:] - words.offsets[owner]
    layout = map_layout(standardised(numbers), progress=progress)
    clusters = map_clusters(layout)
    points = _Points(words.take_ids[owner], stops - starts, numbers[:, :features], clusters)
    return ArchiveMap(
        points.take_ids, starts, stops, layout.positions, clusters,
        _described(store, points, layout), len(layout.chosen), window,
    )  # fmt: skip


def window_seconds(frames: I64, rate_hz: float) -> float:
    """Return the window length, in seconds, for which takes of the given lengths have at most `MAX_POINTS` windows.

    If there are more takes than that, each of them has one window.

    Examples
    --------
    >>> window_seconds(np.array([300]), 30.0)
    4.0
    """
    seconds = WINDOW_SECONDS
    while len(frames) < len(windows(frames, seconds * rate_hz)[0]) > MAX_POINTS:
        seconds *= 2
    return seconds


def windows(frames: I64, length: float | None) -> tuple[I64, I64]:
    """Divide each take into windows whose lengths differ by at most one frame and are close to a given length.

    Parameters
    ----------
    frames : int64 array (T,)
        The number of frames of each take.
    length : float or None
        The length in frames; None for one window per take.

    Returns
    -------
    owner : int64 array (P,)
        The index of the take of each window.
    bounds : int64 array (P + 1,)
        Window p has the frames bounds[p] to bounds[p + 1] − 1 of the concatenated takes.

    Examples
    --------
    >>> windows(np.array([10, 3]), 4.0)
    (array([0, 0, 1]), array([ 0,  5, 10, 13]))
    """
    counts = np.ones(len(frames), np.int64)
    if length is not None:
        counts = np.maximum(1, np.rint(frames / length).astype(np.int64))
    owner = np.repeat(np.arange(len(frames)), counts)
    number = np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)
    first = np.repeat(np.cumsum(frames) - frames, counts)
    starts = first + number * np.repeat(frames, counts) // np.repeat(counts, counts)
    return owner, np.append(starts, frames.sum()).astype(np.int64)


@dataclass(frozen=True)
class _Points:
    """The points of a map: takes, lengths in frames, fractions of features, and clusters."""

    take_ids: I64
    frames: I64
    shares: F64
    clusters: I64


def _described(store: Store, points: _Points, layout: Layout) -> tuple[Cluster, ...]:
    rows = store.take_rows.select(["take_id", "class"]).to_pydict()
    classes = dict(zip(rows["take_id"], rows["class"], strict=True))
    found = []
    for number in range(int(points.clusters.max(initial=-1)) + 1):
        inside = points.clusters == number
        takes = np.unique(points.take_ids[inside]).tolist()
        counts = Counter(classes[take] for take in takes)
        found.append(
            Cluster(
                int(inside.sum()),
                len(takes),
                in_seconds(float(points.frames[inside].sum()), store.rate_hz) / 3600,
                tuple(traits(points.shares, inside)),
                tuple(sorted(counts.items(), key=lambda one: (-one[1], one[0] or ""))),
                tuple(typical(layout.positions, inside).tolist()),
                outline(layout.positions[inside]),
            )
        )
    return tuple(found)


def trait_words(found: tuple[Trait, ...], descriptions: list[str]) -> str:
    """Describe the features that distinguish a cluster; features that are rarer in it than elsewhere are negated.

    Examples
    --------
    >>> trait_words((Trait(0, 0.8, 0.1), Trait(1, 0.0, 0.4)), ["left foot raised", "root fast"])
    'left foot raised, not root fast'
    """
    return ", ".join(f"{'' if one.share > one.rest else 'not '}{descriptions[one.feature]}" for one in found)
