"""These kernels perform the dynamic programming of `decoding`: a forward pass over all frames, and the backtracking.

The columns of all templates are concatenated, with `MAX_STEP` empty columns before each template, so that one loop
without branches covers all templates. The log ratios of a frame are computed from those of the previous frame by adding
the differences of the few features that changed. They are recomputed in full from time to time, so that rounding errors
do not accumulate.
"""

from __future__ import annotations

from typing import NamedTuple

import numba as nb
import numpy as np

from kinedex.ops.arrays import F64, I64, U64, Bool
from kinedex.ops.bits import lowest_bit
from kinedex.ops.words import NO_WORD

MAX_STEP = 3
"""The longest step of a path, in columns and in frames."""

TOLERANCE = 1e-9
"""Values that differ by less than this count as equal."""

_RING = 4  # rows of the ring buffer: the current frame and the three before it
_ANEW = 64  # changes after which log ratios are recomputed from all features
_ONE = np.uint64(1)


class Columns(NamedTuple):
    """The columns of T templates, concatenated.

    Parameters
    ----------
    slopes : float64 array (f, C)
        The amount by which a feature that is on changes a column's log ratio.
    intercepts : float64 array (C,)
        The log ratio of a word without features, −∞ in the empty columns.
    firsts, lengths : int64 array (T,)
        The first column of each template, and the number of its columns.
    """

    slopes: F64
    intercepts: F64
    firsts: I64
    lengths: I64


class Frames(NamedTuple):
    """The frames of a take.

    Parameters
    ----------
    words : uint64 array (L,)
        The words of the frames.
    offsets : float64 array (L,)
        The amount that is added to the log ratios of all columns in each frame.
    """

    words: U64
    offsets: F64


class Costs(NamedTuple):
    """The costs of `ops.annotation.decoding.Decoding` as a tuple for kernels."""

    entry: float
    skip: float
    stay: float


@nb.njit(cache=True, nogil=True)
def forwards(
    frames: Frames, columns: Columns, costs: Costs, allowed: Bool, changes: I64, origins: I64
) -> tuple[F64, I64]:
    """Return the greatest value of an explanation of the frames before each frame (kernel).

    Parameters
    ----------
    frames : Frames
        The frames of the take.
    columns : Columns
        The columns of the templates.
    costs : Costs
        The costs of an explanation.
    allowed : bool array (T, L) or (T, 0)
        The frames in which each template may occur; if the array has no frames, templates may occur everywhere.
    changes : int64 array
        The frames in which `allowed` differs from the previous frame, ascending; the first is 0 and the last is L.
    origins : int64 array
        For each change but the last, the frame from which log ratios are computed, at least two frames before the
        change.

    Returns
    -------
    value : float64 array (L + 1,)
        The greatest value of an explanation of the frames before each frame.
    winner : int64 array (L + 1,)
        The template whose segment ends before each frame in the best explanation; −1 for background.
    """
    count = len(frames.words)
    value, winner = np.zeros(count + 1), np.full(count + 1, -1, np.int64)
    scores, rows = np.full((_RING, len(columns.intercepts)), -np.inf), np.zeros((_RING, len(columns.intercepts)))
    active = np.zeros(len(columns.firsts), np.bool_)
    for part in range(len(changes) - 1):
        start, stop = changes[part], changes[part + 1]
        for template in range(len(active)):
            now = allowed.shape[1] == 0 or allowed[template, start]
            if now and not active[template]:
                first = columns.firsts[template]
                scores[:, first : first + columns.lengths[template]] = -np.inf
            active[template] = now
        advance(frames, origins[part], start, stop, columns, costs, active, scores, rows, value, winner)
    return value, winner


