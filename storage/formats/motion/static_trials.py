"""Keep the shapes of segments in a static trial, and place those markers of a motion that only the static trial has.

Laboratories record a person standing with markers that are taken off for the motions, such as those on the inner sides
of knees and ankles. The markers that stay show the pose of their segment in the motion, and the pose places the others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from kinedex.catalog.skeletons.marker_segments import RIGID_SEGMENTS
from kinedex.catalog.skeletons.recognition.landmarks import load_landmarks
from kinedex.ops.arrays import F64, I64, Bool
from kinedex.ops.body.rigid_segments import MIN_MARKERS, mean_shape
from kinedex.ops.errors import ParameterError
from kinedex.ops.wording import name_list
from kinedex.storage.formats.motion.hidden_markers import Shapes, placed_by_shapes

_MOST_FRAMES = 64  # frames of which a shape is the mean, spread evenly
_STEADY = 0.5  # share of the largest error of a template: changes of a distance between two markers of one segment


def static_shapes(labels: Sequence[str], positions: F64, motion: Mapping[str, F64], tolerance: float) -> Shapes:
    """Return the mean shapes of the segments in a static trial, which may move as long as its segments are rigid.

    A marker on no landmark belongs to the segment from which it is as far in the motion as in the static trial, such as
    the markers of a cluster.

    Parameters
    ----------
    labels : sequence of str
        The labels of the points.
    positions : float64 array (N, 3, T)
        The points in T frames; NaN where one is not seen.
    motion : mapping of str to float64 array (3, T')
        Label → its places in the motion.
    tolerance : float
        The largest error of a template, as `largest_error` returns it.
    """
    found = {}
    for segment, places in _segments(labels, positions, motion, tolerance).items():
        markers, frames = _seen_together(np.asarray(np.isfinite(positions[places]).all(axis=1)))
        if len(markers) <= MIN_MARKERS:
            continue
        held = [places[marker] for marker in markers]
        try:
            shape = mean_shape(positions[held][:, :, _some(frames)])
        except ParameterError:  # they lie on a line
            continue
        found[segment] = {labels[point]: place for point, place in zip(held, shape, strict=True)}
    return found


def _segments(
    labels: Sequence[str], positions: F64, motion: Mapping[str, F64], tolerance: float
) -> dict[str, list[int]]:
    """Return the indices of the labels of each segment, by landmarks and, for other markers, by steady distances."""
    reading = load_landmarks().read(labels)
    index = {label: i for i, label in enumerate(labels)}
    segments = {
        segment: [index[label] for landmark in landmarks for label in reading.labels.get(landmark, ())]
        for segment, landmarks in RIGID_SEGMENTS.items()
    }
    both = [i for i, label in enumerate(labels) if label in motion]
    there = np.stack([motion[labels[i]] for i in both])
    there = there[:, :, _some(np.arange(there.shape[2]))]
    here = positions[both][:, :, _some(np.arange(positions.shape[2]))]
    place = {point: k for k, point in enumerate(both)}
    for point in (index[label] for label in reading.unread if index[label] in place):
        changes = _changes(here, there, place[point])
        # the second steadiest distance: one alone may be steady by chance
        second = {
            segment: sorted(changes[place[other]] for other in places if other in place)[1]
            for segment, places in segments.items()
            if len(place.keys() & set(places)) > 1
        }
        nearest = min(second, key=lambda segment: second[segment], default="")
        if nearest and second[nearest] <= _STEADY * tolerance:
            segments[nearest].append(point)
    return segments


def _changes(here: F64, there: F64, marker: int) -> F64:
    """Return by how much the distances of markers (N,) from one of them differ between static trial and motion.

    It is the difference from the median of the static trial in nine of ten frames; infinite for markers that are never
    seen together.
    """
    static, motion = (np.linalg.norm(points - points[marker], axis=1) for points in (here, there))
    found = np.full(len(here), np.inf)
    for i, (own, other) in enumerate(zip(static, motion, strict=True)):
        own, other = own[np.isfinite(own)], other[np.isfinite(other)]
        if len(own) and len(other):
            found[i] = np.percentile(np.abs(other - np.median(own)), 90)
    return found


def _some(frames: I64) -> I64:
    """Return at most `_MOST_FRAMES` of the given frames, spread evenly."""
    return np.asarray(frames[np.unique(np.linspace(0, len(frames) - 1, min(len(frames), _MOST_FRAMES)).astype(int))])


def _seen_together(seen: Bool) -> tuple[I64, I64]:
    """Return markers, all or those that are seen most often, and the frames in which all of these are seen."""
    markers = np.argsort(-seen.sum(axis=1), kind="stable")
    markers = markers[seen[markers].any(axis=1)]
    while len(markers) and not seen[markers].all(axis=0).any():
        markers = markers[:-1]
    return np.sort(markers), np.flatnonzero(seen[markers].all(axis=0))


@dataclass(frozen=True)
class StaticTrial:
    """The shapes and the markers that a motion takes from its static trial.

    Attributes
    ----------
    name : str
        The name of the file.
    shapes : mapping
        The shapes of segments, with the labels and in the unit of the motion.
    markers : mapping of str to int64 array (T,)
        Label that only the static trial has → the number of markers that its place in the motion follows from, by
        frame; 0 where it has none.
    """

    name: str
    shapes: Shapes
    markers: Mapping[str, I64] = field(default_factory=dict)


def labels_as_in(static: Sequence[str], motion: Sequence[str]) -> tuple[str, ...]:
    """Return the labels of a static trial as its motion writes them, whose labels may have another subject's name.

    `LKNE` and `Ann:LKNE` are the same label where all labels of the motion have one subject.
    """
    of = {label.rpartition(":")[0] for label in motion}
    if len(of) != 1 or not set(static).isdisjoint(motion):
        return tuple(static)
    (subject,) = of
    return tuple(f"{subject}:{short}" if subject else short for short in (one.rpartition(":")[2] for one in static))


class Added(NamedTuple):
    """Markers that only the static trial of a motion has, as the motion's segments place them.

    Attributes
    ----------
    positions : dict of str to float64 array (3, T)
        Label → place; NaN in frames in which it has none.
    markers : dict of str to int64 array (T,)
        Label → the number of markers that the pose of its segment is fitted to; 0 where it is not placed.
    refused : list of str
        Labels that no segment places in any frame.
    """

    positions: dict[str, F64]
    markers: dict[str, I64]
    refused: list[str]

    def refusal(self, name: str) -> str:
        """Return a warning on the markers that are placed in no frame, given the name of the static trial."""
        return (
            f"the static trial {name} has {name_list(self.refused)}, which this file lacks and no segment places: "
            "three markers of a segment must be seen, and keep the distances that they have in the static trial"
        )


def added_markers(labels: Sequence[str], positions: F64, shapes: Shapes, tolerance: float) -> Added:
    """Place the markers that a static trial has and its motion lacks.

    Parameters
    ----------
    labels : sequence of str
        The labels of the motion.
    positions : float64 array (N, 3, T)
        Its points; NaN where one is not seen.
    shapes : mapping
        The shapes of segments in the static trial, in the unit of the motion.
    tolerance : float
        The largest error of a template, as `largest_error` returns it.
    """
    held = {label: i for i, label in enumerate(labels)}
    lacking = _lacking(labels, [label for shape in shapes.values() for label in shape])
    added = Added({}, {}, [])
    everywhere, nowhere = np.ones(positions.shape[2], np.bool_), np.full((1, *positions.shape[1:]), np.nan)
    points = np.concatenate([positions, nowhere]) if lacking else positions
    for label in lacking:
        index = {**held, label: len(labels)}
        segments: dict[str, tuple[list[int], F64 | None]] = {}
        for segment, shape in ((segment, shape) for segment, shape in shapes.items() if label in shape):
            seen = [name for name in shape if name in index]
            segments[segment] = [index[name] for name in seen], np.stack([shape[name] for name in seen])
        found = placed_by_shapes(points, len(labels), everywhere, segments, tolerance)
        if found.markers.any():
            added.positions[label], added.markers[label] = found.positions, found.markers
        else:
            added.refused.append(label)
    return added


def _lacking(labels: Sequence[str], static: Sequence[str]) -> list[str]:
    """Return the labels of a static trial on landmarks that a motion has by no label."""
    landmarks = load_landmarks()
    known = landmarks.read(labels).labels
    of_both = landmarks.read(tuple(dict.fromkeys([*labels, *static]))).labels
    return [
        label for landmark, found in of_both.items() if landmark not in known for label in found if label not in labels
    ]
