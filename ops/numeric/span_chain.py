"""This module divides a take into spans with classes: candidate cuts, scores of all spans, and the best chain.

A span between two candidate cuts has a score for each class: the evidence of the class's row of states along the best
path, and how well the span as a whole fits the class. The best chain has the greatest sum of scores; frames may be left
out of it.
"""

from __future__ import annotations

from typing import NamedTuple

import numba as nb
import numpy as np

from kinedex.ops.arrays import F64, I64, Bool

SWITCHING = (3.0, 8.0, 20.0, 50.0)
"""Costs at which a change of class is worth while; a cut at any of these is a candidate."""

CUTTING_READINESS = 2.0
"""The evidence of a frame that is added to states, against the background, while candidate cuts are looked for."""

LENGTHS = (0.4, 2.2)
"""The shortest and the longest span of a class, as multiples of the usual length of its examples."""


class Spans(NamedTuple):
    """Spans between candidate cuts.

    Attributes
    ----------
    starts, stops : int64 array (N,)
        The frames of each span, stop excluded; ordered by stop.
    scores : float64 array (N, P)
        The score of each class, −∞ where the length is none of the class.
    """

    starts: I64
    stops: I64
    scores: F64


def candidate_cuts(evidence: F64, firsts: I64) -> I64:
    """Return the frames at which spans may begin or end, in ascending order; 0 and the length are among them.

    Parameters
    ----------
    evidence : float64 array (L, S)
        The evidence of each state in each frame.
    firsts : int64 array (P + 1,)
        The first state of each class, and S.
    """
    found = np.zeros(len(evidence) + 1, np.bool_)
    found[[0, -1]] = True
    for cost in SWITCHING:
        found[:-1] |= changes_of_class(evidence, firsts, CUTTING_READINESS, cost)
    return np.flatnonzero(found)


def aligned_spans(evidence: F64, firsts: I64, cuts: I64, usual: F64, readiness: float) -> Spans:
    """Return all spans between candidate cuts with the evidence of each class's states along the best path.

    Parameters
    ----------
    evidence : float64 array (L, S)
        The evidence of each state in each frame.
    firsts : int64 array (P + 1,)
        The first state of each class, and S.
    cuts : int64 array (N,)
        The candidate cuts in ascending order.
    usual : float64 array (P,)
        The usual length of each class in frames.
    readiness : float
        The evidence that is added to each frame of a span.
    """
    shortest = np.maximum(np.floor(LENGTHS[0] * usual), 1).astype(np.int64)
    longest = np.floor(LENGTHS[1] * usual).astype(np.int64)
    after = np.searchsorted(cuts, cuts + longest.max(), "right")
    begins = np.repeat(np.arange(len(cuts)), after - np.arange(len(cuts)) - 1)
    ends = np.concatenate([np.arange(i + 1, last) for i, last in enumerate(after.tolist())])
    scores = path_evidence(evidence, firsts, cuts, begins, ends, shortest, longest, readiness)
    kept = np.flatnonzero(np.isfinite(scores).any(axis=1))
    order = kept[np.argsort(ends[kept], kind="stable")]
    return Spans(cuts[begins[order]], cuts[ends[order]], scores[order])


def best_chain(spans: Spans, frames: int) -> I64:
    """Return the spans of the chain with the greatest sum of scores, in their order, int64 (n,).

    Parameters
    ----------
    spans : Spans
        The spans, ordered by stop.
    frames : int
        The length of the take.
    """
    return _chain(spans.starts, spans.stops, spans.scores.max(axis=1, initial=-np.inf), frames)


