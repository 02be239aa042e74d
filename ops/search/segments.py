"""This module represents segments of frames on one axis for a whole archive.

Every frame of an archive has one position on an int64 axis, ``take_index << 32 | frame``. A list of segments is an
int64 array (n, 2) of half-open ranges of positions, ascending, neither overlapping nor touching (thesis, Eq. 3.5 and
3.6).

A frame is below 2**31 and a gap is clamped to 2**31 - 1. So a frame plus a gap stays below 2**32, and a frame minus a
gap ends in the upper half of the take before, where no frame is: no hit leaves its take, not even with an unbounded
gap. A stop is at most 2**31, half a block before the next take begins, so segments of two takes neither overlap nor
touch.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from kinedex.ops.errors import ParameterError
from kinedex.ops.words import I64

TAKE_BITS = 32
"""Base-2 logarithm of the distance between takes on the axis."""

_MAX_FRAMES = 2**31


def to_axis(take_index: npt.ArrayLike, frame: npt.ArrayLike) -> I64:
    """Return the positions of frames of takes on the axis.

    Parameters
    ----------
    take_index : array_like (n,)
        The index of the take of each frame, from 0.
    frame : array_like (n,)
        Frames or stops of the takes, 0 to 2**31.

    Returns
    -------
    int64 array (n,)
        ``take_index << 32 | frame``.

    Raises
    ------
    ParameterError
        If a frame or a take does not fit on the axis.
    """
    takes = np.asarray(take_index, dtype=np.int64)
    frames = np.asarray(frame, dtype=np.int64)
    if frames.size and (frames.min() < 0 or frames.max() > _MAX_FRAMES):
        raise ParameterError("frame", f"0 to {_MAX_FRAMES}", (int(frames.min()), int(frames.max())))
    if takes.size and (takes.min() < 0 or takes.max() >= _MAX_FRAMES):
        raise ParameterError("take_index", f"0 to {_MAX_FRAMES - 1}", (int(takes.min()), int(takes.max())))
    return (takes << TAKE_BITS) + frames


def from_axis(segments: I64) -> tuple[I64, I64]:
    """Return the take indices, int64 (n,), and the frame ranges, int64 (n, 2), of segments of the axis."""
    takes = segments[:, 0] >> TAKE_BITS
    return takes, segments - (takes << TAKE_BITS)[:, None]
