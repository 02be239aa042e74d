"""This module finds alignments of takes in which several successive runs of words are equal.

A copy of a motion has the same words, even if it is cut, moved or rotated about the vertical; a mirrored copy has
mirrored words. If a copy has another frame rate, noise or another body, or is cut between two analysis frames, some of
its runs of words differ and others are equal. Therefore each sequence of `LENGTH` successive runs is looked up in all
other takes, and each occurrence votes for the alignment that it implies. Most alignments of different motions are
rejected by their words, before poses are compared.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numba as nb
import numpy as np

from kinedex.ops.arrays import F64, I64, U64, Bool
from kinedex.ops.bits import count_bits
from kinedex.ops.duplicates.same_motion import MIN_DURATION_S
from kinedex.ops.search.runs import WordRuns
from kinedex.ops.words import NO_WORD

LENGTH = 3
"""Number of successive runs in a sequence: 4 words of 40 bits are rarely equal by chance."""

SHORT = 2
"""Number of successive runs in a sequence of a take that has few runs."""

FEW_RUNS = 24
"""Number of runs; takes with fewer runs are also looked up by sequences of `SHORT` runs."""

FEWEST_RUNS = 4
"""Number of runs; takes with fewer runs are also looked up by single runs."""

FEW = 48
"""Largest number of occurrences of a sequence for which all pairs vote; beyond it only neighbouring occurrences do."""

NEIGHBOURS = 3
"""Number of next occurrences, in order of rhythm, with which each occurrence of a frequent sequence votes."""

RHYTHM = 3
"""Number of runs whose duration orders the occurrences of a sequence, so that those of copies are neighbours."""

KEPT = 3
"""Maximum number of alignments of a pair of takes that are verified, in order of their votes."""

MAX_VOTES = 4_000_000
"""Maximum number of votes in memory at once; sorting so many votes takes about 400 MB."""

_PRIME = np.uint64(0x9E37_79B9_7F4A_7C15)

_INVALID_BITS = 8

LONG_S = 5.0
"""Duration in seconds from which takes are long: they have many runs, so that copies of parts agree more closely."""

LONG_DIFFER, LONG_VOTES, SHORT_DIFFER = 0.2, 2, 0.5
"""The largest word difference and the minimum number of votes of two long takes, and the largest word difference if a
take is shorter.
"""

LAG_FRAMES = 6
"""Number of frames between the words of a take that measure how much it changes."""


class Alignments(NamedTuple):
    """Alignments of pairs of takes, sorted by the takes.

    Parameters
    ----------
    first, second : int64 array (A,)
        The positions of the two takes; first < second.
    shift : int64 array (A,)
        Frame i of the second take is at frame i + shift of the first.
    mirrored : bool array (A,)
        True if the second take is the mirror image of the first.
    votes : int64 array (A,)
        The number of sequences of runs that are equal in the alignment.
    start, stop : int64 array (A,)
        The frames of the second take at the first and at the last of these sequences.
    """

    first: I64
    second: I64
    shift: I64
    mirrored: Bool
    votes: I64
    start: I64
    stop: I64

    def rows(self, chosen: I64 | Bool) -> Alignments:
        """Return the chosen alignments, in the order of their indices."""
        one, two, three, image, *rest = self
        votes, start, stop = (column[chosen] for column in rest)
        return Alignments(one[chosen], two[chosen], three[chosen], image[chosen], votes, start, stop)


class _Places(NamedTuple):
    """The occurrences of sequences of runs, in order of sequence and take.

    Each occurrence forms pairs with the next `ahead` occurrences, which have the same sequence; for a frequent sequence
    these are at most `NEIGHBOURS`. `image` is true for mirrored words. `asked` marks the requested takes, of which each
    pair that votes must contain at least one.
    """

    take: I64
    frame: I64
    image: Bool
    ahead: I64
    asked: Bool


def find_alignments(runs: WordRuns, mirrored: U64 | None = None, most_votes: int = MAX_VOTES) -> Iterator[Alignments]:
    """Find the alignments of different takes in which several sequences of runs are equal.

    Parameters
    ----------
    runs : WordRuns
        The runs of whole words of all takes, in order of take and start.
    mirrored : uint64 array (R,), optional
        The word of each run with left and right exchanged; if it is not given, no mirrored copies are found.
    most_votes : int, optional
        The maximum number of votes in memory at once; it may be exceeded, since the votes of a take are not divided.

    Yields
    ------
    Alignments
        The alignments of successive groups of first takes, in order. Of each pair of takes, mirrored or not, at most
        `KEPT` alignments with the most votes are included.
    """
    count = int(runs.take[-1]) + 1 if len(runs.take) else 0
    counts = np.bincount(runs.take, minlength=count)
    sought = [(LENGTH, np.ones(count, np.bool_)), (SHORT, counts < FEW_RUNS), (1, counts < FEWEST_RUNS)]
    tables = [
        [_places(runs, image, length, asked) for length, asked in sought if length == LENGTH or asked.any()]
        for image in ((None,) if mirrored is None else (None, mirrored))
    ]
    votes = np.array([[_count_votes(*table, count) for table in both] for both in tables], np.int64)
    for low, high in _blocks(votes.sum(axis=(0, 1)), most_votes):
        sizes = votes[:, :, low:high].sum(axis=2).tolist()
        chosen = []
        for number, both in enumerate(tables):
            drawn = [_votes(*table, low, high, size) for table, size in zip(both, sizes[number], strict=True)]
            first, second, shift, place = (np.concatenate(columns) for columns in zip(*drawn, strict=True))
            chosen.append(_best(first, second, shift, place, number > 0))
        found = _joined(chosen)
        yield found.rows(np.lexsort((found.shift, found.mirrored, found.second, found.first)))


def _joined(parts: Sequence[Alignments]) -> Alignments:
    one, two, three, image, votes, start, stop = (np.concatenate(own) for own in zip(*parts, strict=True))
    return Alignments(one, two, three, image, votes, start, stop)


def _blocks(votes: I64, most: int) -> Iterator[tuple[int, int]]:
    """Yield consecutive ranges [start, stop) of takes whose `votes` sum to at most `most`.

    The votes of a take are those of the pairs of which it is the first take. A take that alone has more than `most`
    shares its range only with takes that have none.
    """
    low, held = 0, 0
    for take, own in enumerate(votes.tolist()):
        if held and held + own > most:
            yield low, take
            low, held = take, 0
        held += own
    if held:
        yield low, len(votes)


def _sequences(runs: WordRuns, words: U64, length: int) -> tuple[U64, I64, I64, I64]:
    """Return hash, take, frame and rhythm of each sequence of `length` runs without an invalid frame between them.

    The frame is the start of the second run, because the first run may be cut off at the start of a take; of a single
    run it is the start. The rhythm is the number of frames from there to the start of a later run, `RHYTHM` runs on.
    """
    count = len(runs.take) - length + 1
    if count < 1:
        none = np.empty(0, np.int64)
        return np.empty(0, np.uint64), none, none, none
    whole = runs.take[:count] == runs.take[length - 1 :]
    hashes = np.zeros(count, np.uint64)
    for k in range(length):
        mixed = (hashes ^ words[k : k + count]) * _PRIME
        hashes = mixed ^ (mixed >> np.uint64(29))
        if k:
            # valid only without an invalid frame in between
            whole &= runs.start[k : k + count] == runs.stop[k - 1 : k - 1 + count]
    second = min(1, length - 1)
    frames = runs.start[second : second + count]
    last = np.searchsorted(runs.take, runs.take[:count], side="right") - 1
    later = runs.start[np.minimum(np.arange(count) + second + RHYTHM, last)]
    return hashes[whole], runs.take[:count][whole], frames[whole], (later - frames)[whole]


def _places(runs: WordRuns, mirrored: U64 | None, length: int, asked: Bool) -> _Places:
    """Return the occurrences of all sequences of a given length; with mirrored words, also of their mirror images."""
    hashes, takes, frames, rhythm = _sequences(runs, runs.word, length)
    image = np.zeros(len(hashes), np.bool_)
    if mirrored is not None:
        other = _sequences(runs, mirrored, length)
        image = np.repeat([False, True], len(hashes))
        own = (hashes, takes, frames, rhythm)
        hashes, takes, frames, rhythm = (np.concatenate(both) for both in zip(own, other, strict=True))
    order = np.lexsort((takes, rhythm, hashes))
    hashes, takes, frames, image = hashes[order], takes[order], frames[order], image[order]
    begins = np.flatnonzero(np.diff(hashes, prepend=~hashes[:1]) != 0)
    sizes = np.diff(begins, append=len(hashes))
    size = np.repeat(sizes, sizes)
    rest = np.repeat(begins + sizes, sizes) - np.arange(len(hashes)) - 1  # number of later occurrences in the group
    ahead = np.where(size <= FEW, rest, np.minimum(rest, NEIGHBOURS))
    if mirrored is None:
        image = np.zeros(0, np.bool_)
    return _Places(takes, frames, image, ahead, asked)


@nb.njit(cache=True, nogil=True)
def _votes_with(take: I64, image: Bool, asked: Bool, i: int, j: int) -> bool:
    """Return whether two occurrences vote for an alignment.

    They vote if they are in different takes, one of which is requested, and, where `image` is given, exactly one of the
    occurrences is mirrored.
    """
    if take[i] == take[j] or not (asked[take[i]] or asked[take[j]]):
        return False
    return len(image) == 0 or image[i] != image[j]


@nb.njit(cache=True, nogil=True)
def _count_votes(take: I64, frame: I64, image: Bool, ahead: I64, asked: Bool, count: int) -> I64:
    """Return for each take the votes of the pairs whose first take it is; that is the one with the lower number."""
    votes = np.zeros(count, np.int64)
    for i in range(len(take)):
        for j in range(i + 1, i + 1 + ahead[i]):
            if _votes_with(take, image, asked, i, j):
                votes[min(take[i], take[j])] += 1
    return votes


@nb.njit(cache=True, nogil=True)
def _votes(
    take: I64, frame: I64, image: Bool, ahead: I64, asked: Bool, low: int, high: int, size: int
) -> tuple[I64, I64, I64, I64]:
    """Return both takes, the shift, and the frame in the second take of each pair of sequences that are equal.

    Each pair is a vote for an alignment; its first take, which has the lower number, is in [low, high).
    """
    first, second, shift = np.empty(size, np.int64), np.empty(size, np.int64), np.empty(size, np.int64)
    place = np.empty(size, np.int64)
    n = 0
    for i in range(len(take)):
        for j in range(i + 1, i + 1 + ahead[i]):
            if low <= min(take[i], take[j]) < high and _votes_with(take, image, asked, i, j):
                a, b = (i, j) if take[i] < take[j] else (j, i)
                first[n], second[n], shift[n], place[n] = take[a], take[b], frame[a] - frame[b], frame[b]
                n += 1
    return first, second, shift, place


def _best(first: I64, second: I64, shift: I64, place: I64, image: bool) -> Alignments:
    """Return the alignments with most votes of each pair of takes; votes one frame apart are added."""
    order = np.lexsort((place, shift, second, first))
    first, second, shift, place = first[order], second[order], shift[order], place[order]
    begins = np.flatnonzero(_changes(first, second, shift))
    votes = np.diff(begins, append=len(first))
    start, stop = place[begins], place[begins + votes - 1] + 1
    first, second, shift = first[begins], second[begins], shift[begins]
    beside = ~_changes(first, second)[1:] & (np.diff(shift) == 1)
    near = votes.copy()
    near[1:] += np.where(beside, votes[:-1], 0)
    near[:-1] += np.where(beside, votes[1:], 0)
    order = np.lexsort((np.abs(shift), -near, second, first))
    found = Alignments(first, second, shift, np.full(len(first), image), near, start, stop)
    found = found.rows(order)
    rows = np.arange(len(order))
    number = rows - np.maximum.accumulate(np.where(_changes(found.first, found.second), rows, 0))
    return found.rows(number < KEPT)


def _changes(*columns: I64) -> Bool:
    """Return a mask of the rows that differ from the row before; the first one is True."""
    changed = np.zeros(len(columns[0]), np.bool_)
    changed[:1] = True
    for column in columns:
        changed[1:] |= column[1:] != column[:-1]
    return changed


def plausible(words: U64, offsets: I64, mirrored: U64 | None, found: Alignments, rate_hz: float) -> Bool:
    """Return a mask of the alignments whose takes may show the same motion, judged by their words.

    Parameters
    ----------
    words : uint64 array (L,)
        The concatenated words of all takes; `NO_WORD` in invalid frames.
    offsets : int64 array (T + 1,)
        Take i has the words offsets[i] to offsets[i + 1] − 1.
    mirrored : uint64 array (L,), optional
        The words with left and right exchanged; required if an alignment is mirrored.
    found : Alignments
        The alignments of takes.
    rate_hz : float
        Frames per second.

    Returns
    -------
    bool array (A,)
        False if the words differ too much.
    """
    differ = word_differences(words, offsets, mirrored, found, max(1, round(MIN_DURATION_S * rate_hz)))
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
        The concatenated words of all takes; `NO_WORD` in invalid frames.
    offsets : int64 array (T + 1,)
        Take i has the words offsets[i] to offsets[i + 1] − 1.
    mirrored : uint64 array (L,), optional
        The words with left and right exchanged; needed where an alignment is mirrored.
    found : Alignments
        The alignments of takes.
    frames : int
        The length of the intervals; if the takes overlap in fewer frames, the overlap is used.

    Returns
    -------
    float64 array (A,)
        The number of bits that differ between the two takes, divided by the number of bits that differ between frames
        of the second take that are `LAG_FRAMES` apart. If no word changes, 0 for equal words and ∞ for others.
    """
    other = words if mirrored is None else mirrored
    return _differences(words, other, offsets, found, frames)


