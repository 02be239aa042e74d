"""This module finds the promising ranges of a template, outside of which decoding can skip the template.

A promising range contains the frames in which the template could have a segment in the best explanation of a take
(`ops.annotation.decoding`). The best value of the first n frames never decreases with n, so every segment of the best
explanation has a value above 0. The value of a segment depends only on its template and the words, so promising ranges
are computed once for each template, and remain valid when other templates are learned.

Every template is first compared with all frames in single precision, with a tolerance for rounding. Where a positive
value is possible, the comparison is repeated in double precision, together with the first frame of each path.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numba as nb
import numpy as np

from kinedex.ops.annotation.decoding import Decoding, concatenated_columns, frames_of
from kinedex.ops.annotation.decoding_kernels import MAX_STEP, Columns, Costs, Frames, change_ratios, step, sum_ratios
from kinedex.ops.arrays import F32, F64, I64, U64
from kinedex.ops.templates.templates import Template
from kinedex.ops.words import NO_WORD

_GROUP_COLUMNS, _GROUP_TEMPLATES = 1024, 128
"""Maximum number of columns and templates that are compared with a take together, so that the working set stays in the
cache.
"""

_SLACK, _SLACK_COLUMN = 1e-3, 1e-5
"""Slack for rounding in single precision: of a value, and in addition for each of a template's columns."""

_ANEW = 64
_ONE = np.uint64(1)


@dataclass(frozen=True)
class Group:
    """A group of templates that are compared with a take together.

    Attributes
    ----------
    first : int
        The index of the group's first template.
    columns : Columns
        The concatenated columns of its templates.
    slopes : float32 array (f, C)
        `columns.slopes` in single precision.
    intercepts : float32 array (C,)
        `columns.intercepts` in single precision.
    """

    first: int
    columns: Columns
    slopes: F32
    intercepts: F32


def template_groups(templates: Sequence[Template], usual: F64, decoding: Decoding) -> list[Group]:
    """Arrange templates in groups for `promising_ranges`; reuse the groups for many takes.

    Parameters
    ----------
    templates : sequence of Template
        T templates.
    usual : float64 array (K, f)
        The usual postures, see `ops.annotation.background.background`.
    decoding : Decoding
        The parameters of decoding.

    Raises
    ------
    ParameterError
        If the templates have different numbers of features.
    """
    edges, columns = [0], 0
    for place, length in enumerate(map(len, templates)):
        if place > edges[-1] and (columns + length > _GROUP_COLUMNS or place - edges[-1] >= _GROUP_TEMPLATES):
            edges.append(place)
            columns = 0
        columns += length
    groups = []
    for first, stop in pairwise([*edges, len(templates)]) if templates else ():
        laid = concatenated_columns(templates[first:stop], usual, decoding)
        groups.append(Group(first, laid, laid.slopes.astype(np.float32), laid.intercepts.astype(np.float32)))
    return groups


def promising_ranges(groups: Sequence[Group], usual: F64, words: U64, decoding: Decoding) -> I64:
    """Return the ranges of a take in which each template could have a segment in the explanation.

    Parameters
    ----------
    groups : sequence of Group
        The templates, see `template_groups`.
    usual : float64 array (K, f)
        The usual postures, see `ops.annotation.background.background`.
    words : uint64 array (L,)
        The words of the take.
    decoding : Decoding
        The parameters of decoding.

    Returns
    -------
    int64 array (R, 3)
        Template, start and stop of each range, by template and start; ranges of a template are disjoint. The best
        explanation within these ranges has the same value as without restriction. (Among paths of a template that end
        in the same frame, a later beginning leaves at least as good an explanation of the frames before it. A path with
        a lower value that begins earlier is thus never needed, and the path of the greatest value gives the range.)
    """
    found = [np.empty((0, 3), np.int64)]
    if len(words):
        frames = frames_of(words, usual, decoding)
        offsets = frames.offsets.astype(np.float32)
        for group in groups:
            laid, costs = group.columns, decoding.costs
            single = (group.slopes, group.intercepts, laid.firsts, laid.lengths)
            ends, begins = _scan(frames.words, offsets, *single, costs)
            ranges = _ranges(frames, laid, costs, ends, begins)
            ranges[:, 0] += group.first
            found.append(ranges)
    return np.concatenate(found)


