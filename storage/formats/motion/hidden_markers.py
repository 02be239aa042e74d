"""Close gaps of markers: short ones along straight lines, longer ones by the other markers of their segment."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from kinedex.catalog.skeletons.marker_segments import marker_segments
from kinedex.ops.arrays import F64, I64
from kinedex.ops.body.resample import Gap, fill_gaps
from kinedex.ops.body.rigid_segments import placed_by_segment

_OFF = 0.012  # share of the extent of all markers, some 2 cm of a body: the largest error of a template


class Closed(NamedTuple):
    """The result of closing gaps: gaps that were closed, gaps that remain, and markers that segments have placed.

    A gap gives its point by an index into the used points, those of which joints are made.

    Attributes
    ----------
    lines : list of Gap
        Gaps closed along straight lines.
    left : list of Gap
        Gaps that remain.
    markers : dict of int to int64 array (T,)
        Marker that its segment places → the number of markers that the pose of the segment is fitted to in each frame;
        0 where the marker is not placed.
    """

    lines: list[Gap]
    left: list[Gap]
    markers: dict[int, I64]

    @property
    def frames(self) -> int:
        """The number of frames in which a marker is placed by its segment."""
        return int(np.count_nonzero(np.any(list(self.markers.values()), axis=0))) if self.markers else 0

    @property
    def least(self) -> int | None:
        """The smallest number of markers that a segment's pose is fitted to; None where no marker is placed."""
        return min((int(counts[counts > 0].min()) for counts in self.markers.values()), default=None)


def close_gaps(positions: F64, used: Sequence[int], longest: int, names: Sequence[str] | None) -> Closed:
    """Close gaps of the used points in place.

    Parameters
    ----------
    positions : float64 array (N, 3, T)
        The points of a file.
    used : sequence of int
        Indices of the points of which joints are made.
    longest : int
        The longest gap in frames that is closed along a straight line.
    names : sequence of str, optional
        The labels of the points, if they are markers that segments may place.
    """
    lines, left = _straight(positions, used, longest)
    markers = _by_segments(positions, names, left, used) if left and names is not None else {}
    if markers:
        more, left = _straight(positions, used, longest)
        lines += more
    return Closed(lines, left, markers)


def _straight(positions: F64, used: Sequence[int], longest: int) -> tuple[list[Gap], list[Gap]]:
    """Fill short gaps of the used points in place; return filled and remaining gaps, with indices into `used`."""
    closed: list[Gap] = []
    left: list[Gap] = []
    for place, index in enumerate(used):
        if np.isnan(positions[index]).any():
            (positions[index],), *gaps = fill_gaps(positions[index : index + 1], longest)
            for found, of_point in zip((closed, left), gaps, strict=True):
                found += [replace(gap, point=place) for gap in of_point]
    return closed, left


def _by_segments(positions: F64, names: Sequence[str], gaps: Iterable[Gap], used: Sequence[int]) -> dict[int, I64]:
    """Fill gaps of markers in place by the poses of their segments, where three other markers of a segment are seen."""
    segments = marker_segments(names)
    hidden: dict[int, list[Gap]] = {}
    for gap in gaps:
        if any(used[gap.point] in markers for markers in segments.values()):
            hidden.setdefault(used[gap.point], []).append(gap)
    if not hidden:
        return {}
    tolerance = _OFF * _extent(positions)
    placed = {marker: _placed(positions, marker, those, segments, tolerance) for marker, those in hidden.items()}
    for marker, (track, counts) in placed.items():  # by markers that are seen, not by those that are placed
        positions[marker][:, counts > 0] = track[:, counts > 0]
    return {marker: counts for marker, (_, counts) in placed.items() if counts.any()}


def _placed(
    positions: F64, marker: int, gaps: Iterable[Gap], segments: dict[str, list[int]], tolerance: float
) -> tuple[F64, I64]:
    """Return a marker (3, T) with gaps filled by the first segment that can, and the numbers of markers used."""
    track, counts = positions[marker].copy(), np.zeros(positions.shape[2], np.int64)
    wanted = np.zeros(positions.shape[2], np.bool_)
    for gap in gaps:
        wanted[gap.start : gap.stop] = True
    for markers in (markers for markers in segments.values() if marker in markers):
        found = placed_by_segment(positions[markers], markers.index(marker), wanted & (counts == 0), tolerance)
        there = found.markers > 0
        track[:, there], counts[there] = found.positions[:, there], found.markers[there]
    return track, counts


def placed_in_words(closed: Closed, names: Sequence[str], most: int = 6) -> str:
    """Return a warning on the markers that their segments place, by descending number of frames."""
    worst = sorted(closed.markers.items(), key=lambda item: -np.count_nonzero(item[1]))
    shown = [f"{names[marker]} {_counts_in_words(counts[counts > 0])}" for marker, counts in worst[:most]]
    more = f" and {len(worst) - most} more points" if len(worst) > most else ""
    return f"hidden markers estimated by the pose of their segment: {', '.join(shown)}{more}"


def _counts_in_words(counts: I64) -> str:
    least, most = int(counts.min()), int(counts.max())
    return f"{len(counts)} frames (from {least}{f' to {most}' if most > least else ''} markers)"


def _extent(positions: F64) -> float:
    """Return the extent of all markers in a frame, the median over some frames."""
    frames = np.flatnonzero(np.isfinite(positions).any(axis=(0, 1)))
    some = positions[:, :, frames[np.unique(np.linspace(0, len(frames) - 1, 64).astype(int))]]
    with np.errstate(over="ignore", invalid="ignore"):
        return float(np.median(np.linalg.norm(np.nanmax(some, axis=0) - np.nanmin(some, axis=0), axis=0)))
