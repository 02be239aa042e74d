"""This module computes margins around the hits of a keyframe query, and the template columns of its keyframes."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from kinedex.ops.errors import ParameterError
from kinedex.ops.search.gaps import UNBOUNDED
from kinedex.ops.words import I64

_COST_UNIT = 2**40
"""Unit to which costs are rounded as integers, so that ties do not depend on rounding errors."""


def template_margins(first: int, last: int, columns: int, stiffness: float) -> tuple[int, int]:
    """Return the margins by which a template may extend beyond a hit of its keyframe query.

    A hit covers the motion from the first to the last keyframe of the query (thesis, Section 5.3). The template's
    columns before and after these keyframes may take as many frames as the query's smallest stiffness allows, but no
    more than two frames per column, the limit of a warping path.

    Parameters
    ----------
    first, last : int
        The template columns of the first and the last keyframe, from 0.
    columns : int
        The number of columns N of the template.
    stiffness : float
        The smallest stiffness of the query, 0 to 1.

    Returns
    -------
    (int, int)
        Frames before and after a hit: ceil(first / s) + 2 and ceil((N - last) / s) + 2 with s = max(stiffness, 0.5).

    Raises
    ------
    ParameterError
        If the positions lie outside the template or out of order, or the stiffness is out of its domain.
    """
    if not 0 <= first <= last < columns:
        raise ParameterError("positions", f"in order and within 0 to {columns - 1}", (first, last))
    if not 0.0 <= stiffness <= 1.0:
        raise ParameterError("stiffness", "between 0 and 1", stiffness)
    slowest = max(stiffness, 0.5)
    return math.ceil(round(first / slowest, 9)) + 2, math.ceil(round((columns - last) / slowest, 9)) + 2


def fit_keyframes(
    template: npt.NDArray[np.float64],
    masks: npt.NDArray[np.bool_],
    values: npt.NDArray[np.bool_],
    gaps: Sequence[tuple[int, int]],
) -> tuple[int, ...]:
    """Find the template columns that match the keyframes of a query best, with admissible gaps between them.

    The cost of a keyframe in a column is the mean of |template - value| over the keyframe's fixed entries, which is the
    fraction of mismatches, with wildcards of the template counted as half a mismatch.

    Parameters
    ----------
    template : float64 array (N, f)
        Columns of values in [0, 1]; a quantised template has 0, 1, and one half for wildcards.
    masks : bool array (K, f)
        The entries that each keyframe fixes.
    values : bool array (K, f)
        The values to which it fixes them.
    gaps : sequence of (int, int)
        K - 1 admissible gaps (low, high), here between columns.

    Returns
    -------
    tuple of int
        The cheapest columns p_1 <= ... <= p_K with admissible gaps; if there are none, the cheapest ascending columns
        with any gaps. In a tie, the leftmost columns are chosen, compared from the first keyframe on.

    Raises
    ------
    ParameterError
        If the template is empty, or the shapes do not match.
    """
    if template.ndim != 2 or not len(template):
        raise ParameterError("template", "of shape (columns, features), with at least one column", template.shape)
    if masks.shape != values.shape or masks.ndim != 2 or masks.shape[1] != template.shape[1] or not len(masks):
        raise ParameterError("masks", f"of shape (keyframes, {template.shape[1]}) as values are", masks.shape)
    if len(gaps) != len(masks) - 1:
        raise ParameterError("gaps", f"{len(masks) - 1}, one fewer than keyframes", len(gaps))
    misfit = np.where(masks[:, None, :], np.abs(template[None, :, :] - values[:, None, :]), 0.0).sum(axis=2)
    share = misfit / np.maximum(masks.sum(axis=1), 1)[:, None]
    costs = np.round(share * _COST_UNIT).astype(np.int64)
    positions = _cheapest(costs, gaps)
    if positions is None:
        positions = _cheapest(costs, [(0, UNBOUNDED)] * len(gaps))
        assert positions is not None
    return tuple(positions)


def _cheapest(costs: I64, gaps: Sequence[tuple[int, int]]) -> list[int] | None:
    """Return the cheapest admissible columns by dynamic programming from the last keyframe backwards, or None."""
    count, columns = costs.shape
    never = np.iinfo(np.int64).max // 2
    best = costs[-1]
    following: list[I64] = []
    for k in range(count - 2, -1, -1):
        low, high = gaps[k]
        onward = np.full(columns, never, np.int64)
        target = np.zeros(columns, np.int64)
        for column in range(max(columns - low, 0)):
            reach = best[column + low : column + min(high, columns) + 1]
            nearest = int(np.argmin(reach))
            onward[column], target[column] = reach[nearest], column + low + nearest
        best = np.where(onward < never, costs[k] + onward, never)
        following.append(target)
    positions = [int(np.argmin(best))]
    if best[positions[0]] >= never:
        return None
    for target in reversed(following):
        positions.append(int(target[positions[-1]]))
    return positions
