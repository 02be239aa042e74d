"""Close gaps of markers: short ones along straight lines, longer ones by the other markers of their segment."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from kinedex.catalog.skeletons.marker_segments import marker_segments
from kinedex.ops.arrays import F64, I64, Bool
from kinedex.ops.body.resample import Gap, fill_gaps
from kinedex.ops.body.rigid_segments import Placed, PlacedByShape, placed_by_segment, placed_by_shape

_OFF = 0.012  # share of the extent of all markers, some 2 cm of a body: the largest error of a template


Shapes = Mapping[str, Mapping[str, F64]]
"""The shapes of segments in a static trial: segment → label → place (3,) in any axes of the segment."""


@dataclass(frozen=True)
class Closed:
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
    by_static : dict of int to int64 array (T,)
        The same for markers that are placed by the shape of their segment in a static trial.
    """

    lines: list[Gap]
    left: list[Gap]
    markers: dict[int, I64]
    by_static: dict[int, I64] = field(default_factory=dict)

    @property
    def counts(self) -> list[I64]:
        """Return for each placed marker the numbers of markers (T,) that its segment's pose is fitted to."""
        return [*self.markers.values(), *self.by_static.values()]

    @property
    def frames(self) -> int:
        """The number of frames in which a marker is placed by its segment."""
        return int(np.count_nonzero(np.any(self.counts, axis=0))) if self.counts else 0

    @property
    def least(self) -> int | None:
        """The smallest number of markers that a segment's pose is fitted to; None where no marker is placed."""
        return min((int(counts[counts > 0].min()) for counts in self.counts), default=None)

    def warnings(self, names: Sequence[str], trial: str) -> list[str]:
        """Return warnings on the markers that segments place, given the names of all points and of the static trial."""
        own, static = (placed_in_words(those, names) for those in (self.markers, self.by_static))
        found = [f"hidden markers estimated by the pose of their segment: {own}"] if own else []
        by_trial = [f"markers placed by their segments as in the static trial {trial}: {static}"] if static else []
        return [*found, *by_trial]


