"""This module finds gaps in trajectories, in which a point was not seen, and interpolates short gaps."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby

import numpy as np

from kinedex.ops.arrays import F64


@dataclass(frozen=True)
class Gap:
    """A gap: a point is missing from frame `start` up to, not including, `stop`."""

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
        float64 (points, 3, T) with NaN in the gaps.

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