@nb.njit(cache=True, nogil=True)
def _differences(words: U64, mirrored: U64, offsets: I64, found: Alignments, frames: int) -> F64:
    first, second, shift, image, _, start, stop = found
    result = np.full(len(first), np.inf)
    for row in range(len(first)):
        one, two, end = offsets[first[row]] + shift[row], offsets[second[row]], offsets[second[row] + 1]
        other = mirrored if image[row] else words
        low = max(0, -shift[row], start[row] - frames)
        high = min(end - two, offsets[first[row] + 1] - one, stop[row] + frames)
        length = min(frames, high - low)
        differ, change, equal = 0, 0, False
        for t in range(low, high):
            differ += _bits(words[one + t], other[two + t])
            change += _bits(words[two + t], words[min(two + t + LAG_FRAMES, end - 1)])
            if t >= low + length:
                out = t - length
                differ -= _bits(words[one + out], other[two + out])
                change -= _bits(words[two + out], words[min(two + out + LAG_FRAMES, end - 1)])
            if t >= low + length - 1:
                if change > 0:
                    result[row] = min(result[row], differ / change)
                equal |= differ == 0
        if equal and result[row] == np.inf:
            result[row] = 0.0
    return result


@nb.njit(cache=True, nogil=True)
def _bits(one: np.uint64, two: np.uint64) -> int:
    """Return the number of bits that differ, `_INVALID_BITS` if only one frame is valid."""
    if (one == NO_WORD) != (two == NO_WORD):
        return _INVALID_BITS
    return count_bits(one ^ two)
