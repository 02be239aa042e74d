"""This module finds near-duplicates: clips that show the same motion, compared by the positions of their joints.

Near-duplicates may be two performances with slightly different speeds and poses. By contrast, `ops.duplicates` finds
recordings that an archive holds twice. It searches for equal runs of words, which two performances rarely have in
common, and also finds parts of takes and copies at other frame rates.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kinedex.ops.arrays import F32, F64, I64, Bool
from kinedex.ops.body.facing_direction import Placement, start_at_origin
from kinedex.ops.errors import ParameterError

MOMENTS = 32
"""Number of evenly spread moments of a clip at which clips are compared."""

_BLOCK = 256


def motion_outline(positions: F64, placement: Placement) -> F32:
    """Return the outline of a clip: its joints at `MOMENTS` moments, moved to start at the origin facing +Z.

    Parameters
    ----------
    positions : float array (T, J, 3)
        Positions in metres, Y up; NaN if a joint is not known.
    placement : Placement
        The body's placement in the first frame.

    Returns
    -------
    float32 array (MOMENTS, J, 3)
        The positions, interpolated between frames.
    """
    at = np.linspace(0.0, len(positions) - 1.0, MOMENTS)
    left = np.floor(at).astype(np.int64)
    right = np.minimum(left + 1, len(positions) - 1)
    share = (at - left)[:, None, None]
    moved = np.where(share > 0, positions[left] * (1.0 - share) + positions[right] * share, positions[left])
    return start_at_origin(moved, placement).astype(np.float32)


def near_duplicates(outlines: Sequence[F32] | F32, seconds: Sequence[float] | F64, most: float) -> list[int]:
    """Find for each clip the first earlier one that shows the same motion.

    Two clips show the same motion if the root mean square distance of their outlines, over all moments and the joints
    known in both clips, is less than `most` metres, and if their durations differ by at most a tenth of the longer one.
    A clip is compared only with earlier clips that are not duplicates themselves.

    Parameters
    ----------
    outlines : sequence of float32 array (MOMENTS, J, 3)
        Outlines of N clips (`motion_outline`).
    seconds : sequence of float (N,)
        The durations of the clips in seconds.
    most : float
        The distance in metres from which clips count as different.

    Returns
    -------
    list of int (N,)
        For each clip the index of the earlier clip; −1 if there is none.

    Raises
    ------
    ParameterError
        The difference is not above 0.
    """
    if not most > 0:
        raise ParameterError("most", "metres above 0", most)
    count = len(outlines)
    same = [-1] * count
    if not count:
        return same
    points = np.asarray(outlines, np.float32).reshape(count, -1)
    known = np.isfinite(points)
    values = np.where(known, points, 0.0)
    whole = bool(known.all())
    durations = np.asarray(seconds, np.float64)
    kept = np.empty(0, np.int64)
    for first in range(0, count, _BLOCK):
        block = np.arange(first, min(first + _BLOCK, count))
        candidates = np.concatenate([kept, block])
        near = _distances(values, known, whole, block, candidates) < most
        longer = np.maximum(durations[block][:, None], durations[candidates][None, :])
        near &= np.abs(durations[block][:, None] - durations[candidates][None, :]) <= 0.1 * longer
        found: list[int] = []
        # from here on, a clip of this block that is no duplicate is compared with the later ones
        usable = np.arange(len(candidates)) < len(kept)
        for row, clip in enumerate(block.tolist()):
            matches = near[row] & usable
            place = int(np.argmax(matches))
            if matches[place]:
                same[clip] = int(candidates[place])
            else:
                found.append(clip)
                usable[len(kept) + row] = True
        kept = np.concatenate([kept, np.array(found, np.int64)])
    return same


def _distances(values: F32, known: Bool, whole: bool, rows: I64, columns: I64) -> F64:
    """Return the distances in metres between clips; infinity where no joint is known in both."""
    a, b = values[rows], values[columns]
    if whole:
        squares = np.square(a).sum(axis=1, dtype=np.float64)[:, None] + np.square(b).sum(axis=1, dtype=np.float64)
        squares = squares - 2.0 * (a.astype(np.float64) @ b.astype(np.float64).T)
        return np.sqrt(np.maximum(squares, 0.0) / (values.shape[1] / 3))
    here, there = known[rows].astype(np.float64), known[columns].astype(np.float64)
    wide_a, wide_b = a.astype(np.float64), b.astype(np.float64)
    squares = np.square(wide_a) @ there.T + here @ np.square(wide_b).T - 2.0 * (wide_a @ wide_b.T)
    common = here @ there.T / 3
    return np.sqrt(np.where(common > 0, np.maximum(squares, 0.0) / np.maximum(common, 1.0), np.inf))
