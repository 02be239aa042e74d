"""This module searches sequences of keyframes with inverted lists, as the thesis does (Sections 3.4 and 3.5).

The symbols of the thesis correspond to these names; frames count from 0 and stops are exclusive, where the thesis
counts from 1 and includes both ends.

    L(v)              the inverted list of a word            `ops.search.inverted_lists`
    Λ_k               inverted keyframe list, Eq. 3.4 to 3.6 `keyframe_list`
    μ_k               admissible range, Eq. 3.11             gaps[k] = (low, high), from `ops.search.gaps.gap_bounds`
    KeyframeSearch    Algorithm 1                            `search_lists`

Algorithm 1 is a recursion that visits the same segments repeatedly if the stiffness is low. This module finds the same
ranges by two passes over the lists. In a backward pass, `completable_frames` reduces every list to the frames from
which the remaining keyframes of the query can be reached, so that no later attempt fails. A forward pass starts at the
last frame of each remaining segment of the first keyframe and proceeds to the largest remaining frame that each gap
allows. The tests compare both passes with the recursion as printed (`tests/oracles/keyframes.py`).

Searches of a store use bit slices instead (`ops.search.bit_slice_search`), which is faster. The lists serve to explain
the results (`kinedex search --explain`) and to test them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kinedex.ops.errors import ParameterError
from kinedex.ops.ranges import to_axis
from kinedex.ops.search.gaps import checked_gaps
from kinedex.ops.search.inverted_lists import InvertedLists
from kinedex.ops.words import I64


def keyframe_list(lists: InvertedLists, mask: int, value: int) -> I64:
    """Return the inverted keyframe list of a keyframe, the union of the lists of its words (thesis, Eq. 3.4 to 3.6).

    Parameters
    ----------
    lists : InvertedLists
        The inverted lists of one feature set.
    mask, value : int
        The keyframe, which matches every word with ``word & mask == value``; bits outside the mask are wildcards. Only
        words that occur are compared, so wildcards do not increase the cost.

    Returns
    -------
    int64 array (n, 2)
        Maximal segments of positions (see `ops.ranges`): runs of different words that touch are one segment.

    Raises
    ------
    ParameterError
        If the value has bits outside its mask, which no word could match.
    """
    words = lists.matching(mask, value)
    counts = lists.runs[words]
    # the runs of word i have the indices lists.offsets[i] to lists.offsets[i + 1] - 1
    skipped = np.repeat(lists.offsets[words] - (np.cumsum(counts) - counts), counts)
    chosen = skipped + np.arange(len(skipped))
    starts = to_axis(lists.take[chosen], lists.start[chosen])
    # runs are disjoint, so starts and stops still match after sorting them separately
    return _joined(np.stack([np.sort(starts), np.sort(starts + lists.length[chosen])], axis=1))


def completable_frames(lists: Sequence[I64], gaps: Sequence[tuple[int, int]]) -> list[I64]:
    """Reduce each keyframe list to the frames from which the remaining keyframes of the query can be reached.

    Parameters
    ----------
    lists : sequence of int64 arrays (n, 2)
        K >= 1 inverted keyframe lists.
    gaps : sequence of (int, int)
        K - 1 admissible gaps (low, high) in frames, both ends included; from `UNBOUNDED` on there is no upper bound.

    Returns
    -------
    list of int64 arrays (n, 2)
        K lists of segments. A frame remains in list k if it is the first frame of a sequence of frames that matches the
        keyframes k to K with their gaps. Hence the last list is unchanged, and the first list contains exactly the
        first frames of all hits.

    Raises
    ------
    ParameterError
        If there is no list, the number of gaps is not K - 1, or a gap is not a range.
    """
    if not lists:
        raise ParameterError("lists", "at least one keyframe list", 0)
    bounds = checked_gaps(gaps, len(lists))
    remaining = [lists[-1]]
    for segments, (low, high) in zip(reversed(lists[:-1]), bounds[::-1].tolist(), strict=True):
        # frame n reaches the frames n + low to n + high: Eq. 3.11, solved for the earlier frame
        reaching = _joined(remaining[-1] - np.array([high, low]))
        remaining.append(_intersection(segments, reaching))
    return remaining[::-1]


def search_lists(lists: Sequence[I64], gaps: Sequence[tuple[int, int]]) -> I64:
    """Return the union of the ranges of all hits of a keyframe query (thesis, Section 3.5, Algorithm 1).

    A hit is a sequence of frames that matches the keyframes with the gaps (Eq. 3.2 and 3.3). Let E(n) be the latest end
    of a hit that begins in frame n. E does not decrease with n, so the hits that begin in a segment [s, e] cover
    exactly [s, E(e)]. E(e) is found by going from e to the largest completable frame that each gap allows.

    Parameters
    ----------
    lists : sequence of int64 arrays (n, 2)
        K >= 1 inverted keyframe lists, see `keyframe_list`.
    gaps : sequence of (int, int)
        K - 1 admissible gaps (low, high) in frames, both ends included; from `UNBOUNDED` on there is no upper bound.

    Returns
    -------
    int64 array (n, 2)
        The ranges from the first to the last keyframe of all hits; ranges that overlap or touch are merged.

    Raises
    ------
    ParameterError
        If there is no list, the number of gaps is not K - 1, or a gap is not a range.
    """
    remaining = completable_frames(lists, gaps)
    frames = remaining[0][:, 1] - 1
    for segments, (_, high) in zip(remaining[1:], checked_gaps(gaps, len(lists)).tolist(), strict=True):
        farthest = frames + high
        nearest = np.searchsorted(segments[:, 0], farthest, side="right") - 1
        frames = np.minimum(segments[nearest, 1] - 1, farthest)
    return _joined(np.stack([remaining[0][:, 0], frames + 1], axis=1))


def _joined(segments: I64) -> I64:
    """Merge overlapping or touching neighbours in segments whose starts ascend and whose stops do not decrease."""
    apart = segments[1:, 0] > segments[:-1, 1]
    edge = np.ones(min(len(segments), 1), np.bool_)
    starts, stops = np.concatenate([edge, apart]), np.concatenate([apart, edge])
    return np.stack([segments[starts, 0], segments[stops, 1]], axis=1)


def _intersection(one: I64, other: I64) -> I64:
    """Return the positions that lie in both of two lists of segments, as segments."""
    begin = np.searchsorted(other[:, 1], one[:, 0], side="right")
    counts = np.maximum(np.searchsorted(other[:, 0], one[:, 1], side="left") - begin, 0)
    mine = np.repeat(np.arange(len(one)), counts)
    theirs = np.repeat(begin - (np.cumsum(counts) - counts), counts) + np.arange(len(mine))
    starts = np.maximum(one[mine, 0], other[theirs, 0])
    return np.stack([starts, np.minimum(one[mine, 1], other[theirs, 1])], axis=1)