@nb.njit(cache=True, nogil=True)
def recomputed_at(words: U64) -> I64:
    """Return for each frame the last frame, not after it, in which log ratios are recomputed in full (kernel).

    If `advance` starts in this frame, it computes the same log ratios as from the beginning of the take, to the last
    bit.
    """
    result = np.zeros(len(words), np.int64)
    changed, last = _ANEW, 0
    for frame in range(len(words)):
        if frame == 0 or words[frame] != words[frame - 1]:
            if frame == 0 or changed >= _ANEW or words[frame - 1] == NO_WORD:
                changed, last = 0, frame
            else:
                changed += 1
        result[frame] = last
    return result


@nb.njit(cache=True, nogil=True)
def rival_values(frames: Frames, columns: Columns, costs: Costs, rivals: Bool, starts: I64, stops: I64) -> F64:
    """Return, for each segment, the greatest value that its rival templates reach (kernel).

    Parameters
    ----------
    frames : Frames
        The frames of the take.
    columns : Columns
        The columns of the templates.
    costs : Costs
        The costs of an explanation.
    rivals : bool array (S, T)
        The templates that are compared with each segment.
    starts, stops : int64 array (S,)
        The half-open range of each segment.
    """
    result = np.zeros(len(starts))
    value, winner = np.zeros(len(frames.words) + 1), np.zeros(len(frames.words) + 1, np.int64)
    scores, rows = np.full((_RING, len(columns.intercepts)), -np.inf), np.zeros((_RING, len(columns.intercepts)))
    for index in range(len(starts)):
        start, stop = starts[index], stops[index]
        value[start] = 0.0
        for template in range(len(columns.firsts)):
            if rivals[index, template]:
                first = columns.firsts[template]
                scores[:, first : first + columns.lengths[template]] = -np.inf
        origin = max(start - MAX_STEP + 1, 0)
        advance(frames, origin, start, stop, columns, costs, rivals[index], scores, rows, value, winner)
        result[index] = value[stop]
    return result


@nb.njit(cache=True, nogil=True)
def advance(
    frames: Frames,
    origin: int,
    start: int,
    stop: int,
    columns: Columns,
    costs: Costs,
    active: Bool,
    scores: F64,
    rows: F64,
    value: F64,
    winner: I64,
) -> None:
    """Continue the forward pass over frames [start, stop) with the active templates (kernel).

    Parameters
    ----------
    frames : Frames
        The frames of the take.
    origin : int
        The frame from which log ratios are computed.
    start, stop : int
        The half-open range of frames.
    columns : Columns
        The columns of the templates.
    costs : Costs
        The costs of an explanation.
    active : bool array (T,)
        True for the templates that may occur in these frames.
    scores : float64 array (4, C)
        The best value of a path to each column in frame f, in row f mod 4.
    rows : float64 array (4, C)
        Memory for log ratios.
    value, winner : array (L + 1,)
        See `forwards`; value[start] is given.
    """
    words, offsets = frames
    spans = _spans(columns, active)
    once = twice = slot = 0
    changed = _ANEW
    for frame in range(origin, stop):
        begins = frame == origin
        once, twice = slot, once
        if begins or words[frame] != words[frame - 1]:
            slot = 0
            while slot in (once, twice):
                slot += 1
            anew = begins or changed >= _ANEW or words[frame - 1] == NO_WORD
            changed = 0 if anew else changed + 1
            for first, end in spans:
                here = rows[slot, first:end]
                if words[frame] == NO_WORD:
                    here[:] = -np.inf
                elif anew:
                    sum_ratios(here, words[frame], offsets[frame], columns, first)
                else:
                    before = rows[once, first:end]
                    difference = offsets[frame] - offsets[frame - 1]
                    change_ratios(here, before, words[frame - 1], words[frame], difference, columns.slopes, first)
        if frame < start:
            continue
        here, last = scores[frame % _RING], scores[(frame - 1) % _RING]
        second, third = scores[(frame - 2) % _RING], scores[(frame - 3) % _RING]
        for first, end in spans:
            inner = slice(first + MAX_STEP, end)
            step(
                here[inner], rows[slot, inner], rows[once, inner], rows[twice, inner],
                last[first:end], second[first:end], third[first:end], costs.skip,
            )  # fmt: skip
        greatest, ends = value[frame], -1
        for template in range(len(active)):
            if active[template]:
                first = columns.firsts[template]
                end = first + columns.lengths[template] - 1
                here[first] = max(last[first] - costs.stay, value[frame] - costs.entry) + rows[slot, first]
                here[end] = max(here[end], last[end] - costs.stay + rows[slot, end])
                if here[end] > greatest:
                    greatest, ends = here[end], template
        value[frame + 1] = greatest
        winner[frame + 1] = ends


