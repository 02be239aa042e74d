"""Make test takes, which are annotated and evaluated: takes of the store or concatenated clips, with labels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import and_

import numpy as np
import polars as pl

from kinedex.catalog.classes import Classes
from kinedex.ops.words import ALL_KNOWN
from kinedex.pipelines.evaluation.ground_truth import GroundTruth
from kinedex.pipelines.evaluation.scheme import Split
from kinedex.pipelines.templates.learning import TrainingClips

WHOLE = "all"
"""The name of the only fold of a fixed split."""

Truth = tuple[str, int, int]
"""A segment: its class, its first analysis frame, and the frame after its last."""


@dataclass(frozen=True)
class TestTake:
    """A take that is annotated and evaluated: a take of the store, or several clips of the store concatenated.

    Attributes
    ----------
    name : str
        The name of the take, or of the fold with a number.
    group : str
        The value of the column that results are divided by (thesis, Table 5.2).
    take_ids : tuple of int
        The takes of the store that it consists of.
    frames : int
        The number of its analysis frames.
    truth : tuple of Truth
        The segments of its ground truth.
    """

    name: str
    group: str
    take_ids: tuple[int, ...]
    frames: int
    truth: tuple[Truth, ...]

    def known(self, masks: Mapping[int, int]) -> int:
        """Return the mask of the features known in all its takes; `masks` has the masks of takes that lack some
        features.
        """
        return reduce(and_, (masks[take_id] for take_id in self.take_ids if take_id in masks), int(ALL_KNOWN))


@dataclass(frozen=True)
class Fold:
    """One fold of a split: the clips to learn from, the takes to annotate, and remarks on both."""

    split: str
    name: str
    clips: tuple[TrainingClips, ...]
    test_takes: tuple[TestTake, ...]
    remarks: tuple[str, ...] = ()


def as_they_are(tested: pl.DataFrame, placed: GroundTruth, column: str) -> list[TestTake]:
    """Return takes of the store as test takes.

    Parameters
    ----------
    tested : polars.DataFrame
        Rows of takes.
    placed : GroundTruth
        Their ground truth.
    column : str
        The column of takes that results are divided by.
    """
    truth: dict[str, list[Truth]] = {}
    for one in placed.segments:
        truth.setdefault(one.take, []).append((one.label, one.start, one.stop))
    return [
        TestTake(
            row["name"],
            group_of(row, column),
            (row["take_id"],),
            row["frames"],
            tuple(sorted(truth.get(row["name"], ()), key=lambda one: one[1:])),
        )
        for row in tested.iter_rows(named=True)
    ]


def laid_out(split: Split, fold: str, clips: pl.DataFrame, classes: Classes, column: str) -> list[TestTake]:
    """Concatenate clips in random orders; all clips of a test take have the same value in a column of takes.

    Parameters
    ----------
    split : Split
        The number of clips per take, the largest number per class in each order, and the number of orders.
    fold : str
        The name of the fold.
    clips : polars.DataFrame
        Rows of takes, each with a class.
    classes : Classes
        The classes of the labels.
    column : str
        The column of takes that results are divided by, such as "actor".
    """
    rows = list(clips.sort("name").iter_rows(named=True))
    groups = sorted({group_of(row, column) for row in rows})
    test_takes = []
    for place, group in enumerate(groups):
        own = [row for row in rows if group_of(row, column) == group]
        where = fold if len(groups) == 1 else f"{fold}: {group}"
        for order in range(split.orders):
            drawn = _drawn(split, own, np.random.default_rng((split.seed, order, place)))
            for number, start in enumerate(range(0, len(drawn), split.clips_a_take), 1):
                part = drawn[start : start + split.clips_a_take]
                test_takes.append(_end_to_end(f"{where}: order {order + 1}, take {number}", group, part, classes))
    return test_takes


def group_of(row: dict[str, object], column: str) -> str:
    """Return the value of the column that results are divided by."""
    return f"no {column}" if row.get(column) is None else str(row[column])


def how_clips_are_used(split: Split, clips: int, test_takes: Sequence[TestTake]) -> str:
    """Return a remark on how many of the clips are used, and how often."""
    uses = [take_id for test_take in test_takes for take_id in test_take.take_ids]
    used = len(set(uses))
    return (
        f"{used} of {clips} clips are used, each {len(uses) / used:.1f} times on average (orders: {split.orders}, "
        f"most_clips: {split.most_clips})"
    )


def _drawn(split: Split, rows: Sequence[dict[str, object]], random: np.random.Generator) -> list[dict[str, object]]:
    """Return clips in random order, at most `most_clips` of each class."""
    chosen = []
    for label in sorted({str(row["class"]) for row in rows}):
        own = [row for row in rows if row["class"] == label]
        chosen += [own[index] for index in random.permutation(len(own))[: split.most_clips].tolist()]
    return [chosen[index] for index in random.permutation(len(chosen)).tolist()]


def _end_to_end(name: str, group: str, clips: Sequence[dict[str, object]], classes: Classes) -> TestTake:
    edges = np.cumsum([0, *(int(str(row["frames"])) for row in clips)]).tolist()
    truth = tuple(
        (str(classes.class_of(str(row["class"]))), start, stop)
        for row, start, stop in zip(clips, edges, edges[1:], strict=False)
    )
    return TestTake(name, group, tuple(int(str(row["take_id"])) for row in clips), edges[-1], truth)
