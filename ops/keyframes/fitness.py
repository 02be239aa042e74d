"""The fitness of keyframe queries on training clips: which clips have a hit, on bitmaps of frames (thesis, 4.2).

A clip counts as retrieved if the query has one hit in it, so hits are never made: of each keyframe the frames that
match are a bitmap, a gap [low, high] moves and smears the frames reached so far, and what is left after the last
keyframe is not empty where the clip is retrieved. Each clip begins a machine word of its own, so a clip of up to 64
frames is one word, and nothing moves from one clip into the next. Bitmaps of keyframes stay resident: a query that was
changed in one keyframe costs one new bitmap.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from kinedex.ops.errors import ParameterError
from kinedex.ops.keyframes.individuals import Individual
from kinedex.ops.words import I64, MOST_FEATURES, NO_WORD, U64

Bool = npt.NDArray[np.bool_]

_LANE = 64
RESIDENT = 256
"""How many bitmaps of keyframes stay in memory; more than the keyframes of any one query."""

INNER = {"cache": True, "nogil": True, "no_cpython_wrapper": True}
"""How kernels are compiled that only other kernels call: a sixth faster, as nothing of Python is taken apart."""


@dataclass(frozen=True)
class TrainingFrames:
    """The frames of T clips as bitmaps, two for each feature.

    on, off: uint64 (f, W), bit j of on[i - 1, first[t] + w] says that F_i counts as on in frame 64 w + j of clip t. In
    a clip that is judged strictly or kindly (see `training_frames`) a feature may be neither, or both.
    valid: uint64 (W,), the frames that there are and that have a word. first: int64 (T + 1,), where each clip begins.
    """

    on: U64
    off: U64
    valid: U64
    first: I64

    def __len__(self) -> int:
        return len(self.first) - 1


@dataclass(frozen=True)
class Score:
    """How well a query tells positive clips from negative ones.

    positives, negatives: how many of them it retrieves. precision, recall, fitness: Eq. 4.9 to 4.11; all are 0 where
    nothing is retrieved.
    """

    positives: int
    negatives: int
    precision: float
    recall: float
    fitness: float


def training_frames(clips: Sequence[U64], features: int, steady: Sequence[int] | None = None) -> TrainingFrames:
    """Lay clips out as bitmaps.

    Parameters
    ----------
    clips: the words of each clip, uint64 (L_i,); `NO_WORD` matches no keyframe.
    features: number of features f.
    steady: for each clip, how strictly it is judged: n > 0, a feature is on (or off) in a frame only where it is so
        from n frames before to n frames after; n < 0, where it is so in any of these. 0, as it is, unless given. Ends
        of clips go on as they are. Judged so, examples that match only just do not match, and counterexamples that
        almost match do: a query that still tells them apart does so with some room.

    Raises
    ------
    ParameterError: no clip, an empty one, or a number of features out of its domain.
    """
    if not 1 <= features <= MOST_FEATURES:
        raise ParameterError("features", f"between 1 and {MOST_FEATURES}", features)
    if not clips or any(not len(clip) for clip in clips):
        raise ParameterError("clips", "one or more, each with one frame at least", [len(clip) for clip in clips])
    if steady is not None and len(steady) != len(clips):
        raise ParameterError("steady", f"one number for each of the {len(clips)} clips", len(steady))
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
        on[:, piece] = _judged(bits & known, frames) & known
        off[:, piece] = _judged(~bits & known, frames) & known
        valid[piece] = known
    return TrainingFrames(_packed(on), _packed(off), _packed(valid), first)


def _judged(frames: Bool, steady: int) -> Bool:
    """Each row eroded (steady > 0) or dilated (steady < 0) along the frames; beyond the ends they stay as there."""
    if not steady:
        return frames
    reach = abs(steady)
    padded = np.pad(frames, ((0, 0), (reach, reach)), mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1, axis=1)
    result: Bool = np.all(windows, axis=2) if steady > 0 else np.any(windows, axis=2)
    return result


def _packed(frames: Bool) -> U64:
    return np.packbits(frames, axis=-1, bitorder="little").view("<u8").astype(np.uint64)


class Workspace(NamedTuple):
    """What the kernels write to.

    bitmaps: uint64 (RESIDENT, W), the frames that match a keyframe; masks, values: uint64 (RESIDENT,), which one; made:
    int64 (1,), how many were. slots: int64 (K,), where the keyframes of one query are. lows, highs: int64 (K,), gaps.
    reached: uint64, the frames reached in the longest clip. hit: bool (T,), which clips are retrieved.
    """

    bitmaps: U64
    masks: U64
    values: U64
    made: I64
    slots: I64
    lows: I64
    highs: I64
    reached: U64
    hit: Bool


def new_workspace(frames: TrainingFrames, keyframes: int) -> Workspace:
    """Workspace to evaluate queries of up to so many keyframes on these clips."""
    return Workspace(
        np.zeros((RESIDENT, len(frames.valid)), np.uint64),
        np.zeros(RESIDENT, np.uint64),
        np.zeros(RESIDENT, np.uint64),
        np.zeros(1, np.int64),
        np.zeros(keyframes, np.int64),
        np.zeros(keyframes, np.int64),
        np.zeros(keyframes, np.int64),
        np.zeros(int(np.diff(frames.first).max()), np.uint64),
        np.zeros(len(frames), np.bool_),
    )


def retrieved(frames: TrainingFrames, query: Individual) -> Bool:
    """Tell for each clip whether a query has a hit in it, bool (T,)."""
    room = new_workspace(frames, len(query))
    find_bitmaps(frames.on, frames.off, frames.valid, query.masks, query.values, len(query), room)
    retrieve(len(query), query.lows, query.highs, query.lows, query.highs, frames.first, 0, room)
    return room.hit


def score(hit: Bool, positive: Bool, beta: float) -> Score:
    """Measure what is retrieved against what should be (thesis, Eq. 4.9 to 4.11).

    Parameters
    ----------
    hit, positive: bool (T,), which clips are retrieved, and which are of the class.
    beta: how many times recall weighs as much as precision.
    """
    found = int(np.count_nonzero(hit & positive))
    wrong = int(np.count_nonzero(hit & ~positive))
    wanted = int(np.count_nonzero(positive))
    precision = found / (found + wrong) if found + wrong else 0.0
    recall = found / wanted if wanted else 0.0
    return Score(found, wrong, precision, recall, float(fitness_of(found, wrong, wanted, beta)))


# ---- kernels ---------------------------------------------------------------------------------------------


@njit(cache=True, nogil=True)
def fitness_of(found, wrong, wanted, beta):  # type: ignore[no-untyped-def]
    """F_beta from counts (Eq. 4.11), without a division by nothing: 0 where nothing of the class is found."""
    if found == 0:
        return 0.0
    square = beta * beta
    return (1.0 + square) * found / (found + wrong + square * wanted)


@njit(cache=True, nogil=True)
def find_bitmaps(on, off, valid, masks, values, count, room):  # type: ignore[no-untyped-def]
    """Put into room.slots[k] where the bitmap of keyframe k is, making those that are not resident."""
    most = len(room.masks)
    for k in range(count):
        slot = -1
        for s in range(min(room.made[0], most)):
            if room.masks[s] == masks[k] and room.values[s] == values[k]:
                slot = s
                break
        if slot < 0:
            slot = _free_slot(k, room)
            room.masks[slot] = masks[k]
            room.values[slot] = values[k]
            _bitmap(on, off, valid, masks[k], values[k], room.bitmaps[slot])
        room.slots[k] = slot


@njit(**INNER)
def _free_slot(k, room):  # type: ignore[no-untyped-def]
    # The oldest gives way, unless an earlier keyframe of the same query is there.
    while True:
        slot = room.made[0] % len(room.masks)
        room.made[0] += 1
        used = False
        for before in range(k):
            if room.slots[before] == slot:
                used = True
        if not used:
            return slot


@njit(**INNER)
def _bitmap(on, off, valid, mask, value, out):  # type: ignore[no-untyped-def]
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
def retrieve(count, strict_lows, strict_highs, lows, highs, first, positives, room):  # type: ignore[no-untyped-def]
    """Set room.hit[t]: does clip t meet all keyframes in a chain of frames? Positive clips under the strict gaps."""
    for t in range(len(first) - 1):
        if t < positives:
            low, high = strict_lows, strict_highs
        else:
            low, high = lows, highs
        begin, end = first[t], first[t + 1]
        if end - begin == 1:
            room.hit[t] = _one_lane(room.bitmaps, room.slots, count, low, high, begin)
        else:
            room.hit[t] = _more_lanes(room.bitmaps, room.slots, count, low, high, begin, end, room.reached)


@njit(**INNER)
def _one_lane(bitmaps, slots, count, lows, highs, lane):  # type: ignore[no-untyped-def]
    alive = bitmaps[slots[0], lane]
    for k in range(1, count):
        if alive == np.uint64(0):
            return False
        low = lows[k - 1]
        if low > 63 or low > highs[k - 1]:
            return False
        alive <<= np.uint64(low)
        span = min(highs[k - 1], 63) - low
        smeared = 0
        while smeared < span:
            step = min(smeared + 1, span - smeared)
            alive |= alive << np.uint64(step)
            smeared += step
        alive &= bitmaps[slots[k], lane]
    return alive != np.uint64(0)


@njit(**INNER)
def _more_lanes(bitmaps, slots, count, lows, highs, begin, end, reached):  # type: ignore[no-untyped-def]
    lanes = end - begin
    most = lanes * 64 - 1
    some = np.uint64(0)
    for i in range(lanes):
        reached[i] = bitmaps[slots[0], begin + i]
        some |= reached[i]
    for k in range(1, count):
        low = lows[k - 1]
        if some == np.uint64(0) or low > most or low > highs[k - 1]:
            return False
        if low > 0:
            _move(reached, lanes, low, np.uint64(0))
        span = min(highs[k - 1], most) - low
        smeared = 0
        while smeared < span:
            step = min(smeared + 1, span - smeared)
            _move(reached, lanes, step, ~np.uint64(0))
            smeared += step
        some = np.uint64(0)
        for i in range(lanes):
            reached[i] &= bitmaps[slots[k], begin + i]
            some |= reached[i]
    return some != np.uint64(0)


@njit(**INNER)
def _move(lane, lanes, frames, keep):  # type: ignore[no-untyped-def]
    # From the last lane to the first, so that what is read was not moved yet; keep: the bits that also stay.
    whole = frames // 64
    part = np.uint64(frames % 64)
    rest = np.uint64(64) - part
    for back in range(lanes):
        i = lanes - 1 - back
        moved = np.uint64(0)
        if i >= whole:
            moved = lane[i - whole] << part
            if part != np.uint64(0) and i > whole:
                moved |= lane[i - whole - 1] >> rest
        lane[i] = (lane[i] & keep) | moved