@nb.njit(cache=True, nogil=True)
def _spans(columns: Columns, active: Bool) -> list[tuple[int, int]]:
    """Return the column ranges of active templates with the empty columns before them; adjacent ranges are merged."""
    found = [(0, 0)]
    for template in range(len(active)):
        if active[template]:
            first = columns.firsts[template] - MAX_STEP
            end = columns.firsts[template] + columns.lengths[template]
            if found[-1][1] == first:
                found[-1] = (found[-1][0], end)
            else:
                found.append((first, end))
    return found if found[0][1] else found[1:]


@nb.njit(cache=True, nogil=True)
def sum_ratios(row: F64, word: np.uint64, offset: float, columns: Columns, first: int) -> None:
    """Write into `row` the log ratios of a word, for the columns that begin with `first`."""
    end = first + len(row)
    intercepts = columns.intercepts[first:end]
    for n in range(len(row)):
        row[n] = intercepts[n] + offset
    while word:
        slope, word = columns.slopes[lowest_bit(word), first:end], word & (word - _ONE)
        if word:  # two at a time, in the order of the features
            other, word = columns.slopes[lowest_bit(word), first:end], word & (word - _ONE)
            for n in range(len(row)):
                row[n] = (row[n] + slope[n]) + other[n]
        else:
            for n in range(len(row)):
                row[n] += slope[n]


@nb.njit(cache=True, nogil=True)
def change_ratios(
    row: F64, before: F64, old: np.uint64, new: np.uint64, difference: float, slopes: F64, first: int
) -> None:
    """Fill in the log ratios of a word by updating the ratios of the previous word, in double or single precision.

    Parameters
    ----------
    row : float64 or float32 array
        The results, for the columns from the first on.
    before : float64 or float32 array
        The log ratios of the previous word.
    old, new : uint64
        The previous word, and the word.
    difference : float
        The offset of the frame minus that of the previous frame.
    slopes : float64 or float32 array (f, C)
        See `Columns`.
    first : int
        The first column.
    """
    flipped, end, one = old ^ new, first + len(row), slopes.dtype.type(1.0)
    if not flipped:
        for n in range(len(row)):
            row[n] = before[n] + difference
        return
    bit = lowest_bit(flipped)
    flipped &= flipped - _ONE
    slope, sign = slopes[bit, first:end], one if (new >> np.uint64(bit)) & _ONE else -one
    for n in range(len(row)):
        row[n] = (before[n] + difference) + sign * slope[n]
    while flipped:
        bit = lowest_bit(flipped)
        flipped &= flipped - _ONE
        slope, sign = slopes[bit, first:end], one if (new >> np.uint64(bit)) & _ONE else -one
        for n in range(len(row)):
            row[n] += sign * slope[n]


@nb.njit(cache=True, nogil=True)
def step(here: F64, now: F64, once: F64, twice: F64, last: F64, second: F64, third: F64, skip: float) -> None:
    """Fill in the best value of every column but the first three, from the previous frames, without branches.

    Parameters
    ----------
    here : float64 or float32 array
        The results.
    now, once, twice : float64 or float32 array
        Log ratios in this frame and the two before it, without the first three columns.
    last, second, third : float64 or float32 array
        Best values in the three previous frames.
    skip : float
        The cost of a skipped column.
    """
    for n in range(len(here)):
        best = last[n + 2]
        other = last[n + 1] - skip
        best = other if other > best else best
        other = last[n] - (skip + skip)
        best = other if other > best else best
        other = second[n + 2] + once[n]
        best = other if other > best else best
        other = third[n + 2] + (twice[n] + once[n])
        best = other if other > best else best
        here[n] = best + now[n]


