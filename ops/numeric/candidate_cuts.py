"""This module finds the frames of a take at which a motion may begin or end.

It follows the most probable sequence of motions and background through the rows of states of all classes, at several
costs of switching, in one pass over the frames; for each column it keeps the frame in which the motion began, so that
memory for a take does not grow with the number of states.
"""

from __future__ import annotations

from typing import NamedTuple

import numba as nb
import numpy as np

from kinedex.ops.arrays import F32, F64, I32, I64, Bool
from kinedex.ops.numeric.state_columns import StateColumns

SWITCHING = (3.0, 8.0, 20.0, 50.0)
"""Costs at which a change of class is worth while; a cut at any of these is a candidate."""

CUTTING_READINESS = 2.0
"""The evidence of a frame that is added to states, against the background, while candidate cuts are looked for."""


class Candidates(NamedTuple):
    """Candidate cuts of a take of L frames.

    Attributes
    ----------
    cuts : int64 array (N,)
        The frames at which spans may begin or end, in ascending order; 0 and L are among them.
    gains : float64 array (N,)
        The evidence before each cut of the most probable sequence of motions with the least cost of switching.
    background : float32 array (L,)
        The evidence of the background in each frame.
    """

    cuts: I64
    gains: F64
    background: F32


class _Walk(NamedTuple):
    """The most probable sequences of motions up to a frame, for each of K costs, with values relative to the greatest.

    Attributes
    ----------
    entering : float32 array (K + 1, W)
        The negative cost of beginning a class, in the columns of first states, for each of the costs and for no cost;
        −∞ in other columns.
    values : float32 array (K, W + 2)
        The value of the best sequence that ends in each column.
    begins : int32 array (K, W + 2)
        The frame in which the last motion of this sequence begins.
    outside, since : float32 and int32 arrays (K,)
        The same for the background.
    """

    entering: F32
    values: F32
    begins: I32
    outside: F32
    since: I32


def candidate_cuts(projected: F32, columns: StateColumns) -> Candidates:
    """Return the candidate cuts of a take: where the most probable sequence of motions, at some cost, changes.

    Parameters
    ----------
    projected : float32 array (L, d + 1)
        The projected frames of a take, with a 1 appended to each.
    columns : StateColumns
        The states.
    """
    frames, width = len(projected), columns.states.shape[1]
    costs = len(SWITCHING)
    entering = np.full((costs + 1, width), -np.inf, np.float32)
    entering[:, columns.firsts] = -np.array([[*SWITCHING, 0.0]], np.float32).T
    values = np.full((costs, width + 2), -np.inf, np.float32)
    begins = np.zeros((costs, width + 2), np.int32)
    walk = _Walk(entering, values, begins, np.zeros(costs, np.float32), np.zeros(costs, np.int32))
    ended = np.zeros((costs, frames), np.int32)
    gains = np.zeros((costs, frames + 1))
    background = np.empty(frames, np.float32)
    for first, evidence, usual in columns.pieces(projected):
        background[first : first + len(usual)] = usual
        _walk(evidence, usual, columns.lasts, first, walk, ended, gains)
    found = np.zeros(frames + 1, np.bool_)
    found[[0, -1]] = True
    _mark_changes(walk, columns.lasts, ended, gains, found)
    cuts = np.flatnonzero(found)
    return Candidates(cuts, np.cumsum(gains[0])[cuts], background)


@nb.njit(cache=True, nogil=True)
def _walk(evidence: F32, usual: F32, lasts: I64, first: int, walk: _Walk, ended: I32, gains: F64) -> None:
    """Continue the most probable sequences over some frames (kernel).

    Parameters
    ----------
    evidence : float32 array (n, W)
        The evidence of each column in each frame.
    usual : float32 array (n,)
        The evidence of the background, which is subtracted.
    lasts : int64 array (P,)
        The columns of last states.
    first : int
        The first of the frames, counted from the beginning of the take.
    walk : _Walk
        The sequences up to this frame; they are continued.
    ended : int32 array (K, L)
        For each frame of the take, the beginning of the motion that ends before it in the best sequence; written.
    gains : float64 array (K, L + 1)
        Output: by how much the value of the best sequence before each frame exceeds that before the previous frame.
    """
    for t in range(len(evidence)):
        at = first + t
        for cost in range(len(walk.values)):
            values, begins = walk.values[cost], walk.begins[cost]
            end, begin = walk.outside[cost], walk.since[cost]
            for last in lasts:
                if values[last] > end:
                    end, begin = values[last], begins[last]
            ended[cost, at] = begin
            gains[cost, at] = end
            entering = walk.entering[cost if at > 0 else -1]
            more = np.float32(CUTTING_READINESS) - usual[t]
            _step_with_begins(values, begins, evidence[t], entering, end, more, np.int32(at))
            walk.outside[cost] -= end
            if at > 0 and -np.float32(SWITCHING[cost]) > walk.outside[cost]:
                walk.outside[cost], walk.since[cost] = -np.float32(SWITCHING[cost]), at


@nb.njit(cache=True, nogil=True)
def _step_with_begins(values: F32, begins: I32, evidence: F32, entering: F32, end: float, more: float, at: int) -> None:
    """Advance the best path into each column by one frame, with the beginning of its last motion (kernel).

    Parameters
    ----------
    values, begins : float32 and int32 arrays (W + 2,)
        The value of the best path into each column, and the beginning of its last motion; they are replaced by those of
        the next frame, less the value `end`.
    evidence : float32 array (W,)
        The evidence of each column in the next frame.
    entering : float32 array (W,)
        The negative cost of beginning a motion in each column.
    end : float
        The value of the best path that may be followed by another motion.
    more : float
        What is added to all evidence.
    at : int
        The next frame.
    """
    for i in range(len(evidence)):
        best, begin = values[i], begins[i]
        # All are read first, so that the loop has no branches and is compiled to vector instructions.
        one, two, one_begin, two_begin = values[i + 1], values[i + 2], begins[i + 1], begins[i + 2]
        new = entering[i] + end
        begin = one_begin if one > best else begin
        best = one if one > best else best
        begin = two_begin if two > best else begin
        best = two if two > best else best
        begin = at if new > best else begin
        best = new if new > best else best
        values[i] = (best - end) + (evidence[i] + more)
        begins[i] = begin


@nb.njit(cache=True, nogil=True)
def _mark_changes(walk: _Walk, lasts: I64, ended: I32, gains: F64, found: Bool) -> None:
    """Mark the frames in which motions of the best sequences begin, and note the value of these sequences (kernel)."""
    frames = ended.shape[1]
    for cost in range(len(ended)):
        state = int(np.argmax(walk.values[cost]))
        best, begin = walk.values[cost, state], walk.begins[cost, state]
        if walk.outside[cost] > best:
            best, begin = walk.outside[cost], walk.since[cost]
        while begin > 0:
            found[begin] = True
            begin = ended[cost, begin]
        gains[cost, frames] = walk.outside[cost]
        for last in lasts:
            gains[cost, frames] = max(gains[cost, frames], walk.values[cost, last])
