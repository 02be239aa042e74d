"""This module traces paths of distance curves, and finds minimum curves and essential minima (thesis, Chapter 6)."""

from __future__ import annotations

from typing import NamedTuple

import numba as nb
import numpy as np

from kinedex.ops.arrays import F64, I32, I64, U64
from kinedex.ops.distances.costs import encode, template_columns
from kinedex.ops.distances.recurrence import step_back
from kinedex.ops.distances.window_sums import Window, make_window, sum_window
from kinedex.ops.errors import ParameterError
from kinedex.ops.templates.templates import QuantisedTemplate


class LeastCurve(NamedTuple):
    """The pointwise minimum of several distance curves.

    Attributes
    ----------
    costs : float64 array (L,)
        Δ^min, the smallest distance in each frame (thesis, Eq. 6.5); ∞ where no path ends.
    curves : int64 array (L,)
        Δ^arg, the first curve that attains it (thesis, Eq. 6.6); −1 where no path ends.
    """

    costs: F64
    curves: I64


def least_curve(curves: F64) -> LeastCurve:
    """Return the pointwise minimum of distance curves, and the curve that attains it (thesis, Eq. 6.5 and 6.6).

    Parameters
    ----------
    curves : float64 array (P, L)
        The distance curves of P templates, see `ops.distances.dtw.distance_curves`.

    Returns
    -------
    LeastCurve
        The least curve; ties go to the first curve.
    """
    if not len(curves):
        return LeastCurve(np.full(curves.shape[1], np.inf), np.full(curves.shape[1], -1, np.int64))
    nearest = curves.argmin(axis=0)
    costs = curves[nearest, np.arange(curves.shape[1])]
    return LeastCurve(costs, np.where(costs < np.inf, nearest, -1))


class CurvePath(NamedTuple):
    """The cheapest warping path that ends in a frame.

    Attributes
    ----------
    start : int
        The first frame a_ℓ of the path.
    columns : float64 array (E,)
        The column of the template in each frame from the first to the last. A frame that is skipped by a (1,2) step has
        the column of the previous frame plus one half.
    """

    start: int
    columns: F64


def curve_paths(template: QuantisedTemplate, words: U64, ends: I64) -> list[CurvePath]:
    """Return the cheapest warping paths that end in given frames, as frames and columns.

    Of equally cheap paths, the choice is made step by step from the end of the path: a (1,1) step is preferred to
    (1,2), and (1,2) to (2,1), as in `ops.distances.window_sums.path_start`.

    Parameters
    ----------
    template : QuantisedTemplate
        A template of N columns.
    words : uint64 array (L,)
        The words of a take; `NO_WORD` if a frame is invalid.
    ends : int64 array (E,)
        Frames in which the template's distance curve is finite.

    Returns
    -------
    list of CurvePath
        One path for each end, in their order.

    Raises
    ------
    ParameterError
        If no path ends in one of the frames.
    """
    if len(ends) and not (ends.min() >= 0 and ends.max() < len(words)):
        raise ParameterError("ends", f"frames from 0 to {len(words) - 1}", ends.tolist())
    coded, columns = encode(words), template_columns(template)
    count = len(template)
    window = make_window(2 * count - 1, count, len(coded.vocabulary))
    cells = np.empty((count, 2), np.int64)
    cost = np.empty(1)
    found = []
    for end in ends.tolist():
        begin = max(0, end - 2 * (count - 1))
        sum_window(coded.vocabulary, coded.codes, columns, begin, end, cost, np.inf, window)
        if not cost[0] < np.inf:
            raise ParameterError("ends", "frames where the curve is finite", end)
        own = cells[trace_path(window, coded.codes, begin, end, cells) :]
        start = int(own[0, 0])
        found.append(CurvePath(start, np.interp(np.arange(start, end + 1), own[:, 0], own[:, 1])))
    return found


@nb.njit(cache=True, nogil=True)
def trace_path(window: Window, codes: I32, begin: int, end: int, cells: I64) -> int:
    """Write the frames and columns of the cheapest path to an end of a window into the last rows (kernel).

    Parameters
    ----------
    window : Window
        The sums, see `ops.distances.window_sums.sum_window`.
    codes : int32 array (L,)
        The words.
    begin, end : int
        The first frame of the window, and the frame where the path ends.
    cells : int64 array (N, 2)
        Output: frame and column of each cell of the path.

    Returns
    -------
    int
        The first row that is filled.
    """
    sums, costs, row_of, _, _ = window
    frame, n = end - begin, costs.shape[1] - 1
    row = len(cells) - 1
    cells[row, 0], cells[row, 1] = begin + frame, n
    while n > 0:
        frames, columns = step_back(sums, frame, n, costs[row_of[codes[begin + frame]], n])
        frame, n, row = frame - frames, n - columns, row - 1
        cells[row, 0], cells[row, 1] = begin + frame, n
    return row


def essential_minima(starts: I64, ends: I64, costs: F64) -> I64:
    """Return the minima that have no cheaper minimum nearby (thesis, Section 6.4.1).

    Minima are considered in order of ascending cost, then of ascending end. A minimum is dropped if the distance of its
    end to the end of a minimum that was kept is less than half the length of the shorter of the two paths.

    Parameters
    ----------
    starts, ends : int64 array (M,)
        The first and the last frame of the path of each minimum.
    costs : float64 array (M,)
        The distance in its last frame.

    Returns
    -------
    int64 array (E,)
        The indices of the essential minima, the cheapest first.
    """
    taken: list[int] = []
    lengths = ends - starts
    for place in np.lexsort((ends, costs)).tolist():
        others = np.array(taken, np.int64)
        apart = np.abs(ends[others] - ends[place])
        if not (2 * apart < np.minimum(lengths[others], lengths[place])).any():
            taken.append(place)
    return np.array(taken, np.int64)
