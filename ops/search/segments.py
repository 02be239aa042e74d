"""Segments of frames on one axis for a whole archive.

Every frame of an archive has one position on a single int64 axis, `take_index << 32 | frame`. A frame is
below 2**31 and a gap is clamped to 2**31 - 1, so a frame plus a gap stays below 2**32 and a frame minus a
gap ends in the upper half of the take before, where no frame is: no hit leaves its take, unbounded gaps
included. A stop is at most 2**31, half a block before the next take begins, so segments of different takes
neither overlap nor touch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from kinedex.ops.errors import ParameterError
from kinedex.ops.words import I64

_TAKE_BITS = 32
_MAX_FRAMES = 2**31


@dataclass(frozen=True)
class Segments:
    """Maximal segments on the axis of positions: ascending, neither overlapping nor touching (Eq. 3.6).

    starts, stops: int64 (n,), positions; segment i holds the positions starts[i] .. stops[i] - 1.
    """

    starts: I64
    stops: I64

    def __post_init__(self) -> None:
        if self.starts.dtype != np.int64 or self.stops.dtype != np.int64:
            raise ParameterError("segments", "int64", (self.starts.dtype, self.stops.dtype))
        if self.starts.ndim != 1 or self.starts.shape != self.stops.shape:
            raise ParameterError("segments", "as many starts as stops", (self.starts.shape, self.stops.shape))
        if (self.starts >= self.stops).any() or (self.starts[1:] <= self.stops[:-1]).any():
            raise ParameterError("segments", "not empty, ascending and apart (see `merge`)", "others")

    @classmethod
    def known(cls, starts: I64, stops: I64) -> Segments:
        """Segments that are maximal and int64 because of how they were made: not checked, which takes longer than a
        search in some minutes of motion."""
        made = cls.__new__(cls)
        made.__dict__["starts"], made.__dict__["stops"] = starts, stops
        return made

    def __len__(self) -> int:
        return len(self.starts)

    @property
    def frames(self) -> int:
        """How many frames the segments hold together."""
        return int((self.stops - self.starts).sum())


def to_axis(take_index: npt.ArrayLike, frame: npt.ArrayLike) -> I64:
    """Put frames of takes on the axis of positions.

    Parameters
    ----------
    take_index: (n,), the rank of each frame's take, from 0.
    frame: (n,), frames or stops, 0 to 2**31.

    Returns
    -------
    int64 (n,), `take_index << 32 | frame`.

    Raises
    ------
    ParameterError: a frame or a take that does not fit on the axis.
    """
    takes = np.asarray(take_index, dtype=np.int64)
    frames = np.asarray(frame, dtype=np.int64)
    if frames.size and (frames.min() < 0 or frames.max() > _MAX_FRAMES):
        raise ParameterError("frame", f"0 to {_MAX_FRAMES}", (int(frames.min()), int(frames.max())))
    if takes.size and (takes.min() < 0 or takes.max() >= _MAX_FRAMES):
        raise ParameterError("take_index", f"0 to {_MAX_FRAMES - 1}", (int(takes.min()), int(takes.max())))
    return (takes << _TAKE_BITS) + frames


def from_axis(segments: Segments) -> tuple[I64, I64, I64]:
    """Take segments off the axis: take indices, starts and stops in frames of the take, int64 (n,)."""
    takes = segments.starts >> _TAKE_BITS
    return takes, segments.starts - (takes << _TAKE_BITS), segments.stops - (takes << _TAKE_BITS)


def merge(starts: I64, stops: I64) -> Segments:
    """Unite segments, so that those which overlap or touch become one.

    Parameters
    ----------
    starts, stops: int64 (n,), positions, half-open, in any order; empty segments (start = stop) vanish.

    Returns
    -------
    The union as maximal segments.

    Raises
    ------
    ParameterError: a stop before its start.
    """
    starts, stops = np.asarray(starts, np.int64), np.asarray(stops, np.int64)
    if (stops < starts).any():
        raise ParameterError("stops", "not before their starts", "an earlier one")
    full = stops > starts
    if not full.all():
        starts, stops = starts[full], stops[full]
    if (starts[1:] < starts[:-1]).any():
        order = np.argsort(starts, kind="stable")
        starts, stops = starts[order], stops[order]
    if not len(starts):
        return Segments(starts, stops)
    reached = np.maximum.accumulate(stops)
    return _close_up(starts, reached)


def join_runs(starts: I64, stops: I64) -> Segments:
    """Unite runs that touch; unlike those of `merge`, they are pairwise disjoint, and none is empty.

    Parameters
    ----------
    starts, stops: int64 (n,), positions, half-open, in any order.
    """
    if (starts[1:] < starts[:-1]).any():
        # Runs are disjoint, so starts and stops sorted each for itself still belong together.
        starts, stops = np.sort(starts, kind="stable"), np.sort(stops, kind="stable")
    return _close_up(starts, stops)


def _close_up(starts: I64, stops: I64) -> Segments:
    """Unite touching neighbours of segments whose starts and stops both ascend."""
    if len(starts) < 2:
        return Segments(starts, stops)
    apart = starts[1:] > stops[:-1]
    return Segments(starts[np.concatenate(([True], apart))], stops[np.concatenate((apart, [True]))])
