"""`python -m studies.hidden_markers DATA`: hide one marker after the other for a second, and see where it is placed.

DATA is a folder with `c3d` and `wild`. Each marker on a landmark is hidden for a second in the middle of a recording,
in which it was seen. One line for each file compares its true place with that by the pose of its segment and by a
straight line across the gap (mean and the largest of 95 % of the frames, cm; over the markers that a segment places),
and then the joint that is farthest from its place in the mean over the gap, with and without segments, and the share of
frames that are invalid.

The second table removes each marker from all but the first frames of a recording, which serve as its static trial:
where the marker is placed by the shape of its segment there, and the joint that is farthest from its place in the mean,
read without the static trial and with it.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from kinedex.catalog.skeletons.mappings import Mappings
from kinedex.catalog.skeletons.recognition.landmarks import load_landmarks
from kinedex.ops.arrays import F64, Bool
from kinedex.ops.body.resample import fill_gaps
from kinedex.ops.errors import KinedexError
from kinedex.storage.formats.motion.hidden_markers import close_gaps
from kinedex.storage.formats.motion.points import Points, body_of_points, completed, evidence_of
from kinedex.storage.formats.motion.reader import DEFAULT_SETTINGS, Body
from studies.marker_accuracy import JOINTS, computed, recordings, without

BY_LABELS = Mappings({"c3d": ()})
"""Mappings that recognise each body by its labels."""

STATIC_FRAMES = 10
"""Frames of a recording that serve as its static trial, a quarter of it at most."""

MOST_FRAMES = 1200
"""Frames of a recording, from its beginning; a hidden stretch begins after a third."""


@dataclass(frozen=True)
class Trial:
    """A trial with one hidden marker.

    Attributes
    ----------
    by_segment, by_line : float64 array
        Distances in cm between the marker and its true place, in the frames in which a segment places it.
    joints : (float, float)
        The mean distance in cm of the worst joint from its place, without and with segments; NaN for a refused file.
    invalid : (float, float)
        The share of the hidden frames that are invalid, without and with segments.
    """

    by_segment: F64
    by_line: F64
    joints: tuple[float, float]
    invalid: tuple[float, float]


def trials(path: Path, points: Points) -> Iterator[Trial]:
    """Yield a trial for each landmark's marker that is seen throughout the stretch in which it is hidden."""
    frames = min(points.positions.shape[2], MOST_FRAMES)
    stretch = slice(frames // 3, frames // 3 + min(round(points.rate_hz or 100.0), frames // 3))
    cut = replace(points.seen(), positions=points.seen().positions[:, :, :frames])
    whole = _body(path, cut, segments=True)
    unit_m = float(whole.unit.split()[0])
    index = cut.indices()
    for label in (labels[0] for labels in load_landmarks().read(cut.names).labels.values()):
        marker = index[label]
        if not np.isfinite(cut.positions[marker][:, stretch]).all():
            continue
        positions = cut.positions.copy()
        positions[marker, :, stretch] = np.nan
        hidden = replace(cut, positions=positions)
        ways = [_compared(path, hidden, whole, stretch, segments) for segments in (False, True)]
        by_segment, by_line = (
            100 * unit_m * np.linalg.norm(track - cut.positions[marker], axis=0)[stretch]
            for track in _tracks(hidden, marker)
        )
        there = np.isfinite(by_segment)
        yield Trial(by_segment[there], by_line[there], (ways[0][0], ways[1][0]), (ways[0][1], ways[1][1]))


@dataclass(frozen=True)
class RemovedMarker:
    """A marker that is removed from a motion and that its static trial has.

    Attributes
    ----------
    landmark : str
        Its landmark.
    away : float64 array
        The distances in cm from its true place, in the frames in which it is placed.
    joints : (float, float)
        The mean distance in cm of the worst joint from its place, without and with the static trial; NaN where the file
        is refused.
    """

    landmark: str
    away: F64
    joints: tuple[float, float]


def removed_markers(path: Path, points: Points) -> Iterator[RemovedMarker]:
    """Yield a result for each landmark's marker that is seen throughout the first frames, the static trial."""
    seen = points.seen()
    cut = replace(seen, positions=seen.positions[:, :, :MOST_FRAMES])
    first = max(1, min(STATIC_FRAMES, cut.positions.shape[2] // 4))
    trial, motion = (replace(cut, positions=cut.positions[:, :, part]) for part in (slice(first), slice(first, None)))
    whole = _body(path, motion, segments=True)
    unit_m = float(whole.unit.split()[0])
    for landmark, labels in load_landmarks().read(cut.names).labels.items():
        marker = cut.indices()[labels[0]]
        if not np.isfinite(trial.positions[marker]).all():
            continue
        lacking = without(motion, labels[:1])
        with_trial = completed(lacking, Path("static"), lambda _: trial)
        joints = [_compared(path, one, whole, slice(None), segments=True)[0] for one in (lacking, with_trial)]
        away = np.empty(0)
        if labels[0] in with_trial.names:
            track = with_trial.positions[with_trial.indices()[labels[0]]]
            away = 100 * unit_m * np.linalg.norm(track - motion.positions[marker], axis=0)
        yield RemovedMarker(landmark, away[np.isfinite(away)], (joints[0], joints[1]))


def _tracks(hidden: Points, marker: int) -> tuple[F64, F64]:
    """Return a hidden marker by the pose of its segment, NaN where it has none, and by a straight line."""
    positions = hidden.positions.copy()
    placed = close_gaps(positions, [marker], 0, hidden.names).markers
    positions[marker][:, placed[marker] == 0 if marker in placed else slice(None)] = np.nan
    return positions[marker], fill_gaps(hidden.positions[marker : marker + 1], hidden.positions.shape[2])[0][0]


def _body(path: Path, points: Points, segments: bool) -> Body:
    """Return the body of points in the file's own axes, with or without markers that are placed by segments."""
    fit = BY_LABELS.recognised(path, "c3d", evidence_of(points, getattr(points, "up", None)))
    fit = replace(fit, mapping=replace(fit.mapping, axes=np.eye(3)), reasons=fit.reasons if segments else ())
    copy = replace(points, positions=points.positions.copy(), rate_hz=points.rate_hz or points.clock_hz or 100.0)
    return body_of_points(copy, copy.names, fit, JOINTS, DEFAULT_SETTINGS, [])


def _compared(path: Path, hidden: Points, whole: Body, stretch: slice, segments: bool) -> tuple[float, float]:
    """Return the mean distance of the worst joint in cm, and the share of frames that are invalid for the marker."""
    try:
        body = _body(path, hidden, segments)
    except KinedexError:
        return float("nan"), 1.0
    lost = _invalid(body)[stretch] & ~_invalid(whole)[stretch]
    away = 100 * np.linalg.norm(body.positions - whole.positions, axis=1)[:, stretch][:, ~lost]
    known = np.isfinite(away)
    means = np.where(known, away, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    return float(means.max()) if away.size else float("nan"), float(lost.mean())


def _invalid(body: Body) -> Bool:
    return np.zeros(body.frames, np.bool_) if body.valid is None else ~body.valid


def _hidden_table(data: Path) -> Table:
    table = Table(
        "file", "markers", "placed", "by segment", "95 %", "by line", "95 %", "worst joint before", "now",
        "invalid before, %", "now", title="Hidden for a second",
    )  # fmt: skip
    for path, points in recordings(data):
        try:
            found = list(trials(path, without(points, computed(points))))
        except KinedexError:
            continue
        if not any(len(trial.by_segment) for trial in found):
            continue
        away = [np.concatenate([getattr(trial, way) for trial in found]) for way in ("by_segment", "by_line")]
        figures = [f"{figure:.2f}" for one in away for figure in (one.mean(), np.percentile(one, 95))]
        joints = np.nanmean([trial.joints for trial in found], axis=0)
        invalid = 100 * np.mean([trial.invalid for trial in found], axis=0)
        placed = sum(len(trial.by_segment) > 0 for trial in found)
        table.add_row(
            path.name, str(len(found)), str(placed), *figures, *(f"{mean:.1f}" for mean in (*joints, *invalid))
        )
    return table


def _removed_table(data: Path) -> Table:
    table = Table(
        "file", "markers", "markers", "placed", "mean", "95 %", "worst joint without", "with the static trial",
        title="Removed from the motion, held by the static trial",
    )  # fmt: skip
    for path, points in recordings(data):
        try:
            found = list(removed_markers(path, without(points, computed(points))))
        except KinedexError:
            continue
        inner = [one for one in found if one.landmark.endswith("med")]
        for kind, those in (("all", found), ("inner", inner)):
            placed = [one for one in those if len(one.away)]
            if placed:
                away = np.concatenate([one.away for one in placed])
                joints = np.nanmean([one.joints for one in placed], axis=0)
                figures = [f"{figure:.2f}" for figure in (away.mean(), np.percentile(away, 95), *joints)]
                table.add_row(path.name, kind, str(len(those)), str(len(placed)), *figures)
    return table


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    data, console = parser.parse_args().data, Console(width=160)
    console.print(_hidden_table(data))
    console.print(_removed_table(data))


if __name__ == "__main__":
    main()
