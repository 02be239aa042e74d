"""This module rejects most alignments of different motions by their words alone, before poses are compared."""

from __future__ import annotations

import numba as nb
import numpy as np

from kinedex.ops.arrays import F64, I64, Bool
from kinedex.ops.bits import count_bits
from kinedex.ops.duplicates.alignments import Alignments
from kinedex.ops.duplicates.same_motion import LEAST_S
from kinedex.ops.words import NO_WORD, U64

_INVALID_BITS = 8

LONG_S = 5.0
"""Duration in seconds from which takes are long: they have many runs, so that copies of parts agree more closely."""

LONG_DIFFER, LONG_VOTES, SHORT_DIFFER = 0.2, 2, 0.5
"""The largest difference of the words of two long takes, and their fewest votes; and the largest difference if a take
is shorter. (All of 1,234 copies of HDM05's clips differ by less, those of 5 s and more by 0.05 at most.)
"""

LAG_FRAMES = 6
"""Number of frames between the words of a take that measure how much it changes."""


def plausible(words: U64, offsets: I64, mirrored: U64 | None, found: Alignments, rate_hz: float) -> Bool:
    """Return a mask of the alignments that can be of one motion, judged by their words.

    Parameters
    ----------
    words : uint64 array (L,)
        The words of all takes laid end to end; `NO_WORD` in invalid frames.
    offsets : int64 array (T + 1,)
        Take i has the words offsets[i] to offsets[i + 1].
    mirrored : uint64 array (L,), optional
        The words with left and right exchanged; needed where an alignment is mirrored.
    found : Alignments
        The alignments of takes.
    rate_hz : float
        Frames per second.

    Returns
    -------
    bool array (A,)
        False where the words differ too much.
    """
    differ = word_differences(words, offsets, mirrored, found, max(1, round(LEAST_S * rate_hz)))
    lengths = np.diff(offsets)
    long = np.minimum(lengths[found.first], lengths[found.second]) >= LONG_S * rate_hz
    kept: Bool = np.where(long, (differ <= LONG_DIFFER) & (found.votes >= LONG_VOTES), differ <= SHORT_DIFFER)
    return kept


def word_differences(words: U64, offsets: I64, mirrored: U64 | None, found: Alignments, frames: int) -> F64:
    """Return the word difference of two takes where they agree best, relative to how much the words change there.

    The comparison is over intervals of `frames` frames around the equal sequences that support the alignment.

    Parameters
    ----------
    words : uint64 array (L,)
        The words of all takes laid end to end; `NO_WORD` in invalid frames.
    offsets : int64 array (T + 1,)
        Take i has the words offsets[i] to offsets[i + 1].
    mirrored : uint64 array (L,), optional
        The words with left and right exchanged; needed where an alignment is mirrored.
    found : Alignments
        The alignments of takes.
    frames : int
        The length of the intervals, or all that both takes have in common if that is less.

    Returns
    -------
    float64 array (A,)
        The bits that differ between the takes over those that differ within the second take `LAG_FRAMES` apart; ∞ where
        no word changes.
    """
    other = words if mirrored is None else mirrored
    return _differences(words, other, offsets, *found, frames)


@nb.njit(cache=True, nogil=True)
def _differences(
    words: U64,
    mirrored: U64,
    offsets: I64,
    first: I64,
    second: I64,
    shift: I64,
    image: Bool,
    votes: I64,
    start: I64,
    stop: I64,
    frames: int,
) -> F64:
    result = np.full(len(first), np.inf)
    for row in range(len(first)):
        one, two, end = offsets[first[row]] + shift[row], offsets[second[row]], offsets[second[row] + 1]
        other = mirrored if image[row] else words
        low = max(0, -shift[row], start[row] - frames)
        high = min(end - two, offsets[first[row] + 1] - one, stop[row] + frames)
        length = min(frames, high - low)
        differ, change = 0, 0
        for t in range(low, high):
            differ += _bits(words[one + t], other[two + t])
            change += _bits(words[two + t], words[min(two + t + LAG_FRAMES, end - 1)])
            if t >= low + length:
                out = t - length
                differ -= _bits(words[one + out], other[two + out])
                change -= _bits(words[two + out], words[min(two + out + LAG_FRAMES, end - 1)])
            if t >= low + length - 1 and change > 0:
                result[row] = min(result[row], differ / change)
    return result


@nb.njit(cache=True, nogil=True)
def _bits(one: np.uint64, two: np.uint64) -> int:
    """Return the number of bits that differ, `_INVALID_BITS` if only one frame is valid."""
    if (one == NO_WORD) != (two == NO_WORD):
        return _INVALID_BITS
    return count_bits(one ^ two)
