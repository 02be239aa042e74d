"""Alignments of takes in which several successive runs of whole words are equal: candidates for the same motion.

A copy of a motion has the words of the motion, also where it is cut, moved to another place or turned; a mirrored copy
has mirrored words. At another rate, or cut between two analysis frames, a copy loses some runs, and keeps others. So
each sequence of `LENGTH` successive words is looked up in all other takes, and votes for the alignment in which it
starts at the same moment.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from kinedex.ops.search.runs import WordRuns

I64 = npt.NDArray[np.int64]
U64 = npt.NDArray[np.uint64]
Bool = npt.NDArray[np.bool_]

LENGTH = 4
"""Successive runs of a sequence: 4 words of 40 bits are rarely equal by chance."""

SHORT = 2
"""Successive runs of a sequence of a take that has few runs."""

FEW_RUNS = 24
"""Takes with fewer runs are looked up by sequences of `SHORT` runs, too."""

FEW = 24
"""A sequence that occurs at most so often votes for all pairs of its places; a more frequent one for neighbours."""

NEIGHBOURS = 3
"""Places of a frequent sequence, in order of takes, that vote with each other: copies of one motion form a chain."""

KEPT = 3
"""Alignments of a pair of takes that are judged, the ones with most votes first."""

_PRIME = np.uint64(0x9E37_79B9_7F4A_7C15)


class Alignments(NamedTuple):
    """Alignments of two takes, in order of the takes.

    Parameters
    ----------
    first, second : int64 array (A,)
        The positions of the two takes; first < second.
    shift : int64 array (A,)
        Frame i of the second take is at frame i + shift of the first.
    mirrored : bool array (A,)
        The second take is the mirror image of the first.
    votes : int64 array (A,)
        Sequences of runs that are equal there.
    """

    first: I64
    second: I64
    shift: I64
    mirrored: Bool
    votes: I64


def find_alignments(runs: WordRuns, mirrored: U64 | None = None) -> Alignments:
    """Find the alignments of different takes in which several sequences of runs are equal.

    Parameters
    ----------
    runs : WordRuns
        The runs of whole words of all takes, in order of take and start.
    mirrored : uint64 array (R,), optional
        The word of each run with left and right exchanged; without it no mirrored copies are found.

    Returns
    -------
    Alignments
        At most `KEPT` alignments of each pair of takes and each side, those with most votes.
    """
    few = np.bincount(runs.take, minlength=1) < FEW_RUNS
    chosen = []
    for image in (None, mirrored) if mirrored is not None else (None,):
        votes = [_votes(runs, image, LENGTH, np.ones_like(few)), _votes(runs, image, SHORT, few)]
        columns = [np.concatenate(both) for both in zip(*votes, strict=True)]
        chosen.append(_best(columns[0], columns[1], columns[2], image is not None))
    first, second, shift, turned, found = (np.concatenate(columns) for columns in zip(*chosen, strict=True))
    order = np.lexsort((shift, turned, second, first))
    return Alignments(first[order], second[order], shift[order], turned[order], found[order])


def _sequences(runs: WordRuns, words: U64, length: int) -> tuple[U64, I64, I64]:
    """Return hash, take and frame of each sequence: the start of its second run, which no cut of a take moves."""
    count = len(runs.take) - length + 1
    if count < 1:
        return np.empty(0, np.uint64), np.empty(0, np.int64), np.empty(0, np.int64)
    whole = runs.take[:count] == runs.take[length - 1 :]
    hashes = np.zeros(count, np.uint64)
    for k in range(length):
        mixed = (hashes ^ words[k : k + count]) * _PRIME
        hashes = mixed ^ (mixed >> np.uint64(29))
        if k:
            whole &= runs.start[k : k + count] == runs.stop[k - 1 : k - 1 + count]  # no invalid frame in between
    return hashes[whole], runs.take[:count][whole], runs.start[1 : 1 + count][whole]


def _votes(runs: WordRuns, mirrored: U64 | None, length: int, asked: Bool) -> tuple[I64, I64, I64]:
    """Return the takes and the shift of each pair of places with equal sequences; one take of each pair is asked for.

    With mirrored words, one place of each pair shows the sequence and the other one its mirror image.
    """
    hashes, takes, frames = _sequences(runs, runs.word, length)
    image = np.zeros(len(hashes), np.bool_)
    if mirrored is not None:
        other = _sequences(runs, mirrored, length)
        image = np.repeat([False, True], len(hashes))
        hashes, takes, frames = (np.concatenate(both) for both in zip((hashes, takes, frames), other, strict=True))
    order = np.lexsort((takes, hashes))
    hashes, takes, frames, image = hashes[order], takes[order], frames[order], image[order]
    begins = np.flatnonzero(np.diff(hashes, prepend=~hashes[:1]) != 0)
    sizes = np.diff(begins, append=len(hashes))
    size = np.repeat(sizes, sizes)
    rest = np.repeat(begins + sizes, sizes) - np.arange(len(hashes)) - 1  # places that follow in the group
    ahead = np.where(size <= FEW, rest, np.minimum(rest, NEIGHBOURS))
    found: list[tuple[I64, I64, I64]] = [(np.empty(0, np.int64),) * 3]
    for step in range(1, int(ahead.max(initial=0)) + 1):
        left = np.flatnonzero(ahead >= step)
        right = left + step
        use = (takes[left] != takes[right]) & (asked[takes[left]] | asked[takes[right]])
        if mirrored is not None:
            use &= image[left] != image[right]
        left, right = left[use], right[use]
        swap = takes[left] > takes[right]
        left, right = np.where(swap, right, left), np.where(swap, left, right)
        found.append((takes[left], takes[right], frames[left] - frames[right]))
    first, second, shift = (np.concatenate(columns) for columns in zip(*found, strict=True))
    return first, second, shift


def _best(first: I64, second: I64, shift: I64, image: bool) -> tuple[I64, I64, I64, Bool, I64]:
    """Return the alignments with most votes of each pair of takes; those one frame apart count together."""
    order = np.lexsort((shift, second, first))
    first, second, shift = first[order], second[order], shift[order]
    begins = np.flatnonzero(_changes(first, second, shift))
    votes = np.diff(begins, append=len(first))
    first, second, shift = first[begins], second[begins], shift[begins]
    beside = ~_changes(first, second)[1:] & (np.diff(shift) == 1)
    near = votes.copy()
    near[1:] += np.where(beside, votes[:-1], 0)
    near[:-1] += np.where(beside, votes[1:], 0)
    order = np.lexsort((np.abs(shift), -near, second, first))
    first, second, shift, near = first[order], second[order], shift[order], near[order]
    place = np.arange(len(first))
    number = place - np.maximum.accumulate(np.where(_changes(first, second), place, 0))
    keep = number < KEPT
    return first[keep], second[keep], shift[keep], np.full(int(keep.sum()), image), near[keep]


def _changes(*columns: I64) -> Bool:
    """Return the rows that differ from the row before; the first row does."""
    changed = np.zeros(len(columns[0]), np.bool_)
    changed[:1] = True
    for column in columns:
        changed[1:] |= column[1:] != column[:-1]
    return changed
