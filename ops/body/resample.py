"""This module changes frame rates: positions are interpolated linearly, orientations by slerp.

It also finds gaps, in which a point was not seen, and fills short gaps by interpolation.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby
from typing import NamedTuple

import numpy as np

from kinedex.ops.arrays import F64, Bool
from kinedex.ops.errors import ParameterError

_ON_A_FRAME = 1e-9  # interpolation weights below this are rounding errors


def feature_rate(source_rate_hz: float, rate_hz: float) -> float:
    """Return the multiple of the analysis rate that is nearest to a source rate, at least the analysis rate.

    Features are computed at this rate, and then one frame in every `multiple` frames is kept. Ties are rounded up.
    """
    if not (np.isfinite(source_rate_hz) and source_rate_hz > 0):
        raise ParameterError("source_rate_hz", "positive and finite", source_rate_hz)
    return rate_hz * max(1, int(np.floor(source_rate_hz / rate_hz + 0.5)))


class Sampled(NamedTuple):
    """A take at another rate: positions (J, 3, T'), orientation (4, T'), and valid frames (T',), None for all."""

    positions: F64
    orientation: F64
    valid: Bool | None


def resample(
    positions: F64, orientation: F64, source_rate_hz: float, rate_hz: float, valid: Bool | None = None
) -> Sampled:
    """Resample a take to another rate; frame 0 keeps its time, and nothing is extrapolated past the last frame.

    Parameters
    ----------
    positions : float64 array (J, 3, T)
        Joint positions in metres.
    orientation : float64 array (4, T)
        Unit quaternions.
    source_rate_hz, rate_hz : float
        Frames per second of the input and of the result.
    valid : bool array (T,)
        The valid frames; None if all are valid.

    Returns
    -------
    Sampled
        The take with T' = floor((T − 1) · rate / source_rate) + 1 frames, unchanged if both rates are equal. A frame is
        valid if the frames that it is interpolated from are valid.
    """
    frames = positions.shape[2]
    if source_rate_hz == rate_hz or frames < 2:
        return Sampled(positions, orientation, valid)
    count = int(np.floor(round((frames - 1) * rate_hz / source_rate_hz, 9))) + 1
    at = np.minimum(np.arange(count) * (source_rate_hz / rate_hz), frames - 1)
    left = np.minimum(np.floor(np.round(at, 9)).astype(np.int64), frames - 2)
    share = at - left
    # A sample that falls on a source frame does not depend on the neighbouring frames.
    left, right = np.where(share > 1.0 - _ON_A_FRAME, left + 1, left), np.where(share > _ON_A_FRAME, left + 1, left)
    moved = np.empty((*positions.shape[:2], count))
    for joint, track in enumerate(positions):
        moved[joint] = track[:, left] * (1.0 - share) + track[:, right] * share
    turned = _slerp(orientation[:, left], orientation[:, right], share)
    return Sampled(moved, turned, None if valid is None else valid[left] & valid[right])


def covered_frames(start: int, stop: int, frames: int, source_rate_hz: float, rate_hz: float) -> tuple[int, int]:
    """Return the interval of source frames that an interval of resampled frames covers.

    Frame t of the result lasts from t / rate to (t + 1) / rate seconds, and covers the source frames that begin in this
    time. Hence adjacent intervals share no source frame. Resampling the covered source frames gives as many frames as
    the interval has, or one more or less if the source is slower than the result. To achieve this, a few more source
    frames may be included if the ratio of the rates is not an integer.

    Parameters
    ----------
    start, stop : int
        The interval [start, stop) in frames of the result of `resample`.
    frames : int
        The number of source frames.
    source_rate_hz, rate_hz : float
        Frames per second of the source and of the result.

    Returns
    -------
    tuple of (int, int)
        The interval in source frames.

    Raises
    ------
    ParameterError
        The interval is empty, or the source has no frames there.
    """
    step = source_rate_hz / rate_hz
    first, last = _ceil(start * step), _ceil((stop - 1) * step)
    if not 0 <= start < stop or last >= frames + max(step, 1.0):
        raise ParameterError("start and stop", f"an interval of frames within {frames} source frames", (start, stop))
    needed = _ceil((stop - start - 1) * step) + 1
    end = max(_ceil(stop * step), first + needed)
    if end <= frames:
        return first, end
    # at the end of the source there are no further frames, so the interval begins one frame earlier
    return (first if frames - first >= needed else max(0, int(np.floor(round(start * step, 9))))), frames


def _ceil(number: float) -> int:
    return int(np.ceil(round(number, 9)))


def _slerp(a: F64, b: F64, share: F64) -> F64:
    cosine = np.sum(a * b, axis=0)
    b = np.where(cosine < 0, -b, b)
    angle = np.arccos(np.clip(np.abs(cosine), 0.0, 1.0))
    sine = np.sin(angle)
    near = sine < 1e-9  # Both are the same rotation: interpolate linearly instead of dividing by zero.
    safe = np.where(near, 1.0, sine)
    first = np.where(near, 1.0 - share, np.sin((1.0 - share) * angle) / safe)
    second = np.where(near, share, np.sin(share * angle) / safe)
    mixed = a * first + b * second
    return np.ascontiguousarray(mixed / np.linalg.norm(mixed, axis=0))


@dataclass(frozen=True)
class Gap:
    """A gap in the track of a point, which is missing from frame `start` up to, but not including, `stop`."""

    point: int
    start: int
    stop: int

    @property
    def frames(self) -> int:
        """Return the number of frames in the gap."""
        return self.stop - self.start


def find_gaps(positions: F64) -> list[Gap]:
    """Return all gaps, by point and then by frame.

    Parameters
    ----------
    positions : float64 array (points, 3, T)
        A point is missing where any of its coordinates is NaN.
    """
    missing = np.count_nonzero(np.isnan(positions), axis=1) > 0
    found = []
    for point in np.flatnonzero(np.count_nonzero(missing, axis=1)):
        edges = np.flatnonzero(np.diff(missing[point], prepend=False, append=False))
        found += [Gap(int(point), int(start), int(stop)) for start, stop in edges.reshape(-1, 2)]
    return found


def fill_gaps(positions: F64, longest: int) -> tuple[F64, list[Gap], list[Gap]]:
    """Fill gaps of up to `longest` frames along straight lines; at the ends of a take the nearest position is repeated.

    Parameters
    ----------
    positions : float64 array
        Positions (points, 3, T), NaN in the gaps.

    Returns
    -------
    tuple[float64 array, list of Gap, list of Gap]
        A filled copy, the gaps that were filled, and those that are too long or have no known frame.
    """
    filled = positions.copy()
    frames = np.arange(positions.shape[2])
    closed: list[Gap] = []
    left: list[Gap] = []
    for gap in find_gaps(positions):
        (left if gap.frames > longest or gap.frames == len(frames) else closed).append(gap)
    for point, gaps in groupby(closed, key=lambda gap: gap.point):
        missing = np.isnan(positions[point]).any(axis=0)
        wanted = np.zeros(len(frames), np.bool_)
        for gap in gaps:
            wanted[gap.start : gap.stop] = True
        for axis in range(3):
            filled[point, axis, wanted] = np.interp(frames[wanted], frames[~missing], positions[point, axis, ~missing])
    return filled, closed, left
