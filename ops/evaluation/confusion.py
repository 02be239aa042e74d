"""Compute the confusion matrix of classes: the frames of each class by the labels that a method gave them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kinedex.ops.arrays import F64, Bool
from kinedex.ops.intervals import TakeSegment

LabelledTake = tuple[int, Sequence[TakeSegment], Sequence[TakeSegment]]
"""The number of frames of a take, its manual segments, and its automatic segments."""

NOTHING = "no label"
"""The name of the row of frames without a manual label, and of the column of frames without an automatic label."""

EXTRA = "label too many"
"""The name of the row that counts automatic labels in excess of a frame's manual labels."""

LACKING = "label too few"
"""The name of the column that counts manual labels in excess of a frame's automatic labels."""


@dataclass(frozen=True)
class Confusion:
    """The confusion matrix: numbers of frames by manual label (rows) and automatic label (columns).

    The row of a class sums to its manually labelled frames, its column to its automatically labelled frames. Labels
    that a frame has on both sides are right. Each remaining label of the side with fewer is divided equally among the
    remaining labels of the other side. If one side has no label, each label of the other side counts once at `NOTHING`;
    a frame without any label counts once in the row and column `NOTHING`. If a side has labels, but fewer than the
    other, the surplus counts at `EXTRA` or `LACKING`.

    Attributes
    ----------
    classes : tuple of str, length C
        The first C rows and columns.
    frames : float64 array (C + 2, C + 2)
        Row and column C are `NOTHING`, row C + 1 is `EXTRA`, column C + 1 is `LACKING`.
    """

    classes: tuple[str, ...]
    frames: F64

    @property
    def rows(self) -> tuple[str, ...]:
        """Return the names of the rows."""
        return (*self.classes, NOTHING, EXTRA)

    @property
    def columns(self) -> tuple[str, ...]:
        """Return the names of the columns."""
        return (*self.classes, NOTHING, LACKING)


@dataclass(frozen=True)
class ConfusedClass:
    """The number of frames of the row `label` that are labelled `taken_for` instead, and their share of the row."""

    label: str
    taken_for: str
    frames: float
    share: float


def confusion(takes: Iterable[LabelledTake], classes: Sequence[str]) -> Confusion:
    """Count the frames of all takes by their manual and automatic labels.

    Parameters
    ----------
    takes : iterable of (int, sequence of TakeSegment, sequence of TakeSegment)
        The number of frames of each take, its manual segments, and its automatic segments.
    classes : sequence of str
        All classes among the manual and automatic labels.
    """
    place = {label: index for index, label in enumerate(classes)}
    size = len(classes)
    frames = np.zeros((size + 2, size + 2))
    for length, manual, automatic in takes:
        frames += _of_take(_marked(manual, place, length), _marked(automatic, place, length))
    return Confusion(tuple(classes), frames)


def _of_take(true: Bool, mine: Bool) -> F64:
    """Return the confusion matrix of a take, float64 (C + 2, C + 2), from manual and automatic labels, bool (C, L)."""
    size = len(true)
    frames = np.zeros((size + 2, size + 2))
    both = true & mine
    left_true, left_mine = true & ~both, mine & ~both
    many_true, many_mine = left_true.sum(axis=0), left_mine.sum(axis=0)
    longer = np.maximum(np.maximum(many_true, many_mine), 1)
    frames[:size, :size] = (left_true / longer) @ left_mine.T.astype(float)
    frames[np.arange(size), np.arange(size)] += both.sum(axis=1)
    bare_true, bare_mine = ~true.any(axis=0), ~mine.any(axis=0)
    frames[size, size] = np.count_nonzero(bare_true & bare_mine)
    lacking = left_true * (np.maximum(many_true - many_mine, 0) / longer)
    frames[:size, size], frames[:size, size + 1] = lacking @ bare_mine, lacking @ ~bare_mine
    extra = left_mine * (np.maximum(many_mine - many_true, 0) / longer)
    frames[size, :size], frames[size + 1, :size] = extra @ bare_true, extra @ ~bare_true
    return frames


def _marked(segments: Sequence[TakeSegment], place: Mapping[str, int], length: int) -> Bool:
    """Return for each class the frames that segments label with it, bool (C, L)."""
    marked = np.zeros((len(place), length), np.bool_)
    for one in segments:
        marked[place[one.label], one.start : one.stop] = True
    return marked


def confusions(found: Confusion, most: int) -> list[ConfusedClass]:
    """Return at most `most` confusions, the most frequent first, without those below half a percent of their row."""
    greatest = []
    for i, label in enumerate(found.rows):
        total = float(found.frames[i].sum())
        for j, other in enumerate(found.columns):
            if i != j and total and found.frames[i, j] >= 0.005 * total:
                greatest.append(
                    ConfusedClass(label, other, float(found.frames[i, j]), float(found.frames[i, j]) / total)
                )
    return sorted(greatest, key=lambda one: (-one.frames, one.label, one.taken_for))[:most]
