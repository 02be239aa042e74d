"""Tests of the division of takes into folds: every excluded take is reported."""

from __future__ import annotations

from collections import Counter

import numpy as np
import polars as pl

from kinedex.catalog.classes import Classes, MotionClass
from kinedex.pipelines.evaluation.comparison_parameters import Split
from kinedex.pipelines.evaluation.folds import Fold, Material, make_folds
from kinedex.pipelines.evaluation.ground_truth import GroundTruth, Manual
from kinedex.pipelines.templates.template_learning import TrainingClips

CLASSES = Classes(tuple(MotionClass(name, name, (name,)) for name in ("walk", "kick")))


def takes(*rows: tuple[str, str | None, str | None]) -> pl.DataFrame:
    """Takes of ten frames: name, actor, class."""
    schema = {"take_id": pl.Int64, "name": pl.String, "actor": pl.String, "class": pl.String, "frames": pl.Int64}
    return pl.DataFrame([(index, *row, 10) for index, row in enumerate(rows)], schema=schema, orient="row")


def material(training: pl.DataFrame, tested: pl.DataFrame) -> Material:
    def place(some: pl.DataFrame) -> GroundTruth:
        found = [Manual(row["take_id"], row["name"], "walk", 0, 5, 0, 20, "") for row in some.iter_rows(named=True)]
        return GroundTruth(tuple(found), tuple(sorted(some["name"])))

    words = np.zeros(10, np.uint64)
    clips = tuple(
        TrainingClips(str(label), tuple(own["name"]), (words,) * own.height)
        for (label,), own in training.drop_nulls("class").group_by("class", maintain_order=True)
    )
    return Material(training, clips, tested, CLASSES, place, "actor")


def message(folds: list[Fold]) -> list[str]:
    return list(dict.fromkeys(remark for fold in folds for remark in fold.remarks))


def test_a_fold_without_a_clip_to_learn_from_is_told_with_its_takes() -> None:
    training = takes(("c1", "ann", "walk"), ("c2", "ann", "kick"))
    tested = takes(("ann_long", "ann", None), ("bob_long", "bob", None))
    folds = make_folds(Split(name="x", leave_out="actor"), material(training, tested))
    assert [fold.name for fold in folds] == ["bob"]
    assert (
        "ann: all training clips are of actor ann, so there is no such fold; not annotated: 1 take (ann_long)"
        in message(folds)
    )


def test_takes_without_a_value_of_what_is_left_out_are_told() -> None:
    training = takes(("c1", "ann", "walk"), ("c2", "bob", "walk"))
    tested = takes(("ann_long", "ann", None), ("stray", None, None), ("bob_long", "bob", None))
    folds = make_folds(Split(name="x", leave_out="actor"), material(training, tested))
    assert [fold.name for fold in folds] == ["ann", "bob"]
    assert message(folds) == ["1 take without actor, in no fold and not annotated: stray"]


LAID_OUT = {"name": "x", "clips_as_takes": True, "clips_a_take": 3, "orders": 2, "most_clips": 2}


def clips(actors: tuple[str, ...] = ("ann", "bob", "cat"), each: int = 4) -> pl.DataFrame:
    rows = [(f"{who}_{label}{n}", who, label) for who in actors for label in ("walk", "kick") for n in range(each)]
    return takes(*rows)


def test_clips_that_are_not_used_are_told() -> None:
    few = clips(("ann", "bob"), 3)
    stray = takes(("dance1", "ann", "dance"), ("dance2", "ann", None)).with_columns(pl.col("take_id") + 100)
    folds = make_folds(Split(**LAID_OUT, leave_out="actor"), material(few, pl.concat([few, stray])))
    used = Counter(take_id for fold in folds for test_take in fold.test_takes for take_id in test_take.take_ids)
    assert max(used) < 100
    assert sum(used.values()) == 2 * 2 * 2 * 2  # actors, orders, classes, most_clips
    assert message(folds)[:2] == [
        "2 clips of no class, excluded: of dance; 1 without a subclass",
        f"{len(used)} of 12 clips are used, each {16 / len(used):.1f} times on average (orders: 2, most_clips: 2)",
    ]


def test_clips_of_one_take_are_of_one_actor() -> None:
    every = clips()
    folds = make_folds(Split(**LAID_OUT, folds=2), material(every, every))
    actors = dict(every.select("take_id", "actor").iter_rows())
    test_takes = [test_take for fold in folds for test_take in fold.test_takes]
    assert {test_take.group for test_take in test_takes} == {"ann", "bob", "cat"}
    for test_take in test_takes:
        assert {actors[take_id] for take_id in test_take.take_ids} == {test_take.group}
    assert len({test_take.name for test_take in test_takes}) == len(test_takes)
