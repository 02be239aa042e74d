"""This module divides a take into spans with classes: the spans between candidate cuts, and the best chain of them.

A span has a score for each class: the evidence of the class's row of states along the best path, and the span's worth,
which says how well it fits the class as a whole. The best chain has the greatest sum of scores; frames may be left out
of it. Paths are only computed if an upper bound of their evidence allows the span to be part of the chain.
"""

from __future__ import annotations

from typing import NamedTuple

import numba as nb
import numpy as np

from kinedex.ops.arrays import F32, F64, I64, Bool
from kinedex.ops.numeric.candidate_cuts import CUTTING_READINESS, SWITCHING, Candidates
from kinedex.ops.numeric.state_columns import LANES, StateColumns

LENGTHS = (0.4, 2.2)
"""The shortest and the longest span of a class, as multiples of the usual length of its examples."""

SLACK = 1.0
"""Bounds of evidence are greater by so much, against errors of rounding."""


class Spans(NamedTuple):
    """The spans between candidate cuts with an admissible length of at least one class, ordered by beginning and end.

    Attributes
    ----------
    begins, ends : int64 array (M,)
        The indices of the cuts at which each span begins and ends.
    starts, stops : int64 array (M,)
        The half-open range of frames of each span.
    fits : bool array (M, P)
        True if the length of the span is admissible for the class.
    """

    begins: I64
    ends: I64
    starts: I64
    stops: I64
    fits: Bool


class Chain(NamedTuple):
    """Spans that follow each other.

    Attributes
    ----------
    spans : int64 array (n,)
        The indices of these spans among all spans.
    classes : int64 array (n,)
        The class of each span.
    scores : float64 array (n,)
        The score of each span: the evidence of the path through the states of the class, plus the worth.
    """

    spans: I64
    classes: I64
    scores: F64


class _Evidence(NamedTuple):
    """The evidence of states in those frames that were computed last, and the numbers that it is computed from.

    Attributes
    ----------
    projected : float32 array (L, d + 1)
        The projected frames, with a 1 appended to each.
    background : float32 array (L,)
        The evidence of the background.
    states : float32 array (d + 1, W)
        The columns of states.
    ring : float32 array (R, W)
        The evidence of the last R frames, a power of two; that of frame t is row t modulo R.
    lasts, firsts : int64 array (P,)
        The columns of the last and the first state of each class.
    """

    projected: F32
    background: F32
    states: F32
    ring: F32
    lasts: I64
    firsts: I64


def spans_between(cuts: I64, usual: F64) -> Spans:
    """Return the spans between candidate cuts.

    Parameters
    ----------
    cuts : int64 array (N,)
        The candidate cuts in ascending order.
    usual : float64 array (P,)
        The usual length of each class in frames.
    """
    shortest = np.maximum(np.floor(LENGTHS[0] * usual), 1).astype(np.int64)
    longest = np.floor(LENGTHS[1] * usual).astype(np.int64)
    after = np.searchsorted(cuts, cuts + longest.max(), "right")
    counts = after - np.arange(len(cuts)) - 1
    begins = np.repeat(np.arange(len(cuts)), counts)
    ends = np.arange(len(begins)) - np.repeat(np.cumsum(counts) - counts, counts) + begins + 1
    frames = (cuts[ends] - cuts[begins])[:, None]
    fits = (shortest <= frames) & (frames <= longest)
    kept = np.flatnonzero(fits.any(axis=1))
    begins, ends = begins[kept], ends[kept]
    return Spans(begins, ends, cuts[begins], cuts[ends], fits[kept])


def best_chain(
    projected: F32, columns: StateColumns, candidates: Candidates, spans: Spans, worth: F64, readiness: float
) -> Chain:
    """Return the chain with the greatest sum of scores.

    Of classes with equal scores, the first is chosen for a span.

    Parameters
    ----------
    projected : float32 array (L, d + 1)
        The projected frames of a take, with a 1 appended to each.
    columns : StateColumns
        The states.
    candidates : Candidates
        The candidate cuts.
    spans : Spans
        The spans between them.
    worth : float64 array (M, P)
        What is added to the evidence of a span's path in each class; −∞ for none.
    readiness : float
        The evidence that is added to each frame of a span.
    """
    longest = int((spans.stops - spans.starts).max(initial=1))
    ring = np.empty((1 << (longest - 1).bit_length(), columns.states.shape[1]), np.float32)
    worth = np.where(spans.fits, worth, -np.inf)
    gained = candidates.gains[spans.ends] - candidates.gains[spans.begins] + SWITCHING[0] + SLACK
    bounds = worth + (gained + (readiness - CUTTING_READINESS) * (spans.stops - spans.starts))[:, None]
    evidence = _Evidence(projected, candidates.background, columns.states, ring, columns.lasts, columns.firsts)
    return _chain(evidence, len(candidates.cuts), spans, worth, bounds, np.float32(readiness))