@nb.njit(cache=True, nogil=True)
def changes_of_class(evidence: F64, firsts: I64, readiness: float, cost: float) -> Bool:
    """Return where the most probable sequence of states and background begins another motion (kernel).

    Parameters
    ----------
    evidence : float64 array (L, S)
        The evidence of each state in each frame; the background's is 0.
    firsts : int64 array (P + 1,)
        The first state of each class, and S.
    readiness : float
        The evidence that is added to every state.
    cost : float
        The cost of beginning a class, or the background.

    Returns
    -------
    bool array (L,)
        True in the first frame of each motion, and of each stretch of background.
    """
    frames, states = evidence.shape
    classes = len(firsts) - 1
    value = np.full(states + 1, -np.inf)
    value[states] = 0.0
    for k in range(classes):
        value[firsts[k]] = evidence[0, firsts[k]] + readiness
    steps = np.zeros((frames, states + 1), np.int8)  # 0 to 2 states ahead, 3 for what begins
    ended = np.zeros(frames, np.int64)  # the state from which what begins in a frame comes
    for t in range(1, frames):
        end = states
        for k in range(classes):
            if value[firsts[k + 1] - 1] > value[end]:
                end = firsts[k + 1] - 1
        ended[t] = end
        begun = value[end] - cost
        for k in range(classes):
            first = firsts[k]
            for s in range(firsts[k + 1] - 1, first - 1, -1):
                best, step = value[s], 0
                if s >= first + 1 and value[s - 1] > best:
                    best, step = value[s - 1], 1
                if s >= first + 2 and value[s - 2] > best:
                    best, step = value[s - 2], 2
                if s == first and begun > best:
                    best, step = begun, 3
                value[s] = best + evidence[t, s] + readiness
                steps[t, s] = step
        if begun > value[states]:
            value[states] = begun
            steps[t, states] = 3
    found = np.zeros(frames, np.bool_)
    state = int(np.argmax(value))
    for t in range(frames - 1, -1, -1):
        step = steps[t, state]
        if step == 3:
            found[t] = True
            state = ended[t]
        else:
            state -= step
    found[0] = True
    return found


@nb.njit(cache=True, nogil=True)
def path_evidence(
    evidence: F64, firsts: I64, cuts: I64, begins: I64, ends: I64, shortest: I64, longest: I64, readiness: float
) -> F64:
    """Return the evidence of each class along the best path through its states in each span (kernel).

    Parameters
    ----------
    evidence : float64 array (L, S)
        The evidence of each state in each frame.
    firsts : int64 array (P + 1,)
        The first state of each class, and S.
    cuts : int64 array (N,)
        The candidate cuts.
    begins, ends : int64 array (M,)
        The cuts at which each span begins and ends; spans with one beginning follow each other by ascending end.
    shortest, longest : int64 array (P,)
        The fewest and the most frames of each class.
    readiness : float
        The evidence that is added to each frame.

    Returns
    -------
    float64 array (M, P)
        −∞ where the length is none of the class, or no path fits.
    """
    classes = len(firsts) - 1
    found = np.full((len(begins), classes), -np.inf)
    for k in range(classes):
        first, states = firsts[k], firsts[k + 1] - firsts[k]
        value = np.empty(states)
        at = 0
        begun = -1
        for i in range(len(begins)):
            start, stop = cuts[begins[i]], cuts[ends[i]]
            if begins[i] != begun:
                begun = begins[i]
                value[:] = -np.inf
                value[0] = evidence[start, first] + readiness
                at = start + 1
            if stop - start > longest[k]:
                continue
            while at < stop:
                for s in range(states - 1, -1, -1):
                    best = value[s]
                    if s >= 1 and value[s - 1] > best:
                        best = value[s - 1]
                    if s >= 2 and value[s - 2] > best:
                        best = value[s - 2]
                    value[s] = best + evidence[at, first + s] + readiness
                at += 1
            if stop - start >= shortest[k]:
                found[i, k] = value[states - 1]
    return found


@nb.njit(cache=True, nogil=True)
def _chain(starts: I64, stops: I64, scores: F64, frames: int) -> I64:
    best = np.zeros(frames + 1)
    chosen = np.full(frames + 1, -1, np.int64)
    span = 0
    for t in range(1, frames + 1):
        best[t] = best[t - 1]
        while span < len(stops) and stops[span] == t:
            value = best[starts[span]] + scores[span]
            if value > best[t]:
                best[t] = value
                chosen[t] = span
            span += 1
    found = np.empty(len(stops), np.int64)
    count = 0
    t = frames
    while t > 0:
        if chosen[t] < 0:
            t -= 1
        else:
            found[count] = chosen[t]
            count += 1
            t = starts[chosen[t]]
    return found[:count][::-1].copy()
