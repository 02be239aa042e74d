"""This module proposes keyframes from an example: those of its poses that are rare in an archive."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from kinedex.ops.errors import ParameterError
from kinedex.ops.words import ALL_KNOWN, I64, NO_WORD, U64

MAX_FEATURES_FIXED = 6
"""Maximum number of features that a proposed keyframe fixes; the others are wildcards, to keep the keyframe general."""

RARE_ENOUGH = 0.01
"""Share of the archive's frames at which a keyframe is rare enough to get no further features."""

WORTH_FIXING = 0.8
"""A feature is only fixed if the keyframe then matches at most this share of the frames that it matched before."""

_STEADY = 1
"""Number of frames on either side in which a feature must not change to be fixed."""


@dataclass(frozen=True)
class SetCounts:
    """The number of frames of each word of one feature set in an archive.

    Parameters
    ----------
    first : int
        The number of the set's lowest feature, from 1.
    count : int
        The number of features of the set.
    words : uint64 array (V,)
        Words reduced to the set.
    frames : int64 array (V,)
        The number of frames of each word.
    """

    first: int
    count: int
    words: U64
    frames: I64


@dataclass(frozen=True)
class Pose:
    """A proposed keyframe, which is the pose of one frame of the example.

    Parameters
    ----------
    frame : int
        A frame of the example.
    mask, value : int
        The keyframe in bits of whole words.
    share : float
        The fraction of the archive's frames that match, as if the feature sets were independent.
    """

    frame: int
    mask: int
    value: int
    share: float


def propose_poses(clip: U64, counts: Sequence[SetCounts], most: int, known: int = int(ALL_KNOWN)) -> list[Pose]:
    """Choose the keyframes that best distinguish an example from an archive.

    For every run of equal words in the example, a pose is built greedily: the feature that leaves the fewest matching
    frames of the archive is added next, of those that do not change nearby. Then the sequence of poses with the
    smallest product of shares is chosen. Successive poses must differ, and must be at least ⌊L / (2 · most)⌋ frames
    apart, about half the distance of evenly spaced poses.

    Parameters
    ----------
    clip : uint64 array (L,)
        The whole words of the example.
    counts : sequence of SetCounts
        The words of the archive, set by set.
    most : int
        The largest number of keyframes, at least 1.
    known : int
        The mask of the features that are known in the example; poses fix only these.

    Returns
    -------
    list of Pose
        1 to `most` poses, in order of time. The example itself matches all of them.

    Raises
    ------
    ParameterError
        If the example has no valid frame, or `most` is below 1.
    """
    if most < 1:
        raise ParameterError("keyframes", "at least 1", most)
    valid = clip != NO_WORD
    if not valid.any():
        raise ParameterError("clip", "of at least one valid frame", len(clip))
    changed = np.flatnonzero(clip[1:] != clip[:-1]) + 1
    edges = np.concatenate([[0], changed, [len(clip)]])
    middles = (edges[:-1] + edges[1:] - 1) // 2
    poses = [_pose(clip, int(frame), counts, ~known) for frame in middles if valid[frame]]
    apart = max(len(clip) // (2 * most), 1)
    return _choose(poses, min(most, len(poses)), apart)


def _pose(clip: U64, frame: int, counts: Sequence[SetCounts], unknown: int) -> Pose:
    """Return the pose of one frame with its rarest steady features, chosen greedily."""
    around = clip[max(frame - _STEADY, 0) : frame + _STEADY + 1]
    around = around[around != NO_WORD]
    changing = int(np.bitwise_or.reduce(around ^ clip[frame])) | unknown
    word = int(clip[frame])
    masks = [0] * len(counts)
    shares = [1.0] * len(counts)
    for _ in range(MAX_FEATURES_FIXED):
        best = (WORTH_FIXING, -1, 0, 0.0)
        for number, one in enumerate(counts):
            mine, unsteady = word >> (one.first - 1), changing >> (one.first - 1)
            for bit in range(one.count):
                if (masks[number] | unsteady) >> bit & 1:
                    continue
                mask = masks[number] | 1 << bit
                share = _share(one, mask, mine & mask)
                if share < best[0] * shares[number]:
                    best = (share / shares[number], number, mask, share)
        if best[1] < 0 or np.prod(shares) <= RARE_ENOUGH:
            break
        masks[best[1]], shares[best[1]] = best[2], best[3]
    mask = sum(m << (one.first - 1) for m, one in zip(masks, counts, strict=True))
    return Pose(frame, mask, word & mask, float(np.prod(shares)))


def _share(counts: SetCounts, mask: int, value: int) -> float:
    """Return the fraction of an archive's frames that match a keyframe of one feature set."""
    met = (counts.words & np.uint64(mask)) == np.uint64(value)
    return float(counts.frames[met].sum() / max(counts.frames.sum(), 1))


def _choose(poses: list[Pose], most: int, apart: int) -> list[Pose]:
    """Return the best sequence of at most `most` poses, by dynamic programming over (poses used, last pose)."""
    gains = np.array([-np.log2(max(pose.share, 1e-12)) for pose in poses])
    frames = np.array([pose.frame for pose in poses])
    kinds = {key: number for number, key in enumerate(dict.fromkeys((pose.mask, pose.value) for pose in poses))}
    kind = np.array([kinds[pose.mask, pose.value] for pose in poses])
    totals = [gains]
    before: list[npt.NDArray[np.int64]] = []
    for _ in range(most - 1):
        total, last = np.full(len(poses), -np.inf), np.full(len(poses), -1)
        for place in range(1, len(poses)):
            allowed = (frames[:place] <= frames[place] - apart) & (kind[:place] != kind[place])
            reached = np.where(allowed, totals[-1][:place], -np.inf)
            last[place] = int(np.argmax(reached))
            total[place] = reached[last[place]] + gains[place]
        totals.append(total)
        before.append(last)
    used = max(range(most), key=lambda count: float(totals[count].max()))
    chain = [int(np.argmax(totals[used]))]
    for last in reversed(before[:used]):
        chain.append(int(last[chain[-1]]))
    return [poses[place] for place in reversed(chain)]