def span_evidence(projected: F32, columns: StateColumns, background: F32, starts: I64, stops: I64, fits: Bool) -> F64:
    """Return the evidence of the best paths through the states of every class in given spans, float64 (n, P).

    It is −∞ where the length of a span is not admissible for a class, and where it is too short for a path from the
    first to the last state.

    Parameters
    ----------
    projected : float32 array (L, d + 1)
        The projected frames of a take, with a 1 appended to each.
    columns : StateColumns
        The states.
    background : float32 array (L,)
        The evidence of the background in each frame.
    starts, stops : int64 array (n,)
        The half-open ranges of the spans, which do not overlap, in ascending order.
    fits : bool array (n, P)
        True if the length of the span is admissible for the class.
    """
    longest = int((stops - starts).max(initial=1))
    ring = np.empty((1 << (longest - 1).bit_length(), columns.states.shape[1]), np.float32)
    evidence = _Evidence(projected, background, columns.states, ring, columns.lasts, columns.firsts)
    return _span_evidence(evidence, starts, stops, fits)


@nb.njit(cache=True, nogil=True)
def _span_evidence(evidence: _Evidence, starts: I64, stops: I64, fits: Bool) -> F64:
    """Return the evidence of every class in given spans, float64 (n, P) (kernel); see `span_evidence`."""
    classes = len(evidence.firsts)
    computed = np.zeros(classes, np.int64)
    found = np.full((len(starts), classes), -np.inf)
    for n in range(len(starts)):
        for k in range(classes):
            if fits[n, k]:
                found[n, k] = _paths(evidence, k, starts[n], stops[n : n + 1], computed, np.float32(0.0))[0]
    return found


@nb.njit(cache=True, nogil=True)
def _chain(evidence: _Evidence, cuts: int, spans: Spans, worth: F64, bounds: F64, readiness: float) -> Chain:
    """Return the best chain (kernel).

    Chains are extended cut by cut. The paths of a class from a cut are found, all at once, if the bound of one of its
    spans is above the best chain that is known to end at the same cut.

    Parameters
    ----------
    evidence : _Evidence
        The evidence of states.
    cuts : int
        The number N of candidate cuts.
    spans : Spans
        The spans between candidate cuts.
    worth, bounds : float64 array (M, P)
        What is added to the evidence of a path, and a bound of their sum.
    readiness : float
        The evidence that is added to each frame.
    """
    classes = worth.shape[1]
    computed = np.zeros(classes, np.int64)
    best = np.zeros(cuts)  # the value of the best chain up to each cut
    value = np.full(cuts, -np.inf)  # that of the best whose last span ends there, and this span
    chosen, kinds, scores = np.full(cuts, -1, np.int64), np.zeros(cuts, np.int64), np.zeros(cuts)
    stop = 0
    for i in range(cuts):
        if i > 0:
            best[i] = max(best[i - 1], value[i])
        first = stop
        while stop < len(spans.begins) and spans.begins[stop] == i:
            stop += 1
        if stop == first:
            continue
        likely = int(np.argmax(bounds[first:stop])) % classes
        for turn in range(classes):
            k = likely if turn == 0 else turn - 1 if turn <= likely else turn
            reach = first
            highest = best[i]
            for m in range(first, stop):
                highest = max(highest, value[spans.ends[m]])
                if best[i] + bounds[m, k] > highest:
                    reach = m + 1
            if reach == first:
                continue
            paths = _paths(evidence, k, spans.starts[first], spans.stops[first:reach], computed, readiness)
            for m in range(first, reach):
                end, score = spans.ends[m], paths[m - first] + worth[m, k]
                found = best[i] + score
                if found > value[end] or (found == value[end] and chosen[end] == m and k < kinds[end]):
                    value[end], chosen[end], kinds[end], scores[end] = found, m, k, score
    return _traced(spans.begins, best, value, Chain(chosen, kinds, scores))