def loose_ranges(groups: Sequence[Group], frames: Frames, decoding: Decoding) -> I64:
    """Return ranges of a take outside of which no path of a template has a positive value, even with rounding errors.

    Parameters
    ----------
    groups, decoding
        As in `promising_ranges`.
    frames : Frames
        The result of `ops.annotation.decoding.frames_of` for the take.

    Returns
    -------
    int64 array (R, 3)
        Ranges as in `promising_ranges`, but wider, because they are computed faster, in single precision only. The
        explanation within these ranges is bit for bit the same as without restriction.
    """
    found = [np.empty((0, 3), np.int64)]
    offsets = frames.offsets.astype(np.float32)
    for group in groups:
        laid, costs = group.columns, decoding.costs
        ends, begins = _scan(frames.words, offsets, group.slopes, group.intercepts, laid.firsts, laid.lengths, costs)
        ranges = _loose(frames, laid, costs, ends, begins)
        ranges[:, 0] += group.first
        found.append(ranges)
    return np.concatenate(found)


@nb.njit(cache=True, nogil=True)
def _scan(
    words: U64, offsets: F32, slopes: F32, intercepts: F32, firsts: I64, lengths: I64, costs: Costs
) -> tuple[F32, F32]:
    """Return the greatest value that each template alone adds up to each frame, in its last and first column (kernel).

    Parameters
    ----------
    words : uint64 array (L,)
        The words of the take.
    offsets : float32 array (L,)
        See `decoding_kernels.Frames`.
    slopes : float32 array (f, C)
        See `decoding_kernels.Columns`.
    intercepts : float32 array (C,)
        See `decoding_kernels.Columns`.
    firsts, lengths : int64 array (T,)
        See `decoding_kernels.Columns` and `decoding_kernels.Frames`.
    costs : Costs
        The costs of an explanation.

    Returns
    -------
    ends, begins : float32 array (T, L)
        The greatest values in the last column, and in the first column.
    """
    count, width = len(words), len(intercepts)
    ends = np.empty((len(firsts), count), np.float32)
    begins = np.empty((len(firsts), count), np.float32)
    scores = np.full((MAX_STEP + 1, width), np.float32(-np.inf))
    rows = np.full((MAX_STEP, width), np.float32(-np.inf))
    entry, skip, stay = np.float32(costs.entry), np.float32(costs.skip), np.float32(costs.stay)
    once = twice = slot = 0
    changed = _ANEW
    for frame in range(count):
        twice, once = once, slot
        if frame == 0 or words[frame] != words[frame - 1]:
            slot = 0
            while slot in (once, twice):
                slot += 1
            row = rows[slot]
            if words[frame] == NO_WORD:
                row[:] = -np.inf
            elif changed >= _ANEW or words[frame - 1] == NO_WORD:
                changed = 0
                _sum_single(row, words[frame], offsets[frame], slopes, intercepts)
            else:
                changed += 1
                difference = offsets[frame] - offsets[frame - 1]
                change_ratios(row, rows[once], words[frame - 1], words[frame], difference, slopes, 0)
        last, second = scores[(frame - 1) % 4], scores[(frame - 2) % 4]
        here, third = scores[frame % 4], scores[(frame - 3) % 4]
        step(
            here[MAX_STEP:],
            rows[slot, MAX_STEP:],
            rows[once, MAX_STEP:],
            rows[twice, MAX_STEP:],
            last,
            second,
            third,
            skip,
        )
        for template in range(len(firsts)):
            first = firsts[template]
            end = first + lengths[template] - 1
            here[first] = max(last[first] - stay, -entry) + rows[slot, first]
            here[end] = max(here[end], last[end] - stay + rows[slot, end])
            begins[template, frame], ends[template, frame] = here[first], here[end]
    return ends, begins


