"""This module lays out a map in two dimensions, such that similar points lie close together (t-SNE).

L. van der Maaten, G. Hinton: Visualizing data using t-SNE (2008), with the approximation of Barnes and Hut, as
implemented in scikit-learn.
"""

from __future__ import annotations

import contextlib
import io
import math
import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from kinedex.ops.arrays import F32, F64, I64
from kinedex.ops.packages import extra_package

MOST = 5_000
"""Maximum number of points that t-SNE lays out; each of the others is put beside the most similar of these."""

PERPLEXITY = 30.0
ITERATIONS = 1_000

PURPOSE = "a map of an archive needs"
"""The beginning of the error message if scikit-learn is missing."""

_LEAST = 5
"""Number of points below which principal components are used instead of t-SNE."""

_GOLDEN = math.pi * (3 - math.sqrt(5))

Progress = Callable[[int, int], None]
"""A callback that is called with the steps done and the steps in total."""


@dataclass(frozen=True)
class Layout:
    """The map positions of P points.

    Attributes
    ----------
    places : float32 array (P, 2)
        Two coordinates without unit, from −1 to 1.
    chosen : int64 array (C,)
        The points that were laid out, ascending: all of them, or a random choice.
    nearest : int64 array (P,)
        For each point the index in `chosen` of the point itself, or of the most similar chosen point.
    """

    places: F32
    chosen: I64
    nearest: I64


def map_layout(numbers: F64, *, most: int = MOST, seed: int = 0, progress: Progress | None = None) -> Layout:
    """Lay out points, such that points with similar numbers are close together.

    The same numbers have the same layout in every run on the same machine. Of more than `most` points a random choice
    is laid out; each of the others is put beside the chosen one whose numbers are nearest to its own.

    Parameters
    ----------
    numbers : float64 array (P, n)
        Standardised numbers of P points.
    most : int, optional
        The most points that are laid out.
    seed : int, optional
        Seed of the choice and of the layout.
    progress : callable, optional
        Called with steps done and steps in all.

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
    if len(numbers) < _LEAST or not np.ptp(numbers, axis=0).any():
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


def _apart(places: F64, chosen: I64) -> F64:
    """Spread points with equal positions on a small spiral, so that each can be seen and pointed at."""
    order = np.ones(len(places), np.int64)
    order[chosen] = 0  # points that were laid out keep their positions
    keys = np.round(places, 9)
    by_place = np.lexsort((order, keys[:, 1], keys[:, 0]))
    same = (np.diff(keys[by_place], axis=0) == 0).all(axis=1)
    starts = np.flatnonzero(np.concatenate([[True], ~same])) if len(places) else np.empty(0, np.int64)
    number = np.arange(len(places)) - np.repeat(starts, np.diff(np.append(starts, len(places))))
    turn, radius = number * _GOLDEN, 0.003 * np.sqrt(number)
    found = places.copy()
    found[by_place] += np.stack([radius * np.cos(turn), radius * np.sin(turn)], axis=1)
    return found
