"""This module computes the fitness of queries on training clips, using bitmaps of frames (thesis, Section 4.2).

A clip counts as retrieved if the query has at least one hit in it, so hits need not be listed. The frames that match a
keyframe form a bitmap, with one bit for each frame. A gap [low, high] shifts and widens the bitmap of the frames that
were reached by the previous keyframe. If bits remain after the last keyframe, the clip is retrieved. Bitmaps are stored
in lanes of 64 bits. Each clip begins in a new lane, so that a clip of up to 64 frames has one lane, and no bit is
shifted from one clip into the next. Bitmaps of keyframes are cached; when one keyframe of a query changes, only one new
bitmap is computed. A search of bit slices would find ranges of frames, at a higher cost than the fitness needs
(`docs/decisions/0002-bit-slices.md`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit

from kinedex.ops.arrays import I64, U64, Bool
from kinedex.ops.errors import ParameterError
from kinedex.ops.words import MAX_FEATURES, NO_WORD

_LANE = 64
CACHED_BITMAPS = 256
"""The number of cached bitmaps of keyframes, which exceeds the number of keyframes of any query."""

INNER = {"cache": True, "nogil": True, "no_cpython_wrapper": True}
"""Options for kernels that are called only by other kernels: without a Python wrapper they are a sixth faster."""


@dataclass(frozen=True)
class TrainingFrames:
    """The frames of T clips as bitmaps, two for each feature.

    Parameters
    ----------
    on, off : uint64 array (f, W)
        Bit j of on[i - 1, first[t] + w] is set where F_i counts as on in frame 64 w + j of clip t, and likewise for
        off. In a clip that is judged strictly (see `training_frames`) a feature may be neither.
    valid : uint64 array (W,)
        The frames that exist and have a word.
    first : int64 array (T + 1,)
        The first lane of each clip.
    """

    on: U64
    off: U64
    valid: U64
    first: I64

    def __len__(self) -> int:
        return len(self.first) - 1


def training_frames(clips: Sequence[U64], features: int, steady: Sequence[int] | None = None) -> TrainingFrames:
    """Pack clips into bitmaps of frames.

    Parameters
    ----------
    clips : sequence of uint64 arrays (L_i,)
        The words of each clip; `NO_WORD` matches no keyframe.
    features : int
        The number of features f.
    steady : sequence of int, optional
        The strictness n of each clip, 0 by default. A feature counts as on (or off) in a frame only if it is on (or
        off) from n frames before to n frames after; the first and the last frame of a clip are repeated. A query then
        only retrieves clips that it matches with some tolerance.

    Returns
    -------
    TrainingFrames

    Raises
    ------
    ParameterError
        If there is no clip, a clip is empty, or the number of features is out of its domain.
    """
    if not 1 <= features <= MAX_FEATURES:
        raise ParameterError("features", f"between 1 and {MAX_FEATURES}", features)
    if not clips or any(not len(clip) for clip in clips):
        raise ParameterError("clips", "one or more, each with one frame at least", [len(clip) for clip in clips])
    if steady is not None and (len(steady) != len(clips) or min(steady) < 0):
        raise ParameterError("steady", f"0 or more frames for each of the {len(clips)} clips", list(steady))
    lanes = [-(-len(clip) // _LANE) for clip in clips]
    first = np.zeros(len(clips) + 1, np.int64)
    np.cumsum(lanes, out=first[1:])
    on = np.zeros((features, int(first[-1]) * _LANE), np.bool_)
    off = np.zeros_like(on)
    valid = np.zeros(on.shape[1], np.bool_)
    shifts = np.arange(features, dtype=np.uint64)[:, None]
    for index, (clip, begin) in enumerate(zip(clips, (first[:-1] * _LANE).tolist(), strict=True)):
        known = clip != NO_WORD
        bits = ((clip[None, :] >> shifts) & np.uint64(1)).astype(np.bool_)
        piece = slice(begin, begin + len(clip))
        frames = 0 if steady is None else steady[index]
        on[:, piece] = _eroded(bits & known, frames) & known
        off[:, piece] = _eroded(~bits & known, frames) & known
        valid[piece] = known
    return TrainingFrames(_packed(on), _packed(off), _packed(valid), first)


def _eroded(rows: Bool, steady: int) -> Bool:
    """Return a mask that is True where rows are from `steady` frames before to `steady` frames after; ends repeat."""
    if not steady:
        return rows
    padded = np.pad(rows, ((0, 0), (steady, steady)), mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * steady + 1, axis=1)
    result: Bool = np.all(windows, axis=2)
    return result


def _packed(frames: Bool) -> U64:
    """Pack rows of frames into lanes of 64 bits."""
    return np.packbits(frames, axis=-1, bitorder="little").view("<u8").astype(np.uint64)


class Workspace(NamedTuple):
    """The arrays that the fitness kernels write to.

    Parameters
    ----------
    bitmaps : uint64 array (CACHED_BITMAPS, W)
        The frames that match each cached keyframe.
    masks, values : uint64 array (CACHED_BITMAPS,)
        The cached keyframes.
    made : int64 array (1,)
        The number of bitmaps made so far.
    slots : int64 array (K,)
        The slots of the keyframes of a query in the cache.
    lows, highs : int64 array (K,)
        The gaps between the keyframes.
    reached : uint64 array (2, W)
        The bitmap of the frames that are reached, and memory for the next bitmap.
    place : int64 array (W,)
        The index of each lane within its clip, from 0.
    hit : bool array (T,)
        The clips that are retrieved.
    """

    bitmaps: U64
    masks: U64
    values: U64
    made: I64
    slots: I64
    lows: I64
    highs: I64
    reached: U64
    place: I64
    hit: Bool


def new_workspace(frames: TrainingFrames, keyframes: int) -> Workspace:
    """Allocate a workspace for queries of up to `keyframes` keyframes on these clips."""
    lanes = np.arange(len(frames.valid))
    return Workspace(
        np.zeros((CACHED_BITMAPS, len(frames.valid)), np.uint64),
        np.zeros(CACHED_BITMAPS, np.uint64),
        np.zeros(CACHED_BITMAPS, np.uint64),
        np.zeros(1, np.int64),
        np.zeros(keyframes, np.int64),
        np.zeros(keyframes, np.int64),
        np.zeros(keyframes, np.int64),
        np.zeros((2, len(lanes)), np.uint64),
        lanes - np.repeat(frames.first[:-1], np.diff(frames.first)),
        np.zeros(len(frames), np.bool_),
    )


# ---- kernels ---------------------------------------------------------------------------------------------


@njit(cache=True, nogil=True)
def fitness_of(found, wrong, wanted, beta):  # type: ignore[no-untyped-def]
    """Return F_beta from numbers of clips (thesis, Eq. 4.9 to 4.11), 0 if none of the class is found."""
    if found == 0:
        return 0.0
    square = beta * beta
    return (1.0 + square) * found / (found + wrong + square * wanted)


@njit(cache=True, nogil=True)
def find_bitmaps(on, off, valid, masks, values, count, space):  # type: ignore[no-untyped-def]
    """Write the cache slot of each keyframe k to space.slots[k], computing the bitmaps that are not cached."""
    most = len(space.masks)
    for k in range(count):
        slot = -1
        for s in range(min(space.made[0], most)):
            if space.masks[s] == masks[k] and space.values[s] == values[k]:
                slot = s
                break
        if slot < 0:
            slot = _free_slot(k, space)
            space.masks[slot] = masks[k]
            space.values[slot] = values[k]
            _bitmap(on, off, valid, masks[k], values[k], space.bitmaps[slot])
        space.slots[k] = slot


@njit(**INNER)
def _free_slot(k, space):  # type: ignore[no-untyped-def]
    """Return the slot of the oldest bitmap that no earlier keyframe of the same query uses."""
    while True:
        slot = space.made[0] % len(space.masks)
        space.made[0] += 1
        used = False
        for before in range(k):
            if space.slots[before] == slot:
                used = True
        if not used:
            return slot


@njit(**INNER)
def _bitmap(on, off, valid, mask, value, out):  # type: ignore[no-untyped-def]
    """Write the bitmap of the frames that match a keyframe."""
    one = np.uint64(1)
    for i in range(len(valid)):
        out[i] = valid[i]
    for f in range(on.shape[0]):
        bit = np.uint64(f)
        if (mask >> bit) & one:
            row = on[f] if (value >> bit) & one else off[f]
            for i in range(len(out)):
                out[i] &= row[i]


@njit(cache=True, nogil=True)
def retrieve(count, strict_lows, strict_highs, lows, highs, first, positives, space):  # type: ignore[no-untyped-def]
    """Write to space.hit[t] True if clip t has a hit; positive clips are tested with the strict gaps."""
    middle, end = first[positives], first[-1]
    _reach(space, count, strict_lows, strict_highs, 0, middle)
    _reach(space, count, lows, highs, middle, end)
    for t in range(len(first) - 1):
        some = np.uint64(0)
        for i in range(first[t], first[t + 1]):
            some |= space.reached[0, i]
        space.hit[t] = some != np.uint64(0)


@njit(**INNER)
def _reach(space, count, lows, highs, begin, end):  # type: ignore[no-untyped-def]
    """Write to space.reached[0] the frames in lanes [begin, end) where a hit of the query ends.

    All lanes are processed together in loops without branches; one clip after the other would take ten times as long.
    """
    here, other, place = space.reached[0], space.reached[1], space.place
    most = 0
    for i in range(begin, end):
        here[i] = space.bitmaps[space.slots[0], i]
        most = max(most, place[i] * 64 + 63)
    for k in range(1, count):
        low = lows[k - 1]
        if low > most or low > highs[k - 1]:
            here[begin:end] = np.uint64(0)
            return
        if low > 0:
            _move(here, other, place, begin, end, low, np.uint64(0))
            here, other = other, here
        span = min(highs[k - 1], most) - low
        widened = 0
        while widened < span:
            step = min(widened + 1, span - widened)
            _move(here, other, place, begin, end, step, ~np.uint64(0))
            here, other = other, here
            widened += step
        some = np.uint64(0)
        bitmap, result = space.bitmaps[space.slots[k]], space.reached[0]
        for i in range(begin, end):
            result[i] = here[i] & bitmap[i]
            some |= result[i]
        here, other = space.reached[0], space.reached[1]
        if some == np.uint64(0):
            return


@njit(**INNER)
def _move(source, target, place, begin, end, frames, keep):  # type: ignore[no-untyped-def]
    """Shift the bits of lanes to later frames of the same clip; the bits in `keep` are also kept where they are."""
    whole = frames // 64
    part = np.uint64(frames % 64)
    rest = np.uint64(63) - part  # plus one more below, as a word cannot be shifted by 64 bits
    one, back = np.uint64(1), np.uint64(whole)
    edge = min(begin + whole + 1, end)
    for i in range(begin, edge):
        moved = np.uint64(0)
        if place[i] >= whole:
            moved = source[i - whole] << part
            if place[i] > whole:
                moved |= (source[i - whole - 1] >> rest) >> one
        target[i] = (source[i] & keep) | moved
    for i in range(np.uint64(edge), np.uint64(end)):
        near = source[i - back] if place[i] >= whole else np.uint64(0)
        far = source[i - back - one] if place[i] > whole else np.uint64(0)
        target[i] = (source[i] & keep) | near << part | (far >> rest) >> one
