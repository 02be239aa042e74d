"""This module models each class by a row of states: means of channels that follow each other in its motions.

All states share one covariance, a background of usual frames stands for everything else, and evidence is a difference
of log-likelihoods. A path goes through a row from its first to its last state. From frame to frame, it stays in its
state, advances to the next state, or skips one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numba as nb
import numpy as np

from kinedex.ops.arrays import F32, F64, I64, Bool
from kinedex.ops.errors import ParameterError
from kinedex.ops.numeric.discriminant import shrunk
from kinedex.ops.numeric.state_columns import PIECE, StateColumns

STATE_S = 1 / 6
"""The duration of a state, in seconds."""

MAX_STATES = 30
"""The most states of a class."""

SHRINKAGE = 0.2
"""The share of the diagonal in the covariance of states."""

FEW_SHARE = 0.6
"""The share of the variance of all frames in that of states which have one example each; with n it is 1 / n² of it."""

DIRECTIONS = 20
"""The directions in which states are compared: those in which their means differ most."""

USUAL = 16
"""The usual frames that are the background."""

MAX_USUAL = 6000
"""Usual frames are chosen from so many frames of the archive at most, evenly spread."""

ROUNDS = 4
"""The number of times that states are learned, and examples aligned with them."""

PER_NAT = 0.1
"""The weight of log-likelihoods: frames that follow each other repeat much of their evidence."""


class LearnedStates(NamedTuple):
    """States in all directions of the standardised channels.

    Attributes
    ----------
    spread : float64 array (C,)
        What centred channels are divided by.
    covariance : float64 array (C, C)
        The covariance within states.
    means : float64 array (S, C)
        The means of the states.
    usual : float64 array (B, C)
        The means of the frames of the archive that are nearest to each usual frame.
    """

    spread: F64
    covariance: F64
    means: F64
    usual: F64


@dataclass(frozen=True)
class StateRows:
    """Rows of states of P classes.

    Attributes
    ----------
    centre : float64 array (C,)
        The mean of the channels.
    projection : float64 array (C, d)
        The matrix by which centred channels are multiplied, so that their covariance within states is the identity.
    states : float64 array (S, d)
        The projected means of all states, class by class.
    firsts : int64 array (P + 1,)
        The first state of each class, and S.
    usual : float64 array (B, d)
        The projected usual frames.
    learned : LearnedStates
        The standardised numbers from which these are projected.
    """

    centre: F64
    projection: F64
    states: F64
    firsts: I64
    usual: F64
    learned: LearnedStates

    @classmethod
    def fit(cls, examples: Sequence[F32 | F64], classes: I64, archive: F32 | F64, rate_hz: float) -> StateRows:
        """Learn the states of all classes.

        Parameters
        ----------
        examples : sequence of float32 or float64 arrays (L, C)
            The channels of the examples, each of two frames at least.
        classes : int64 array (E,)
            The class of each example, from 0; every class up to the greatest has one.
        archive : float32 or float64 array (A, C)
            The channels of frames of all kinds, for the background.
        rate_hz : float
            Frames per second.

        Raises
        ------
        ParameterError
            A class has no example, or an example is shorter than two frames.
        """
        counts = _state_counts(examples, classes, rate_hz)
        firsts = np.concatenate([[0], np.cumsum(counts)])
        frames, lengths = np.concatenate(examples).astype(np.float64), [len(one) for one in examples]
        centre = frames.mean(axis=0)
        spread = np.where((deviation := frames.std(axis=0)) > 0, deviation, 1.0)
        standard = (frames - centre) / spread
        ends = np.cumsum(lengths)
        paths = [
            firsts[one] + np.arange(length) * counts[one] // length
            for one, length in zip(classes.tolist(), lengths, strict=True)
        ]
        for turn in range(ROUNDS):
            path = np.concatenate(paths)
            means = _means(standard, path, firsts)
            within = standard - means[path]
            covariance = within.T @ within / max(len(within) - len(means), len(within) // 5, 1)
            covariance = widened(shrunk(covariance, SHRINKAGE), len(examples) / len(counts))
            projection = _projection(covariance, means)
            states = means @ projection
            if turn < ROUNDS - 1:
                paths = [
                    _aligned(standard[end - length : end] @ projection, states, int(firsts[one]), int(firsts[one + 1]))
                    for one, length, end in zip(classes.tolist(), lengths, ends.tolist(), strict=True)
                ]
        some = (archive[:: max(1, -(-len(archive) // MAX_USUAL))] - centre) / spread
        usual = usual_frames(some @ projection, USUAL)
        nearest = _squares(some @ projection, usual).argmin(axis=1)
        own = np.stack([some[nearest == one].mean(axis=0) for one in np.unique(nearest)])
        learned = LearnedStates(spread, covariance, means, own)
        return cls(centre, projection / spread[:, None], states, firsts, usual, learned)

    def restricted(self, columns: Bool) -> StateRows:
        """Return the same states by some of the channels, as their part of the covariance tells.

        Parameters
        ----------
        columns : bool array (C,)
            The channels that are known.
        """
        of = self.learned
        covariance, means = of.covariance[np.ix_(columns, columns)], of.means[:, columns]
        projection, usual, spread = _projection(covariance, means), of.usual[:, columns], of.spread[columns]
        return StateRows(
            self.centre[columns], projection / spread[:, None], means @ projection, self.firsts, usual @ projection,
            LearnedStates(spread, covariance, means, usual),
        )  # fmt: skip

    @cached_property
    def columns(self) -> StateColumns:
        """Return the states as columns of one matrix."""
        return StateColumns.of_means(self.usual, self.states, self.firsts, PER_NAT)

    def project(self, frames: F32) -> F32:
        """Return projected frames with a 1 appended to each, float32 (L, d + 1).

        Parameters
        ----------
        frames : float32 array (L, C)
            The channels of a take.
        """
        weights, constants = self._linear
        found = np.empty((len(frames), weights.shape[1]), np.float32)
        for first in range(0, len(frames), PIECE):
            np.matmul(frames[first : first + PIECE], weights, out=found[first : first + PIECE])
        found += constants
        return found

    @cached_property
    def _linear(self) -> tuple[F32, F32]:
        """Return weights (C, d + 1) and constants (d + 1,) that project channels, and append a 1."""
        weights = np.concatenate([self.projection, np.zeros((len(self.projection), 1))], axis=1)
        return weights.astype(np.float32), np.append(-self.centre @ self.projection, 1.0).astype(np.float32)

    def evidence(self, frames: F32 | F64) -> F64:
        """Return how much better each state explains each frame than the background does, float64 (L, S).

        Parameters
        ----------
        frames : float32 or float64 array (L, C)
            The channels of a take.
        """
        projected = (frames - self.centre) @ self.projection
        return 0.5 * PER_NAT * (_squares(projected, self.usual).min(axis=1)[:, None] - _squares(projected, self.states))


def widened(covariance: F64, examples: float) -> F64:
    """Return a covariance within states with a share of that of all frames, which is 1: few examples hardly differ.

    Parameters
    ----------
    covariance : float64 array (C, C)
        The covariance of standardised frames within states.
    examples : float
        The mean number of examples of a class.
    """
    share = FEW_SHARE / examples**2
    return (1.0 - share) * covariance + share * np.eye(len(covariance))


def usual_frames(frames: F64, count: int, rounds: int = 15) -> F64:
    """Return means of frames that lie near each other (k-means), float64 (count, d); all frames if there are fewer.

    The first means are frames that are drawn with a fixed seed.

    Parameters
    ----------
    frames : float64 array (L, d)
        The frames.
    count : int
        The number of means.
    rounds : int
        The number of times that frames are assigned to the nearest mean.
    """
    if len(frames) <= count:
        return frames.copy()
    means = frames[np.random.default_rng(0).permutation(len(frames))[:count]].copy()
    for _ in range(rounds):
        nearest = _squares(frames, means).argmin(axis=1)
        sizes = np.bincount(nearest, minlength=count)
        sums = np.zeros_like(means)
        np.add.at(sums, nearest, frames)
        means = np.where(sizes[:, None] > 0, sums / np.maximum(sizes, 1)[:, None], means)
    return means


def _state_counts(examples: Sequence[F32 | F64], classes: I64, rate_hz: float) -> I64:
    """Return the number of states of each class, by the median length of its examples."""
    short = [index for index, one in enumerate(examples) if len(one) < 2]
    if short:
        raise ParameterError(f"example {short[0]}", "of two frames or more", f"{len(examples[short[0]])}")
    lengths = np.array([len(one) for one in examples])
    count = int(classes.max(initial=-1)) + 1
    missing = [one for one in range(count) if not np.any(classes == one)]
    if missing or not count:
        raise ParameterError("classes", "with an example of each", f"none of class {missing[0] if missing else 0}")
    medians = np.array([np.median(lengths[classes == one]) for one in range(count)])
    shortest = np.array([lengths[classes == one].min() for one in range(count)])
    return np.clip(np.rint(medians / (STATE_S * rate_hz)).astype(np.int64), 2, np.minimum(MAX_STATES, 2 * shortest - 1))


def _means(frames: F64, path: I64, firsts: I64) -> F64:
    """Return the mean of the frames of each state; a state without frames has that of the nearest of its class."""
    sums = np.zeros((int(firsts[-1]), frames.shape[1]))
    np.add.at(sums, path, frames)
    sizes = np.bincount(path, minlength=len(sums))
    means = sums / np.maximum(sizes, 1)[:, None]
    for first, last in zip(firsts[:-1].tolist(), firsts[1:].tolist(), strict=True):
        known = first + np.flatnonzero(sizes[first:last])
        for state in np.setdiff1d(np.arange(first, last), known).tolist():
            means[state] = means[known[np.abs(known - state).argmin()]]
    return means


def _projection(covariance: F64, means: F64) -> F64:
    """Return the directions in which whitened means differ most, float64 (C, d)."""
    lower = np.linalg.cholesky(covariance)
    white = np.linalg.solve(lower, means.T).T
    axes = np.linalg.svd(white - white.mean(axis=0), full_matrices=False)[2][:DIRECTIONS]
    found: F64 = np.linalg.solve(lower.T, axes.T)
    return found


def _squares(frames: F64, means: F64) -> F64:
    """Return the squared distances of frames (L, d) and means (M, d), float64 (L, M)."""
    found = (frames**2).sum(axis=1)[:, None] - 2.0 * frames @ means.T + (means**2).sum(axis=1)
    return np.maximum(found, 0.0)


def _aligned(frames: F64, states: F64, first: int, last: int) -> I64:
    """Return the states that a path through a row visits, int64 (L,)."""
    return first + best_path(-_squares(frames, states[first:last]))


@nb.njit(cache=True, nogil=True)
def best_path(evidence: F64) -> I64:
    """Return the path through a row of states with the most evidence (kernel).

    Parameters
    ----------
    evidence : float64 array (L, S)
        The evidence of each state in each frame; L is (S + 1) / 2 at least, or no path reaches the last state.

    Returns
    -------
    int64 array (L,)
        The state of each frame; the first is 0, and the last S − 1.
    """
    frames, states = evidence.shape
    value = np.full(states, -np.inf)
    steps = np.zeros((frames, states), np.int8)
    value[0] = evidence[0, 0]
    for t in range(1, frames):
        for s in range(states - 1, -1, -1):
            best, step = value[s], 0
            if s >= 1 and value[s - 1] > best:
                best, step = value[s - 1], 1
            if s >= 2 and value[s - 2] > best:
                best, step = value[s - 2], 2
            value[s] = best + evidence[t, s]
            steps[t, s] = step
    path = np.empty(frames, np.int64)
    state = states - 1
    for t in range(frames - 1, -1, -1):
        path[t] = state
        state -= steps[t, state]
    return path
