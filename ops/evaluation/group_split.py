"""This module divides groups of clips into splits, such as training and test, without dividing a group."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

from kinedex.ops.arrays import F64, I64
from kinedex.ops.errors import ParameterError

_MAX_TRIED = 60_000
_ROUNDS = 100


def split_groups(sizes: Sequence[float] | F64, shares: Sequence[float] | F64) -> I64:
    """Divide groups into splits whose fractions of the total size are as close as possible to the wanted fractions.

    For few groups, all divisions are tried. Otherwise groups are assigned greedily, the largest first, each to the
    split that lacks most, and then moved and exchanged as long as this improves the fractions. No split is empty. The
    result depends on the order of the groups only if several divisions are equally good.

    Parameters
    ----------
    sizes : sequence of float (G,)
        Size of each group, such as its seconds.
    shares : sequence of float (S,)
        The wanted fraction of each split, above 0.

    Returns
    -------
    int64 array (G,)
        The split of each group.

    Raises
    ------
    ParameterError
        There are fewer groups than splits, or a fraction is not above 0.
    """
    amounts, wanted = np.asarray(sizes, np.float64), np.asarray(shares, np.float64)
    if not (wanted > 0).all():
        raise ParameterError("shares", "above 0", wanted.tolist())
    if len(amounts) < len(wanted):
        raise ParameterError("groups", f"at least {len(wanted)}, one for each split", len(amounts))
    goal = wanted / wanted.sum() * amounts.sum()
    if len(wanted) ** len(amounts) <= _MAX_TRIED:
        return _best(amounts, goal)
    return _improved(_greedy(amounts, goal), amounts, goal)


def _best(amounts: F64, goal: F64) -> I64:
    """Return the best of all divisions without an empty split; ties go to the first."""
    every = np.array(list(product(range(len(goal)), repeat=len(amounts))), np.int64)
    held = np.stack([(every == k) @ amounts for k in range(len(goal))], axis=1)
    used = np.stack([(every == k).any(axis=1) for k in range(len(goal))], axis=1).all(axis=1)
    errors = np.where(used, _error(held, goal), np.inf)
    return every[int(np.argmin(np.round(errors, 9)))]


def _error(held: F64, goal: F64) -> F64:
    error: F64 = np.square(held - goal).sum(axis=-1)
    return error


def _greedy(amounts: F64, goal: F64) -> I64:
    chosen = np.zeros(len(amounts), np.int64)
    held, counts = np.zeros(len(goal)), np.zeros(len(goal), np.int64)
    order = np.argsort(-amounts, kind="stable").tolist()
    for place, group in enumerate(order):
        lack = goal - held
        if len(order) - place <= np.count_nonzero(counts == 0):
            lack = np.where(counts == 0, lack, -np.inf)
        split = int(np.argmax(lack))
        chosen[group] = split
        held[split] += amounts[group]
        counts[split] += 1
    return chosen


def _improved(chosen: I64, amounts: F64, goal: F64) -> I64:
    """Move or exchange groups as long as this brings the sizes of the splits closer to `goal`.

    `chosen`, the split of each group, is changed in place and returned. At most `_ROUNDS` changes are made.
    """
    for _ in range(_ROUNDS):
        if not (_move(chosen, amounts, goal) or _exchange(chosen, amounts, goal)):
            break
    return chosen


def _held(chosen: I64, amounts: F64, goal: F64) -> F64:
    held: F64 = np.bincount(chosen, amounts, len(goal)).astype(np.float64)
    return held


def _move(chosen: I64, amounts: F64, goal: F64) -> bool:
    """Move the one group whose move brings the sizes of the splits closest to `goal`; return False if no move helps."""
    held = _held(chosen, amounts, goal)
    over = held - goal
    # the change of the squared errors if group g moves from its split to split k
    gain = 2 * amounts[:, None] * (over[None, :] - over[chosen][:, None] + amounts[:, None])
    gain[np.arange(len(chosen)), chosen] = 0.0
    gain[np.bincount(chosen, minlength=len(goal))[chosen] == 1] = 0.0
    group, split = np.unravel_index(int(np.argmin(gain)), gain.shape)
    if gain[group, split] >= -1e-9 * max(1.0, float(goal.sum())) ** 2:
        return False
    chosen[group] = split
    return True


def _exchange(chosen: I64, amounts: F64, goal: F64) -> bool:
    """Exchange the splits of two groups; return False if no exchange brings the sizes of the splits closer to `goal`.

    The first group for which an exchange helps is exchanged with the group for which it helps most.
    """
    over = _held(chosen, amounts, goal) - goal
    least = -1e-9 * max(1.0, float(goal.sum())) ** 2
    for group in range(len(chosen)):
        more = amounts - amounts[group]
        gain = np.where(chosen == chosen[group], 0.0, 2 * more * (over[chosen[group]] - over[chosen] + more))
        other = int(np.argmin(gain))
        if gain[other] < least:
            chosen[[group, other]] = chosen[[other, group]]
            return True
    return False