@nb.njit(cache=True, nogil=True)
def _sum_single(row: F32, word: np.uint64, offset: np.float32, slopes: F32, intercepts: F32) -> None:
    """Fill in the log ratios of a word in single precision."""
    for n in range(len(row)):
        row[n] = intercepts[n] + offset
    for bit in range(len(slopes)):
        if (word >> np.uint64(bit)) & _ONE:
            slope = slopes[bit]
            for n in range(len(row)):
                row[n] += slope[n]


@nb.njit(cache=True, nogil=True)
def _ranges(frames: Frames, columns: Columns, costs: Costs, ends: F32, begins: F32) -> I64:
    """Return template, start and stop of the promising ranges of all templates (kernel)."""
    found = np.empty((16, 3), np.int64)
    size = 0
    for template in range(len(ends)):
        length = columns.lengths[template]
        slack = np.float32(_SLACK + _SLACK_COLUMN * length)
        own, frame, count = ends[template], 0, ends.shape[1]
        kept = size
        while frame < count:
            if own[frame] <= -slack:
                frame += 1
                continue
            # ends that lie close together are merged into one range
            last = frame
            place = frame + 1
            while place < count and place <= last + length:
                if own[place] > -slack:
                    last = place
                place += 1
            window = _reach(frames, columns, costs, template, frame, own, begins[template], slack)
            start = _earliest(frames, columns, costs, template, window, frame, last)
            if start >= 0:
                if size > kept and found[size - 1, 2] >= start:
                    found[size - 1, 1] = min(found[size - 1, 1], start)
                    found[size - 1, 2] = last + 1
                else:
                    if size == len(found):
                        more = np.empty((2 * size, 3), np.int64)
                        more[:size] = found
                        found = more
                    found[size, 0], found[size, 1], found[size, 2] = template, start, last + 1
                    size += 1
                while size > kept + 1 and found[size - 1, 1] <= found[size - 2, 2]:
                    found[size - 2, 1] = min(found[size - 2, 1], found[size - 1, 1])
                    found[size - 2, 2] = found[size - 1, 2]
                    size -= 1
            frame = last + 1
    return found[:size].copy()


@nb.njit(cache=True, nogil=True)
def _loose(frames: Frames, columns: Columns, costs: Costs, ends: F32, begins: F32) -> I64:
    """Return template, start and stop of the loose ranges of all templates (kernel)."""
    found = np.empty((ends.shape[1] + 1, 3), np.int64)
    kept = np.empty((0, 3), np.int64)
    for template in range(len(ends)):
        slack = np.float32(_SLACK + _SLACK_COLUMN * columns.lengths[template])
        size, own = 0, ends[template]
        for frame in range(len(own)):
            if own[frame] <= -slack:
                continue
            if size and frame <= found[size - 1, 2] + columns.lengths[template]:
                found[size - 1, 2] = frame + 1
                continue
            start = _reach(frames, columns, costs, template, frame, own, begins[template], slack)
            if size and start <= found[size - 1, 2]:
                found[size - 1, 1] = min(found[size - 1, 1], start)
            else:
                found[size, 0], found[size, 1] = template, start
                size += 1
            found[size - 1, 2] = frame + 1
        kept = np.concatenate((kept, found[:size]))
    return kept


@nb.njit(cache=True, nogil=True)
def _ratio(frames: Frames, columns: Columns, column: int, frame: int) -> float:
    """Return the log ratio of a column in a frame."""
    word = frames.words[frame]
    if word == NO_WORD:
        return -np.inf
    total = columns.intercepts[column] + frames.offsets[frame]
    for bit in range(len(columns.slopes)):
        if (word >> np.uint64(bit)) & _ONE:
            total += columns.slopes[bit, column]
    return total


@nb.njit(cache=True, nogil=True)
def _reach(
    frames: Frames, columns: Columns, costs: Costs, template: int, end: int, ends: F32, begins: F32, slack: float
) -> int:
    """Return a lower bound of the first frames of all paths that end at a given frame or later.

    The bound is found by going back in time: through the frames in which a path may stay in the last column, then three
    frames for each column between, then through the frames in which the path may stay in the first column.
    """
    column = columns.firsts[template] + columns.lengths[template] - 1
    frame = end
    while frame > 0 and ends[frame - 1] - costs.stay + _ratio(frames, columns, column, frame) >= ends[frame] - slack:
        frame -= 1
    frame = max(frame - MAX_STEP * columns.lengths[template], 0)
    while frame > 0 and begins[frame - 1] - costs.stay > -costs.entry - slack:
        frame -= 1
    return frame


