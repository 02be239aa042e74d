"""Divide the takes of a split into folds: clips to learn from, and takes or clips laid end to end to annotate."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import and_

import numpy as np
import polars as pl

from kinedex.catalog.classes import Classes
from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.intervals import TakeSegment
from kinedex.ops.wording import counted, name_list
from kinedex.ops.words import ALL_KNOWN
from kinedex.pipelines.evaluation.comparison_parameters import Split
from kinedex.pipelines.evaluation.ground_truth import GroundTruth
from kinedex.pipelines.templates.template_learning import TrainingClips

WHOLE = "all"
"""The name of the only fold of a fixed split."""


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
    truth : tuple of TakeSegment
        The segments of its ground truth.
    """

    name: str
    group: str
    take_ids: tuple[int, ...]
    frames: int
    truth: tuple[TakeSegment, ...]

    def known(self, masks: Mapping[int, int]) -> int:
        """Return the mask of the features that are known in all takes of the store that it consists of.

        `masks` has the masks of takes that lack some features, by take_id.
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


PlaceTruth = Callable[[pl.DataFrame], GroundTruth]


@dataclass(frozen=True)
class Material:
    """The takes of a split, and the other data from which its folds are made.

    Attributes
    ----------
    training : polars.DataFrame
        Rows of the takes to learn from.
    clips : tuple of TrainingClips
        The clips of these takes, by subclass.
    tested : polars.DataFrame
        Rows of the takes to annotate.
    classes : Classes
        The classes to label with.
    place : callable
        A function that returns the ground truth of takes.
    group : str
        The column of takes that results are divided by.
    """

    training: pl.DataFrame
    clips: tuple[TrainingClips, ...]
    tested: pl.DataFrame
    classes: Classes
    place: PlaceTruth
    group: str


class NoFoldsError(KinedexError):
    """A split has no fold: no take can be annotated with templates learned from other takes."""


def make_folds(split: Split, material: Material) -> list[Fold]:
    """Divide the takes of a split into folds.

    Parameters
    ----------
    split : Split
        The kind of split.
    material : Material
        The takes of the split.

    Returns
    -------
    list of Fold
        At least one fold; no take is annotated with templates learned from it. The remarks of the folds name the
        takes that are in no fold, and the folds that are missing because nothing is left to learn from.

    Raises
    ------
    NoFoldsError
        There is nothing to annotate, or nothing to learn from.
    KinedexError
        Takes lack a column, or a fixed split uses the same takes for annotation and learning.
    """
    tested = material.tested
    if not tested.height:
        raise NoFoldsError(f"split '{split.name}': no take to annotate, the filter `{split.test}` selects none")
    remarks: tuple[str, ...] = ()
    if split.clips_as_takes:
        known = [name is not None and material.classes.class_of(name) is not None for name in tested["class"]]
        if not any(known):
            raise KinedexError(
                f"split '{split.name}': none of the {tested.height} takes that `{split.test}` selects has a class of "
                "this evaluation; with clips_as_takes they are clips, such as `test: class IS NOT NULL`"
            )
        remarks = _of_no_class(tested.filter(~pl.Series(known)))
        tested = tested.filter(pl.Series(known))
    else:
        truth = material.place(tested)
        remarks = truth.remarks
        tested = tested.filter(pl.col("name").is_in(truth.takes))
    parts = _parts(split, tested.sort("name"))
    folds = [_fold(split, name, takes, material) for name, takes in parts]
    usable = [fold for fold in folds if fold.clips and fold.test_takes]
    if not usable:
        raise NoFoldsError(f"split '{split.name}': no fold has both clips to learn from and takes to annotate")
    remarks = (*remarks, *_in_no_fold(split, tested, parts), *_missing(split, folds))
    if split.clips_as_takes:
        used = {fold.name for fold in usable}
        clips = sum(takes.height for name, takes in parts if name in used)
        remarks += (how_clips_are_used(split, clips, [test_take for fold in usable for test_take in fold.test_takes]),)
    return [replace(fold, remarks=(*remarks, *fold.remarks)) for fold in usable]


def _of_no_class(clips: pl.DataFrame) -> tuple[str, ...]:
    """Return a remark on clips without a subclass, or whose subclass is in no class."""
    if not clips.height:
        return ()
    subclasses = clips["class"].drop_nulls().unique().sort().to_list()
    bare = clips["class"].null_count()
    parts = [f"of {name_list(subclasses)}"] * bool(subclasses) + [f"{bare} without a subclass"] * bool(bare)
    return (f"{counted(clips.height, 'clip')} of no class, excluded: {'; '.join(parts)}",)


def _in_no_fold(split: Split, tested: pl.DataFrame, parts: Sequence[tuple[str, pl.DataFrame]]) -> list[str]:
    """Return a remark on takes without a value in the column that defines folds."""
    within = {name for _, takes in parts for name in takes["name"]}
    names = [name for name in tested["name"].sort() if name not in within]
    if not names:
        return []
    return [
        f"{counted(len(names), 'take')} without {split.leave_out}, in no fold and not annotated: {name_list(names)}"
    ]


def _missing(split: Split, folds: Sequence[Fold]) -> list[str]:
    """Return remarks on the folds that have no clip to learn from, with their takes."""
    remarks = []
    for fold in folds:
        if not fold.clips:
            why = f"of {split.leave_out} {fold.name}" if split.leave_out is not None else "takes of this fold"
            remarks.append(
                f"{fold.name}: all training clips are {why}, so there is no such fold; not annotated: "
                f"{counted(len(fold.test_takes), 'take')} "
                f"({name_list([test_take.name for test_take in fold.test_takes])})"
            )
    return remarks


def _parts(split: Split, tested: pl.DataFrame) -> list[tuple[str, pl.DataFrame]]:
    """Return the takes that each fold annotates, by the name of the fold."""
    if split.leave_out is not None:
        column = split.leave_out
        if column not in tested.columns:
            raise KinedexError(
                f"split '{split.name}': takes have no column '{column}'{did_you_mean(column, tested.columns)}"
            )
        values = tested[column].drop_nulls().unique().sort().to_list()
        if not values:
            raise NoFoldsError(f"split '{split.name}': none of the takes to annotate has a value of '{column}'")
        return [(str(value), tested.filter(pl.col(column) == value)) for value in values]
    if split.folds is None:
        return [(WHOLE, tested)]
    if split.folds > tested.height:
        raise KinedexError(f"split '{split.name}': {split.folds} folds of {tested.height} takes; set fewer")
    drawn = tested[np.random.default_rng(split.seed).permutation(tested.height).tolist()]
    if split.clips_as_takes:  # the clips of each class are distributed over all folds
        drawn = drawn.sort("class", maintain_order=True)
    tested, dealt = drawn, np.arange(tested.height) % split.folds
    return [(f"fold {index + 1}", tested.filter(pl.Series(dealt == index))) for index in range(split.folds)]


def _fold(split: Split, name: str, tested: pl.DataFrame, material: Material) -> Fold:
    """Make the fold that annotates the given takes."""
    names = set(tested["name"].to_list())
    excluded = set(names)
    if split.leave_out is not None and split.leave_out in material.training.columns:
        value = tested[split.leave_out][0]
        excluded |= set(material.training.filter(pl.col(split.leave_out) == value)["name"].to_list())
    trained = {take for one in material.clips for take in one.of_takes}
    both = sorted(names & trained)
    if both and split.leave_out is None and split.folds is None:
        raise KinedexError(
            f"split '{split.name}': takes to annotate are learned from as well: {name_list(both)}; make `train` and "
            "`test` "
            "exclude each other, or use `leave_out` or `folds`"
        )
    clips = tuple(rest for one in material.clips if (rest := one.without(excluded)).names)
    remarks = []
    gone = sorted({one.subclass for one in material.clips} - {one.subclass for one in clips})
    if gone:
        remarks.append(f"{name}: no clips of others, so no template: {name_list(gone)}")
    if split.leave_out is not None and not trained & excluded:
        remarks.append(f"{name}: no training clip is of {split.leave_out} {name}, so all are learned from")
    if split.clips_as_takes:
        test_takes = concatenated_clips(split, name, tested, material.classes, material.group)
        if split.orders > 1:
            remarks.append(
                f"clips are laid out in {split.orders} orders, so takes share clips: intervals are narrower than those "
                "of as many takes of their own"
            )
    else:
        test_takes = stored_test_takes(tested, material.place(tested), material.group)
    return Fold(split.name, name, clips, tuple(test_takes), tuple(remarks))


def stored_test_takes(tested: pl.DataFrame, placed: GroundTruth, column: str) -> list[TestTake]:
    """Return takes of the store as test takes.

    Parameters
    ----------
    tested : polars.DataFrame
        Rows of takes.
    placed : GroundTruth
        The ground truth of these takes.
    column : str
        The column of takes that results are divided by.
    """
    truth: dict[str, list[TakeSegment]] = {}
    for one in placed.segments:
        truth.setdefault(one.take, []).append(TakeSegment(one.take, one.label, one.start, one.stop))
    return [
        TestTake(
            row["name"],
            group_of(row, column),
            (row["take_id"],),
            row["frames"],
            tuple(sorted(truth.get(row["name"], ()), key=lambda one: (one.start, one.stop))),
        )
        for row in tested.iter_rows(named=True)
    ]


def concatenated_clips(split: Split, fold: str, clips: pl.DataFrame, classes: Classes, column: str) -> list[TestTake]:
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
        TakeSegment(name, str(classes.class_of(str(row["class"]))), start, stop)
        for row, start, stop in zip(clips, edges, edges[1:], strict=False)
    )
    return TestTake(name, group, tuple(int(str(row["take_id"])) for row in clips), edges[-1], truth)
