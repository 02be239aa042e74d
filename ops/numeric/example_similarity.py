"""This module orders intervals by their similarity to an example, by a distance that is learned from these intervals.

Intervals of different takes that are mutually among each other's nearest neighbours mostly show the same motion. What
differs between them (style, tempo, body) counts less: the distance is that of Mahalanobis by the covariance of these
differences. Neighbours are found by the distance of the round before, at first by that of standardised descriptors.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kinedex.ops.arrays import F64, I64, Bool
from kinedex.ops.errors import ParameterError
from kinedex.ops.numeric.channels import channels
from kinedex.ops.numeric.discriminant import shrunk
from kinedex.ops.numeric.partial_bodies import descriptor_columns
from kinedex.ops.numeric.span_descriptors import SpanSums

NEIGHBOURS = 6
"""The number of nearest neighbours in other takes that are compared with an interval."""

ROUNDS = 4
"""The number of times that neighbours are found and the covariance is computed from them."""

SHRINKAGE = 0.3
"""The share of the diagonal in the covariance."""


PROBABLE = 3.0
"""A candidate is probable if 1 − similarity is at most so many times the mean of that of mutual neighbours."""


class Comparison(NamedTuple):
    """The comparison of N candidates with examples.

    Attributes
    ----------
    similarity : float64 array (N,)
        The similarity of each candidate to the examples, from −1 to 1, or from −2 where intervals were rejected.
    probable : bool array (N,)
        True for a candidate that differs from the examples little more than neighbours differ from each other. None is
        probable where no two candidates of different takes are mutual neighbours.
    """

    similarity: F64
    probable: Bool


def compare(examples: F64, candidates: F64, takes: I64, rejected: F64 | None = None) -> Comparison:
    """Compare candidates with examples of a motion.

    The similarity is the cosine of the angle between a candidate and the mean of the examples, seen from the mean of
    the candidates and measured by the learned distance. It is lowered by 1 for a candidate that is more similar to one
    of the rejected intervals than to the examples.

    Parameters
    ----------
    examples : float64 array (E, D)
        The descriptors of one example or of several of the same motion.
    candidates : float64 array (N, D)
        The descriptors of the intervals that are compared with it.
    takes : int64 array (N,)
        The take of each candidate; overlapping intervals of a take are not evidence of what varies in a motion.
    rejected : float64 array (R, D), optional
        The descriptors of intervals that do not show the motion.

    Raises
    ------
    ParameterError
        There is no example, or a number is not finite.
    """
    if not len(examples):
        raise ParameterError("examples", "at least one", "none")
    others = np.empty((0, examples.shape[1])) if rejected is None else rejected
    if not all(np.isfinite(one).all() for one in (examples, candidates, others)):
        raise ParameterError("descriptors", "finite", "NaN or infinity")
    if not len(candidates):
        return Comparison(np.empty(0), np.empty(0, np.bool_))
    scale = candidates.std(axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    whitening = learned_whitening(candidates / scale, takes)
    whitened = candidates / scale @ whitening
    centre = whitened.mean(axis=0)
    directions = _unit_vectors(whitened - centre)
    similarity = directions @ _unit_vectors(examples.mean(axis=0) / scale @ whitening - centre)
    unlike = directions @ _unit_vectors(others / scale @ whitening - centre).T
    similarity = similarity - (unlike.max(axis=1, initial=-np.inf) > similarity)
    one, other = mutual_neighbours(whitened, takes)
    usual = 1.0 - np.sum(directions[one] * directions[other], axis=1)
    line = PROBABLE * float(usual.mean()) if len(usual) else -np.inf
    return Comparison(similarity, 1.0 - similarity <= line)


def _unit_vectors(vectors: F64) -> F64:
    """Return vectors (…, D) divided by their lengths; a vector of no length stays as it is."""
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(lengths > 0, lengths, 1.0)


def learned_whitening(descriptors: F64, takes: I64) -> F64:
    """Return the matrix (D, D) by which descriptors are multiplied, so that Euclidean distances are the learned ones.

    It is the identity where no candidates of different takes are mutual neighbours.

    Parameters
    ----------
    descriptors : float64 array (N, D)
        The standardised descriptors of the candidates.
    takes : int64 array (N,)
        The take of each candidate.
    """
    whitening = np.eye(descriptors.shape[1])
    for _ in range(ROUNDS):
        one, other = mutual_neighbours(descriptors @ whitening, takes)
        if not len(one):
            break
        differences = descriptors[one] - descriptors[other]
        covariance = shrunk(differences.T @ differences / len(differences), SHRINKAGE)
        whitening = np.linalg.inv(np.linalg.cholesky(covariance)).T
    return whitening


def mutual_neighbours(points: F64, takes: I64) -> tuple[I64, I64]:
    """Return the pairs of points of different takes that are among each other's `NEIGHBOURS` nearest, both (P,).

    Each pair is returned once. A point has fewer neighbours where other takes have fewer points.

    Parameters
    ----------
    points : float64 array (N, D)
        The points.
    takes : int64 array (N,)
        The take of each point.
    """
    products = points @ points.T
    squares = np.diag(products)
    far = squares[:, None] + squares[None, :] - 2.0 * products
    far[takes[:, None] == takes[None, :]] = np.inf
    near: Bool = np.zeros(far.shape, np.bool_)
    count = min(NEIGHBOURS, len(points) - 1)
    if count > 0:
        nearest = np.argpartition(far, count - 1, axis=1)[:, :count]
        np.put_along_axis(near, nearest, True, axis=1)
    one, other = np.nonzero(np.triu(near & near.T & np.isfinite(far)))
    return one, other


def interval_descriptor(positions: F64, joints: Sequence[str], rate_hz: float) -> F64 | None:
    """Return the descriptor of an interval, float64 (D,), or None if it cannot be described.

    An interval of a single frame, and a body without a heading or a size, cannot be described. Numbers of joints that
    are not known are NaN.

    Parameters
    ----------
    positions : float64 array (T, J, 3)
        The joints in metres, Y up; NaN where they are not known.
    joints : sequence of str, length J
        The names of the joints, the root first.
    rate_hz : float
        Frames per second.
    """
    try:
        found = channels(positions, joints, rate_hz)
    except ParameterError:
        return None
    described = SpanSums(found, rate_hz).describe(np.zeros(1, np.int64), np.array([len(positions)], np.int64))[0]
    return np.where(descriptor_columns(found.known), described, np.nan)