def close_gaps(
    positions: F64, used: Sequence[int], longest: int, names: Sequence[str] | None, shapes: Shapes | None = None
) -> Closed:
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
    shapes : mapping, optional
        The shapes of segments in a static trial, in the unit of the positions.
    """
    lines, left = _straight(positions, used, longest)
    own, static = _by_segments(positions, names, left, used, shapes or {}) if left and names is not None else ({}, {})
    if own or static:
        more, left = _straight(positions, used, longest)
        lines += more
    return Closed(lines, left, own, static)


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


def _by_segments(
    positions: F64, names: Sequence[str], gaps: Iterable[Gap], used: Sequence[int], shapes: Shapes
) -> tuple[dict[int, I64], dict[int, I64]]:
    """Fill gaps of markers in place by the poses of their segments, as far as three other markers of these are seen.

    The template of a segment is that of frames in which all of them are seen, then that of the static trial. The result
    has the numbers of markers behind each marker by both.
    """
    segments = _with_shapes(marker_segments(names), shapes, names)
    hidden: dict[int, list[Gap]] = {}
    for gap in gaps:
        if any(used[gap.point] in markers for markers, _ in segments.values()):
            hidden.setdefault(used[gap.point], []).append(gap)
    if not hidden:
        return {}, {}
    tolerance = largest_error(positions)
    tracks, own, static = {}, dict[int, I64](), dict[int, I64]()
    for marker, those in hidden.items():
        wanted = np.zeros(positions.shape[2], np.bool_)
        for gap in those:
            wanted[gap.start : gap.stop] = True
        found = _placed(positions, marker, wanted, segments, tolerance)
        more = placed_by_shapes(positions, marker, wanted & (found.markers == 0), segments, tolerance)
        tracks[marker] = np.where(more.markers > 0, more.positions, found.positions)
        own |= {marker: found.markers} if found.markers.any() else {}
        static |= {marker: more.markers} if more.markers.any() else {}
    for marker, track in tracks.items():  # by markers that are seen, not by those that are placed
        there = np.isfinite(track).all(axis=0)
        positions[marker][:, there] = track[:, there]
    return own, static


Segments = Mapping[str, tuple[list[int], F64 | None]]
"""Segment → indices of its markers (M), and their places (M, 3) in a static trial."""


def _with_shapes(segments: Mapping[str, list[int]], shapes: Shapes, names: Sequence[str]) -> Segments:
    """Return the markers of each segment, and their places in a static trial, NaN for those that it lacks."""
    index, lost = {name: i for i, name in enumerate(names)}, np.full(3, np.nan)
    found: dict[str, tuple[list[int], F64 | None]] = {}
    for segment in (*segments, *(segment for segment in shapes if segment not in segments)):
        shape = shapes.get(segment, {})
        more = (index[label] for label in shape if label in index)
        markers = list(dict.fromkeys([*segments.get(segment, ()), *more]))
        places = np.stack([shape.get(names[marker], lost) for marker in markers]) if shape and markers else None
        found[segment] = markers, places
    return found


def _placed(positions: F64, marker: int, wanted: Bool, segments: Segments, tolerance: float) -> Placed:
    """Place a marker in the wanted frames, in each by the first of its segments that can place it."""
    track, counts = positions[marker].copy(), np.zeros(positions.shape[2], np.int64)
    for markers in (markers for markers, _ in segments.values() if marker in markers):
        found = placed_by_segment(positions[markers], markers.index(marker), wanted & (counts == 0), tolerance)
        there = found.markers > 0
        track[:, there], counts[there] = found.positions[:, there], found.markers[there]
    return Placed(track, counts)


def placed_by_shapes(positions: F64, marker: int, wanted: Bool, segments: Segments, tolerance: float) -> PlacedByShape:
    """Return a marker as the shapes of its segments in a static trial place it, that with the least expected error.

    Parameters
    ----------
    positions : float64 array (N, 3, T)
        The points; NaN where one is not seen.
    marker : int
        Index of the marker.
    wanted : bool array (T,)
        The frames in which it is to be placed.
    segments : mapping of str to (list of int, float64 array (M, 3) or None)
        Segment → indices of its markers, and their places in the static trial.
    tolerance : float
        The largest distance of a marker from its place in a shape.
    """
    best = PlacedByShape(
        np.full(positions.shape[1:], np.nan), np.zeros(len(wanted), np.int64), np.full(len(wanted), np.inf)
    )
    for markers, shape in segments.values():
        if shape is None or marker not in markers:
            continue
        found = placed_by_shape(positions[markers], markers.index(marker), wanted, shape, tolerance)
        better = found.errors < best.errors
        for ours, theirs in zip(best, found, strict=True):
            ours[..., better] = theirs[..., better]
    return best


def placed_in_words(markers: Mapping[int, I64], names: Sequence[str], most: int = 6) -> str:
    """List markers that their segments place, by descending number of frames, with the numbers of markers behind."""
    worst = sorted(markers.items(), key=lambda item: -np.count_nonzero(item[1]))
    shown = [f"{names[marker]} {_counts_in_words(counts[counts > 0])}" for marker, counts in worst[:most]]
    return ", ".join(shown) + (f" and {len(worst) - most} more points" if len(worst) > most else "")


def _counts_in_words(counts: I64) -> str:
    least, most = int(counts.min()), int(counts.max())
    return f"{len(counts)} frames (from {least}{f' to {most}' if most > least else ''} markers)"


def largest_error(positions: F64) -> float:
    """Return the largest error of a template: a share of the extent of all markers, the median over some frames."""
    frames = np.flatnonzero(np.isfinite(positions).any(axis=(0, 1)))
    some = positions[:, :, frames[np.unique(np.linspace(0, len(frames) - 1, 64).astype(int))]]
    with np.errstate(over="ignore", invalid="ignore"):
        return _OFF * float(np.median(np.linalg.norm(np.nanmax(some, axis=0) - np.nanmin(some, axis=0), axis=0)))
