"""Lay out an archive on one time axis, with its takes end to end, as a strip of all classes and a lane per class."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kinedex.ops.arrays import F64, I64
from kinedex.ops.intervals import TakeSegment
from kinedex.ops.wording import counted
from kinedex.reports.plots import percent
from kinedex.reports.report_data import TakeRow
from kinedex.reports.take_selection import by_group

BINS = 1000
"""Number of columns of the axis; it does not depend on the length of the archive, so that pages stay small."""

STEPS = 10
"""Number of heights that a column can have; the height shows its share of labelled frames, in tenths."""

MAX_NAMED = 2000
"""Maximum number of takes for which the page shows names at the pointer; with more takes, it shows none."""


@dataclass(frozen=True)
class Band:
    """A group of takes on the axis: its place in percent, its name, and its tooltip."""

    left: float
    width: float
    name: str
    tip: str


@dataclass(frozen=True)
class Area:
    """The columns of a class as the SVG path of their outline, in a box of `BINS` × `STEPS` units."""

    label: str
    slot: int
    path: str


@dataclass(frozen=True)
class ArchiveStrip:
    """The archive on one axis.

    Attributes
    ----------
    bands : tuple of Band
        The groups of takes; empty if takes are not grouped.
    strip : tuple of Area
        The columns of all classes together. A column has the colour of the class with the most frames in it; its height
        is the fraction of frames that have a label.
    lanes : tuple of Area
        The columns of each class; classes without a segment have no lane.
    takes : tuple of (str, float, float)
        Name, place and width in percent of each take; empty if there are too many takes.
    """

    bands: tuple[Band, ...]
    strip: tuple[Area, ...]
    lanes: tuple[Area, ...]
    takes: tuple[tuple[str, float, float], ...]


def archive_strip(takes: Sequence[TakeRow], segments: Sequence[TakeSegment], slots: Mapping[str, int]) -> ArchiveStrip:
    """Lay out an archive on one time axis.

    Parameters
    ----------
    takes : sequence of TakeRow
        The takes, with their groups.
    segments : sequence of TakeSegment
        Segments of these takes.
    slots : mapping of str to int
        Colour of each class; its order is the order of the lanes.
    """
    rows = {take.name: take for take in takes}
    groups = by_group({take.name: take.group for take in takes}, sorted(rows))
    order = [name for names in groups.values() for name in names]
    ends = np.cumsum([rows[name].frames for name in order]) if order else np.zeros(0, np.int64)
    total = int(ends[-1]) if len(ends) else 0
    if not total:
        return ArchiveStrip((), (), (), ())
    firsts = dict(zip(order, (ends - [rows[name].frames for name in order]).tolist(), strict=True))
    ranges: dict[str, list[tuple[int, int]]] = {label: [] for label in slots}
    for one in segments:
        ranges[one.label].append((firsts[one.take] + one.start, firsts[one.take] + one.stop))
    shares = {label: _shares(own, total) for label, own in ranges.items()}
    lanes = [_area(label, slots[label], _heights(shares[label])) for label in slots if shares[label].any()]
    bands = [
        Band(
            percent(firsts[names[0]], total),
            percent(sum(rows[name].frames for name in names), total),
            group,
            f"{group}: {counted(len(names), 'take')}, {sum(rows[name].seconds for name in names) / 60:.1f} min",
        )
        for group, names in groups.items()
        if len(groups) > 1
    ]
    named = order if len(order) <= MAX_NAMED else []
    positions = [(name, percent(firsts[name], total), percent(rows[name].frames, total)) for name in named]
    return ArchiveStrip(tuple(bands), tuple(_strip(shares, slots)), tuple(lanes), tuple(positions))


def _shares(ranges: Sequence[tuple[int, int]], total: int) -> F64:
    """Return, for each column, the fraction of its frames that are in the given ranges, float64 (BINS,)."""
    own = np.array(ranges, np.int64).reshape(-1, 2)
    own = own[np.argsort(own[:, 0], kind="stable")]
    begins = np.maximum(own[:, 0], np.concatenate(([0], np.maximum.accumulate(own[:, 1])[:-1])) if len(own) else 0)
    lengths = np.maximum(own[:, 1] - begins, 0)
    begins, lengths = begins[lengths > 0], lengths[lengths > 0]
    # number of labelled frames before each edge of a column: linear within a segment, constant between segments
    corners = np.stack([begins, begins + lengths], axis=1).ravel()
    before = np.cumsum(lengths) - lengths
    counts = np.stack([before, before + lengths], axis=1).ravel()
    edges = np.linspace(0, total, BINS + 1)
    covered = np.interp(edges, corners, counts) if len(corners) else np.zeros(BINS + 1)
    shares: F64 = np.diff(covered) / (total / BINS)
    return shares


def _heights(shares: F64) -> I64:
    """Return shares as heights from 0 to `STEPS`; a column with any labelled frame has at least height 1."""
    heights: I64 = np.where(shares > 1e-9, np.clip(np.round(shares * STEPS), 1, STEPS), 0).astype(np.int64)
    return heights


def _strip(shares: Mapping[str, F64], slots: Mapping[str, int]) -> list[Area]:
    labels = list(shares)
    if not labels:
        return []
    stacked = np.stack([shares[label] for label in labels])
    winner, heights = stacked.argmax(axis=0), _heights(np.minimum(stacked.sum(axis=0), 1.0))
    areas = [_area(label, slots[label], np.where(winner == place, heights, 0)) for place, label in enumerate(labels)]
    return [area for area in areas if area.path]


def _area(label: str, slot: int, heights: I64) -> Area:
    """Return the outline of columns; adjacent columns of equal height are drawn as one rectangle."""
    cuts = np.flatnonzero(np.diff(heights)) + 1
    starts, stops = [0, *cuts.tolist()], [*cuts.tolist(), len(heights)]
    parts = [
        f"M{start} {STEPS}v{-height}h{stop - start}v{height}z"
        for start, stop, height in zip(starts, stops, heights[starts].tolist(), strict=True)
        if height
    ]
    return Area(label, slot, "".join(parts))