@nb.njit(cache=True, nogil=True)
def _earliest(
    frames: Frames, columns: Columns, costs: Costs, template: int, window: int, first_end: int, last_end: int
) -> int:
    """Return the first frame of all paths of positive value that end from `first_end` to `last_end`, or −1.

    No such path begins before `window`.
    """
    first, length = columns.firsts[template], columns.lengths[template]
    scores = np.full((MAX_STEP + 1, length + MAX_STEP), -np.inf)
    starts = np.full((MAX_STEP + 1, length + MAX_STEP), np.int64(-1))
    rows = np.full((MAX_STEP, length + MAX_STEP), -np.inf)
    earliest = last_end + 1
    changed = _ANEW
    for place in range(last_end + 1 - window):
        frame = window + place
        row, before = rows[place % 3, MAX_STEP:], rows[(place - 1) % 3, MAX_STEP:]
        if frames.words[frame] == NO_WORD:
            row[:] = -np.inf
            changed = _ANEW
        elif changed >= _ANEW:
            sum_ratios(row, frames.words[frame], frames.offsets[frame], columns, first)
            changed = 0
        elif frames.words[frame] == frames.words[frame - 1]:
            row[:] = before
        else:
            old, new = frames.words[frame - 1], frames.words[frame]
            difference = frames.offsets[frame] - frames.offsets[frame - 1]
            change_ratios(row, before, old, new, difference, columns.slopes, first)
            changed += 1
        here, begun = scores[place % 4], starts[place % 4]
        last, last_begun = scores[(place - 1) % 4], starts[(place - 1) % 4]
        second, second_begun = scores[(place - 2) % 4], starts[(place - 2) % 4]
        third, third_begun = scores[(place - 3) % 4], starts[(place - 3) % 4]
        once, twice = rows[(place - 1) % 3, MAX_STEP:], rows[(place - 2) % 3, MAX_STEP:]
        _step_with_starts(
            here[MAX_STEP:], begun[MAX_STEP:], row, once, twice,
            last, last_begun, second, second_begun, third, third_begun, costs.skip,
        )  # fmt: skip
        here[MAX_STEP], begun[MAX_STEP] = -costs.entry + row[0], frame
        if last[MAX_STEP] - costs.stay > -costs.entry:
            here[MAX_STEP], begun[MAX_STEP] = last[MAX_STEP] - costs.stay + row[0], last_begun[MAX_STEP]
        if last[-1] - costs.stay + row[-1] > here[-1]:
            here[-1], begun[-1] = last[-1] - costs.stay + row[-1], last_begun[-1]
        if frame >= first_end and here[-1] > 0.0:
            earliest = min(earliest, begun[-1])
    return earliest if earliest <= last_end else -1


@nb.njit(cache=True, nogil=True)
def _step_with_starts(
    here: F64,
    begun: I64,
    now: F64,
    once: F64,
    twice: F64,
    last: F64,
    last_begun: I64,
    second: F64,
    second_begun: I64,
    third: F64,
    third_begun: I64,
    skip: float,
) -> None:
    """Fill in the best value of every column and the first frame of its path; see `decoding_kernels.step`."""
    for n in range(len(here)):
        best, start = last[n + 2], last_begun[n + 2]
        other = last[n + 1] - skip
        start = last_begun[n + 1] if other > best else start
        best = other if other > best else best
        other = last[n] - (skip + skip)
        start = last_begun[n] if other > best else start
        best = other if other > best else best
        other = second[n + 2] + once[n]
        start = second_begun[n + 2] if other > best else start
        best = other if other > best else best
        other = third[n + 2] + (twice[n] + once[n])
        start = third_begun[n + 2] if other > best else start
        best = other if other > best else best
        here[n], begun[n] = best + now[n], start
