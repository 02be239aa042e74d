"""This module finds runs: maximal intervals of frames of a take with the same word, or in which a feature is on."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from kinedex.ops.bits import lowest_bit
from kinedex.ops.errors import ParameterError
from kinedex.ops.words import I64, MAX_FEATURES, NO_WORD, U64

I32 = npt.NDArray[np.int32]


class WordRuns(NamedTuple):
    """Runs of equal words, in order of take and start.

    Parameters
    ----------
    take : int64 array (R,)
        The position of the take among the offsets.
    start, stop : int64 array (R,)
        Half-open ranges of frames of the take.
    word : uint64 array (R,)
        The word of each run.
    """

    take: I64
    start: I64
    stop: I64
    word: U64


class FeatureRuns(NamedTuple):
    """Runs of frames in which a feature is on, in order of feature, take and start.

    Parameters
    ----------
    feature : uint8 array (R,)
        The number of the feature, from 1.
    take : int32 array (R,)
        The position of the take among the offsets.
    start, stop : int32 array (R,)
        Half-open ranges of frames of the take.
    """

    feature: npt.NDArray[np.uint8]
    take: I32
    start: I32
    stop: I32


def word_runs(words: U64, offsets: I64) -> WordRuns:
    """Divide the words of many takes into runs, the entries of inverted lists (thesis, Section 3.3).

    Parameters
    ----------
    words : uint64 array (N,)
        The concatenated words of T takes, possibly reduced to one feature set by `ops.words.cut`; `NO_WORD` for an
        invalid frame.
    offsets : int64 array (T + 1,)
        Take i has the words offsets[i] to offsets[i + 1] - 1. Takes may be empty.

    Returns
    -------
    WordRuns
        Runs that cover every valid frame once; none crosses from one take to the next.

    Raises
    ------
    ParameterError
        If the offsets do not fit the words.
    """
    words, offsets = _checked(words, offsets)
    count = _count_word_runs(words, offsets)
    take, start, stop = (np.empty(count, np.int64) for _ in range(3))
    word = np.empty(count, np.uint64)
    _fill_word_runs(words, offsets, take, start, stop, word)
    return WordRuns(take, start, stop, word)


def feature_runs(words: U64, offsets: I64, features: int) -> FeatureRuns:
    """Find the runs of frames in which each feature is on.

    Parameters
    ----------
    words : uint64 array (N,)
        The concatenated whole words of T takes; bit i - 1 is F_i, and bits from `features` on are ignored. All features
        are off in an invalid frame (`NO_WORD`).
    offsets : int64 array (T + 1,)
        As in `word_runs`; takes must have fewer than 2**31 frames.
    features : int
        The number of features, 1 to 63.

    Returns
    -------
    FeatureRuns
        The runs of all features; none crosses from one take to the next.

    Raises
    ------
    ParameterError
        If the offsets do not fit the words, or the number of features is out of range.
    """
    words, offsets = _checked(words, offsets)
    if not 1 <= features <= MAX_FEATURES:
        raise ParameterError("features", f"from 1 to {MAX_FEATURES}", features)
    if np.any(np.diff(offsets) > np.iinfo(np.int32).max):
        raise ParameterError("offsets", "of takes of less than 2^31 frames", int(np.diff(offsets).max()))
    mask = np.uint64((1 << features) - 1)
    counts = np.zeros(features, np.int64)
    _count_feature_runs(words, offsets, mask, counts)
    total = int(counts.sum())
    take, start, stop = (np.empty(total, np.int32) for _ in range(3))
    cursor = np.cumsum(counts) - counts
    _fill_feature_runs(words, offsets, mask, cursor, take, start, stop)
    feature = np.repeat(np.arange(1, features + 1, dtype=np.uint8), counts)
    return FeatureRuns(feature, take, start, stop)


def _checked(words: U64, offsets: I64) -> tuple[U64, I64]:
    words = np.ascontiguousarray(words, dtype=np.uint64)
    offsets = np.ascontiguousarray(offsets, dtype=np.int64)
    if words.ndim != 1:
        raise ParameterError("words", "one-dimensional", words.shape)
    if offsets.ndim != 1 or len(offsets) == 0 or offsets[0] != 0:
        raise ParameterError("offsets", "one-dimensional and starting at 0", offsets[:3])
    if offsets[-1] != len(words) or np.any(np.diff(offsets) < 0):
        raise ParameterError("offsets", f"rising to {len(words)}, the number of words", int(offsets[-1]))
    return words, offsets


@njit(cache=True, nogil=True)
def _count_word_runs(words: U64, offsets: I64) -> int:
    count = 0
    for take in range(len(offsets) - 1):
        for i in range(offsets[take], offsets[take + 1]):
            if words[i] != NO_WORD and (i == offsets[take] or words[i] != words[i - 1]):
                count += 1
    return count


@njit(cache=True, nogil=True)
def _fill_word_runs(words: U64, offsets: I64, take: I64, start: I64, stop: I64, word: U64) -> None:
    run = -1
    for t in range(len(offsets) - 1):
        first = offsets[t]
        for i in range(first, offsets[t + 1]):
            if words[i] == NO_WORD:
                continue
            if i == first or words[i] != words[i - 1]:
                run += 1
                take[run] = t
                start[run] = i - first
                word[run] = words[i]
            stop[run] = i - first + 1


@njit(cache=True, nogil=True)
def _count_feature_runs(words: U64, offsets: I64, mask: np.uint64, counts: I64) -> None:
    for take in range(len(offsets) - 1):
        before = np.uint64(0)
        for i in range(offsets[take], offsets[take + 1]):
            now = words[i] & mask if words[i] != NO_WORD else np.uint64(0)
            rising = now & ~before
            while rising:
                counts[lowest_bit(rising)] += 1
                rising &= rising - np.uint64(1)
            before = now


@njit(cache=True, nogil=True)
def _fill_feature_runs(
    words: U64, offsets: I64, mask: np.uint64, cursor: I64, take: I32, start: I32, stop: I32
) -> None:
    # every feature writes to its own part, so the runs are sorted by feature
    for t in range(len(offsets) - 1):
        first = offsets[t]
        before = np.uint64(0)
        for i in range(first, offsets[t + 1] + 1):
            # one step past the take's end all features are off
            now = words[i] & mask if i < offsets[t + 1] and words[i] != NO_WORD else np.uint64(0)
            changed = now ^ before
            while changed:
                feature = lowest_bit(changed)
                run = cursor[feature]
                if (now >> np.uint64(feature)) & np.uint64(1):
                    take[run] = t
                    start[run] = i - first
                else:
                    stop[run] = i - first
                    cursor[feature] = run + 1
                changed &= changed - np.uint64(1)
            before = now