@nb.njit(cache=True, nogil=True)
def _traced(begins: I64, best: F64, value: F64, last: Chain) -> Chain:
    """Return the chain that ends at the last cut (kernel).

    Parameters
    ----------
    begins : int64 array (M,)
        The cut at which each span begins.
    best, value : float64 array (N,)
        The value of the best chain up to each cut, and of the best whose last span ends there.
    last : Chain
        This last span for each of the N cuts.
    """
    ends = np.empty(len(best), np.int64)
    count, at = 0, len(best) - 1
    while at > 0:
        if value[at] > best[at - 1]:
            ends[count] = at
            count += 1
            at = begins[last.spans[at]]
        else:
            at -= 1
    ends = ends[:count][::-1]
    return Chain(last.spans[ends], last.classes[ends], last.scores[ends])


@nb.njit(cache=True, nogil=True)
def _paths(evidence: _Evidence, k: int, start: int, stops: I64, computed: I64, readiness: float) -> F64:
    """Return the evidence of the best paths through the states of a class from a frame to others (kernel).

    Parameters
    ----------
    evidence : _Evidence
        The evidence of states.
    k : int
        The class.
    start : int
        The first frame of all paths.
    stops : int64 array (n,)
        The frame after the last one of each path, ascending.
    computed : int64 array (P,)
        The frame up to which the ring has the evidence of each class; it is continued.
    readiness : float
        The evidence that is added to each frame.

    Returns
    -------
    float64 array (n,)
        −∞ where no path from the first to the last state is so short.
    """
    last, first = evidence.lasts[k], evidence.firsts[k]
    behind = (
        last + -(-(first - last + 1) // LANES) * LANES
    )  # columns of the next class make vectors whole, and do no harm
    values = np.full(behind - last + 2, -np.inf, np.float32)
    found = np.empty(len(stops))
    states = evidence.states[:, last:behind].copy()
    slots = len(evidence.ring) - 1  # a power of two, less one
    for t in range(max(start, computed[k]), stops[-1]):
        row = evidence.ring[t & slots, last:behind]
        _fill_row(evidence.projected[t], evidence.background[t], states, row)
    computed[k] = max(computed[k], stops[-1])
    values[first - last] = evidence.ring[start & slots, first] + readiness
    t = start + 1
    for n in range(len(stops)):
        while t < stops[n]:
            _step(values, evidence.ring[t & slots, last:behind], readiness)
            t += 1
        found[n] = values[0]
    return found


@nb.njit(cache=True, nogil=True)
def _step(values: F32, evidence: F32, readiness: float) -> None:
    """Advance the best path into each column by one frame, in place (kernel)."""
    for i in range(len(evidence)):
        one, two, best = values[i + 1], values[i + 2], values[i]
        best = one if one > best else best
        best = two if two > best else best
        values[i] = best + evidence[i] + readiness


@nb.njit(cache=True, nogil=True, fastmath={"contract"})
def _fill_row(projected: F32, background: float, states: F32, row: F32) -> None:
    """Compute the evidence of a frame in some columns (kernel).

    Parameters
    ----------
    projected : float32 array (d + 1,)
        The projected frame, with a 1 appended.
    background : float
        The evidence of the background.
    states : float32 array (d + 1, n)
        The columns.
    row : float32 array (n,)
        The evidence; it is written.
    """
    directions = len(projected) - 1
    constants = states[directions]
    for i in range(len(row)):
        row[i] = constants[i] - background
    whole = directions - directions % 4
    for d in range(0, whole, 4):  # four directions at a time, as reading and writing the row costs more than products
        a, b, c, e = projected[d], projected[d + 1], projected[d + 2], projected[d + 3]
        one, two, three, four = states[d], states[d + 1], states[d + 2], states[d + 3]
        for i in range(len(row)):
            row[i] += a * one[i] + b * two[i] + c * three[i] + e * four[i]
    for d in range(whole, directions):
        for i in range(len(row)):
            row[i] += projected[d] * states[d, i]
