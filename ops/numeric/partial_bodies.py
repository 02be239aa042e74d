"""This module handles bodies of which some joints are not known: gaps, examples, and what was learned of more joints.

A gap of a joint is bridged by its place relative to the root. A joint that an example does not know moves there as in
the mean of the other examples of the class. A take of which fewer joints are known than were learned is labelled by the
others alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from kinedex.ops.arrays import F32, F64, I64, Bool
from kinedex.ops.numeric.channels import Channels, extremities
from kinedex.ops.numeric.discriminant import Discriminant

Numbers = TypeVar("Numbers", F32, F64)

HELD_S = 0.5
"""Gaps of the root that last longer, in seconds, divide a take."""


def known_stretches(positions: F64 | F32, rate_hz: float) -> list[tuple[int, int]]:
    """Return the intervals of frames of a take that have no long gap of the root, stop excluded.

    Parameters
    ----------
    positions : float64 or float32 array (L, J, 3)
        The joints, the root first; NaN where they are not known.
    rate_hz : float
        Frames per second.
    """
    known = np.flatnonzero(np.isfinite(positions[:, 0]).all(axis=1))
    breaks = np.flatnonzero(np.diff(known) > HELD_S * rate_hz + 1) + 1
    parts = np.split(known, breaks)
    return [(int(part[0]), int(part[-1]) + 1) for part in parts if len(part) > 1]


def channel_columns(known: Bool, joints: Sequence[str]) -> Bool:
    """Return which channels of frames are known, bool (C,).

    Parameters
    ----------
    known : bool array (J,)
        The known joints.
    joints : sequence of str, length J
        The names of the joints, the root first.
    """
    moving = known[extremities(joints)]
    return np.concatenate([np.repeat(known[1:], 3), np.repeat(moving, 3), known, np.ones(6, np.bool_)])


def descriptor_columns(known: Bool) -> Bool:
    """Return which numbers of descriptors are known, bool (D,), by the known joints (J,)."""
    pooled = np.concatenate([np.repeat(known[1:], 3), known, np.ones(6, np.bool_)])
    return np.concatenate([pooled, pooled, np.ones(5, np.bool_)])


def chosen_columns(numbers: Numbers, columns: Bool) -> Numbers:
    """Return some columns of numbers, which are not copied if these are all."""
    if columns.all():
        return numbers
    found: Numbers = numbers[:, columns]
    return found


def completed(examples: Sequence[Channels], classes: I64, joints: Sequence[str]) -> tuple[list[Channels], Bool]:
    """Return examples whose unknown joints move as in the others of their class, and the joints that can be learned.

    Parameters
    ----------
    examples : sequence of Channels
        The channels of E examples.
    classes : int64 array (E,)
        The class of each.
    joints : sequence of str, length J
        The names of the joints.

    Returns
    -------
    examples : list of Channels
        Where a joint that can be learned is not known, its channels are the mean of the examples that know it, at the
        same share of their length.
    known : bool array (J,)
        The joints that can be learned: each class has an example that knows them.
    """
    masks = np.stack([one.known for one in examples])
    used = np.logical_and.reduce([masks[classes == one].any(axis=0) for one in np.unique(classes)])
    found = list(examples)
    for place in np.flatnonzero((used & ~masks).any(axis=1)).tolist():
        one = examples[place]
        frames = one.frames.copy()
        for joint in np.flatnonzero(used & ~one.known).tolist():
            only = np.arange(len(joints)) == joint
            columns = np.flatnonzero(channel_columns(only, joints)[:-6])
            others = np.flatnonzero((classes == classes[place]) & masks[:, joint]).tolist()
            frames[:, columns] = np.mean([_stretched(examples[k].frames[:, columns], len(frames)) for k in others], 0)
        found[place] = replace(one, frames=frames, known=one.known | used)
    return found, used


def _stretched(frames: F32, count: int) -> F32:
    """Return so many frames, each the one at the same share of the length."""
    return frames[(np.arange(count) * len(frames)) // count]


def restricted_discriminant(whole: Discriminant, columns: Bool) -> Discriminant:
    """Return the discriminant of some numbers of descriptors, by their part of the covariance.

    Parameters
    ----------
    whole : Discriminant
        The discriminant of D numbers.
    columns : bool array (D,)
        The numbers that are known.
    """
    covariance = (whole.lower @ whole.lower.T)[np.ix_(columns, columns)]
    means = whole.means[:, columns]
    lower = np.linalg.cholesky(covariance).astype(np.float64)
    weights = np.linalg.solve(lower.T, np.linalg.solve(lower, means.T))
    biases = -0.5 * np.sum(means.T * weights, axis=0)
    return Discriminant(whole.centre[columns], whole.scale[columns], weights, biases, means, lower)
