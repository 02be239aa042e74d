"""Folds: the clips that are learned from, and the takes that are annotated, with what is true of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import polars as pl

from catalog.classes import Classes
from ops.errors import KinedexError, did_you_mean
from pipelines.evaluation.groundtruth import GroundTruth
from pipelines.evaluation.scheme import Split
from pipelines.stages.leave_one_out import without
from pipelines.templates.learning import TrainingClips
from pipelines.wording import few

Truth = tuple[str, int, int]
"""A class and the analysis frames [start, stop) that it is in."""

WHOLE = "all"
"""The name of the only fold of a fixed split."""

PlaceTruth = Callable[[pl.DataFrame], GroundTruth]


@dataclass(frozen=True)
class Exam:
    """A take that is annotated: one of the store, or several clips of the store laid end to end.

    name: the take's, or one made of the fold and a number. group: what Table 5.2 is divided by. take_ids: the parts.
    """

    name: str
    group: str
    take_ids: tuple[int, ...]
    frames: int
    truth: tuple[Truth, ...]


@dataclass(frozen=True)
class Fold:
    """One fold of a split. remarks: what is to be known of it, in words."""

    split: str
    name: str
    clips: tuple[TrainingClips, ...]
    exams: tuple[Exam, ...]
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True)
class Material:
    """What a split is made of: takes to learn from with their clips, takes to annotate, and what places their truth.

    group: the column of takes that results are divided by.
    """

    training: pl.DataFrame
    clips: tuple[TrainingClips, ...]
    tested: pl.DataFrame
    classes: Classes
    place: PlaceTruth
    group: str


def make_folds(split: Split, material: Material) -> list[Fold]:
    """Divide the takes of a split into folds.

    Returns
    -------
    At least one fold; no take is annotated with templates that it was learned from.

    Raises
    ------
    KinedexError: nothing to annotate or to learn from, a column that takes do not have, or a fixed split in which
        takes to annotate are takes to learn from as well.
    """
    tested = material.tested
    if not tested.height:
        raise KinedexError(f"split '{split.name}': no take to annotate, the filter `{split.test}` selects none")
    remarks: tuple[str, ...] = ()
    if split.clips_as_takes:
        known = [name is not None and material.classes.class_of(name) is not None for name in tested["class"]]
        if not any(known):
            raise KinedexError(
                f"split '{split.name}': none of the {tested.height} takes that `{split.test}` selects has a class of "
                "this evaluation; with clips_as_takes they are clips, such as `test: class IS NOT NULL`"
            )
        tested = tested.filter(pl.Series(known))
    else:
        truth = material.place(tested)
        remarks = truth.remarks
        tested = tested.filter(pl.col("name").is_in(truth.takes))
    folds = [_fold(split, name, takes, material, remarks) for name, takes in _parts(split, tested.sort("name"))]
    usable = [fold for fold in folds if fold.clips and fold.exams]
    if not usable:
        raise KinedexError(f"split '{split.name}': no fold has both clips to learn from and takes to annotate")
    return usable


def _parts(split: Split, tested: pl.DataFrame) -> list[tuple[str, pl.DataFrame]]:
    """The takes to annotate of each fold."""
    if split.leave_out is not None:
        column = split.leave_out
        if column not in tested.columns:
            raise KinedexError(
                f"split '{split.name}': takes have no column '{column}'{did_you_mean(column, tested.columns)}"
            )
        values = tested[column].drop_nulls().unique().sort().to_list()
        if not values:
            raise KinedexError(f"split '{split.name}': none of the takes to annotate has a value of '{column}'")
        return [(str(value), tested.filter(pl.col(column) == value)) for value in values]
    if split.folds is None:
        return [(WHOLE, tested)]
    if split.folds > tested.height:
        raise KinedexError(f"split '{split.name}': {split.folds} folds of {tested.height} takes; set fewer")
    drawn = tested[np.random.default_rng(split.seed).permutation(tested.height).tolist()]
    if split.clips_as_takes:  # the clips of each class are dealt to all folds
        drawn = drawn.sort("class", maintain_order=True)
    tested, dealt = drawn, np.arange(tested.height) % split.folds
    return [(f"fold {index + 1}", tested.filter(pl.Series(dealt == index))) for index in range(split.folds)]


def _fold(split: Split, name: str, tested: pl.DataFrame, material: Material, remarks: tuple[str, ...]) -> Fold:
    names = set(tested["name"].to_list())
    left_out = set(names)
    if split.leave_out is not None and split.leave_out in material.training.columns:
        value = tested[split.leave_out][0]
        left_out |= set(material.training.filter(pl.col(split.leave_out) == value)["name"].to_list())
    trained = {clip for one in material.clips for clip in one.names}
    both = sorted(names & trained)
    if both and split.leave_out is None and split.folds is None:
        raise KinedexError(
            f"split '{split.name}': takes to annotate are learned from as well: {few(both)}; make `train` and `test` "
            "exclude each other, or use `leave_out` or `folds`"
        )
    clips = tuple(rest for one in material.clips if (rest := without(one, left_out)).names)
    said = list(remarks)
    gone = sorted({one.subclass for one in material.clips} - {one.subclass for one in clips})
    if gone:
        said.append(f"{name}: no clips of others, so no template: {few(gone)}")
    if split.leave_out is not None and not trained & left_out:
        said.append(f"{name}: no training clip is of {split.leave_out} {name}, so nothing is left out")
    if split.clips_as_takes:
        exams = _laid_out(split, name, tested, material)
        if split.orders > 1:
            said.append(
                f"clips are laid out in {split.orders} orders, so takes share clips: intervals are narrower than those "
                "of as many takes of their own"
            )
    else:
        exams = _as_they_are(tested, material)
    return Fold(split.name, name, clips, tuple(exams), tuple(said))


def _as_they_are(tested: pl.DataFrame, material: Material) -> list[Exam]:
    truth: dict[str, list[Truth]] = {}
    for one in material.place(tested).segments:
        truth.setdefault(one.take, []).append((one.label, one.start, one.stop))
    return [
        Exam(
            row["name"],
            _group([row], material.group),
            (row["take_id"],),
            row["frames"],
            tuple(sorted(truth.get(row["name"], ()), key=lambda one: one[1:])),
        )
        for row in tested.iter_rows(named=True)
    ]


def _laid_out(split: Split, fold: str, clips: pl.DataFrame, material: Material) -> list[Exam]:
    """Clips end to end in drawn orders: a class at most `most_clips` times in each."""
    rows = list(clips.sort("name").iter_rows(named=True))
    labels = sorted({row["class"] for row in rows})
    exams = []
    for order in range(split.orders):
        random = np.random.default_rng((split.seed, order))
        chosen = []
        for label in labels:
            own = [row for row in rows if row["class"] == label]
            chosen += [own[index] for index in random.permutation(len(own))[: split.most_clips].tolist()]
        drawn = [chosen[index] for index in random.permutation(len(chosen)).tolist()]
        for number, start in enumerate(range(0, len(drawn), split.clips_a_take), 1):
            part = drawn[start : start + split.clips_a_take]
            edges = np.cumsum([0, *(row["frames"] for row in part)]).tolist()
            truth = [
                (str(material.classes.class_of(row["class"])), begin, end)
                for row, begin, end in zip(part, edges, edges[1:], strict=False)
            ]
            name = f"{fold}: order {order + 1}, take {number}"
            ids = tuple(row["take_id"] for row in part)
            exams.append(Exam(name, _group(part, material.group), ids, edges[-1], tuple(truth)))
    return exams


def _group(rows: Sequence[dict[str, object]], column: str) -> str:
    values = sorted({str(row.get(column)) if row.get(column) is not None else f"no {column}" for row in rows})
    return " + ".join(values)