@nb.njit(cache=True, nogil=True)
def backwards(
    frames: Frames, columns: Columns, costs: Costs, allowed: Bool, value: F64, winner: I64
) -> list[tuple[int, int, int]]:
    """Return the segments of the best explanation as (start, stop, template), the last one first (kernel).

    Parameters
    ----------
    frames, columns, costs, allowed
        As in `forwards`.
    value, winner : array (L + 1,)
        The result of `forwards`.
    """
    found = [(0, 0, 0)]
    at = len(frames.words)
    while at > 0:
        if winner[at] < 0:
            at -= 1
            continue
        start = _begin(frames, columns, costs, allowed, value, winner[at], at)
        found.append((start, at, winner[at]))
        at = start
    return found[1:]


@nb.njit(cache=True, nogil=True)
def _begin(frames: Frames, columns: Columns, costs: Costs, allowed: Bool, value: F64, template: int, stop: int) -> int:
    """Return the first frame of a template's segment that ends before `stop`.

    The forward pass over all templates does not keep the values of columns. Therefore the values of this template are
    computed again, in a window that grows until it contains a segment of the known value.
    """
    first, length = columns.firsts[template], columns.lengths[template]
    window = 2 * length
    while True:
        start = max(stop - window, 0)
        count = stop - start
        scores, rows = (
            np.full((count + MAX_STEP, length + MAX_STEP), -np.inf),
            np.full((count, length + MAX_STEP), -np.inf),
        )
        for place in range(count):
            frame = start + place
            here, last = scores[place + MAX_STEP], scores[place + MAX_STEP - 1]
            if frames.words[frame] == NO_WORD or (allowed.shape[1] > 0 and not allowed[template, frame]):
                continue
            if place > 0 and frames.words[frame] == frames.words[frame - 1] and rows[place - 1, -1] > -np.inf:
                rows[place] = rows[place - 1]
            else:
                sum_ratios(rows[place], frames.words[frame], frames.offsets[frame], columns, first - MAX_STEP)
            now = rows[place, MAX_STEP:]
            once, twice = rows[max(place - 1, 0), MAX_STEP:], rows[max(place - 2, 0), MAX_STEP:]
            step(here[MAX_STEP:], now, once, twice, last, scores[place + 1], scores[place], costs.skip)
            here[MAX_STEP] = max(last[MAX_STEP] - costs.stay, value[frame] - costs.entry) + now[0]
            here[-1] = max(here[-1], last[-1] - costs.stay + now[-1])
        if start == 0 or scores[-1, -1] >= value[stop] - TOLERANCE:
            return start + _trace(scores, rows, costs, value[start:stop])
        window *= 2


@nb.njit(cache=True, nogil=True)
def _trace(scores: F64, rows: F64, costs: Costs, value: F64) -> int:
    """Return the row in which the best path to the last row and column begins, by backtracking.

    `scores` has `MAX_STEP` rows more than `rows`.
    """
    place, n = len(rows) - 1, rows.shape[1] - 1
    while True:
        best, back, columns = -np.inf, 0, 0
        if n == MAX_STEP:
            best = value[place] - costs.entry
        before = place + MAX_STEP - 1
        if n in (MAX_STEP, rows.shape[1] - 1) and scores[before, n] - costs.stay > best:
            best, back, columns = scores[before, n] - costs.stay, 1, 0
        for left_out in range(MAX_STEP):
            other = scores[before, n - 1 - left_out] - costs.skip * left_out
            if other > best:
                best, back, columns = other, 1, 1 + left_out
        spent = 0.0
        for lasts in range(2, MAX_STEP + 1):
            spent += rows[max(place - lasts + 1, 0), n]
            other = scores[place + MAX_STEP - lasts, n - 1] + spent
            if other > best:
                best, back, columns = other, lasts, 1
        if back == 0:
            return place
        place, n = place - back, n - columns
