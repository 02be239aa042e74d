"""Examples: intervals of takes from clips, labels and label files are learned from alike."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from kinedex.catalog.classes import load_classes
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.annotation.threshold_calibration import calibrate
from kinedex.pipelines.engine.executors import make_executor
from kinedex.pipelines.keyframes.query_learning import training_sets
from kinedex.pipelines.stages.annotate import Annotate
from kinedex.pipelines.stages.learn_templates import LearnTemplates
from kinedex.pipelines.templates.examples import (
    ExampleParameters,
    Rejected,
    examples_of,
    examples_read,
    interval_of,
    rejected_examples,
)
from kinedex.pipelines.templates.template_learning import TrainingClips, example_clips, learn_templates
from kinedex.storage.store.result_changes import record_labels
from kinedex.storage.store.store import Store, open_store
from tests.pipelines.labelled import CLIPS, POSES, Line, labelled_line, long_take, motion, write_store


@pytest.fixture
def line(tmp_path: Path) -> Line:
    return labelled_line(tmp_path)


def label(line: Line, take: str, name: str, start: int, stop: int, **more: object) -> None:
    row = {"take": take, "class": name, "start": start, "stop": stop, "origin": "drawn", **more}
    record_labels(line.store, pa.Table.from_pylist([row]))


def opened(line: Line) -> Store:
    return open_store(line.store, at="newest")


def learned(line: Line, **params: object) -> dict[tuple[str, str], tuple[list[float], list[str]]]:
    line.run(LearnTemplates, **params)
    rows = opened(line).result("templates").to_pylist()
    return {(row["subclass"], row["kind"]): (row["values"], row["clips"]) for row in rows}


def test_labels_teach_what_clips_of_the_same_words_teach(tmp_path: Path) -> None:
    """The words of clips stand one after the other in a take, with labels that divide it."""
    clips = sorted(CLIPS, key=lambda one: str(one["name"]))
    words = np.concatenate([np.asarray(one["words"]) for one in clips])
    whole = {"name": "zoe", "actor": "zoe", "class": None, "words": words}
    line = Line(write_store(tmp_path / "store", [*CLIPS, whole]))
    expected = learned(line)
    start = 0
    for one in clips:
        stop = start + len(np.asarray(one["words"]))
        label(line, "zoe", str(one["class"]), start, stop)
        start = stop
    found = learned(line, examples=["labels"])
    assert {key: values for key, (values, _) in found.items()} == {key: values for key, (values, _) in expected.items()}
    assert found["kick", "soft"][1][0].startswith("zoe[")
    both = learned(line, examples=["clips", "labels"])
    assert [len(names) for _, names in both.values()] == [6] * len(both)
    line.run(Annotate, method="best")  # reads the words of the examples by their names


def test_an_interval_that_several_sources_name_is_one_example(line: Line) -> None:
    label(line, "cat_take01", "walk", 5, 25)
    label(line, "ann_walk_001", "walk", 0, 16)  # the whole clip
    files = ["clips", "labels", "**/ground_truth.csv"]
    chosen = examples_of(opened(line), ExampleParameters(examples=files))
    found, remarks = chosen.examples, chosen.remarks
    assert remarks == []
    names = [(one.name, one.label) for one in found]
    assert len(names) == len(set(names)) == len(CLIPS) + 4
    assert ("cat_take01[5:25]", "walk") in names
    assert ("cat_take01", "walk") not in names
    some = ExampleParameters(examples=files, labels_where="actor = 'bob'")
    assert {one.take for one in examples_of(opened(line), some).examples if one.source != "clip"} == {"bob_take01"}


def test_an_invalid_end_of_an_interval_is_cut_off_as_that_of_a_clip(tmp_path: Path) -> None:
    take = long_take("cat", "cat", "walk", "kick")
    words = np.array(take["words"])
    words[:2] = np.iinfo(np.uint64).max
    line = Line(write_store(tmp_path / "store", [{**take, "words": words}]))
    label(line, "cat", "walk", 0, 20)
    (clips,) = example_clips(opened(line), examples_of(opened(line), ExampleParameters(examples=["labels"])).examples)
    assert np.array_equal(clips.words[0], motion("walk")[2:])
    assert clips.names == ("cat[0:20]",)
    assert "cut off: cat[0:20]" in clips.remarks[0]


def test_labels_that_do_not_fit_their_take_are_reported(line: Line) -> None:
    label(line, "cat_take01", "walk", 5, 25, checksum="ff" * 32)
    label(line, "cat_take01", "walk", 5, 5000)
    label(line, "nobody", "walk", 0, 9)
    chosen = examples_of(opened(line), ExampleParameters(examples=["labels"]))
    found, remarks = chosen.examples, chosen.remarks
    assert [one.name for one in found] == ["cat_take01[5:25]"]
    assert remarks == [
        "labels beyond the end of their take, excluded: cat_take01[5:5000]",
        "labels made when the take's file was another one, learned from all the same: cat_take01[5:25]",
    ]


def test_without_any_example_the_sources_are_named(line: Line) -> None:
    with pytest.raises(KinedexError, match=r"no example to learn from: `examples` are labels, .*labels list"):
        examples_of(opened(line), ExampleParameters(examples=["labels"]))


def test_only_examples_change_what_is_learned(line: Line) -> None:
    clips, both = ExampleParameters(), ExampleParameters(examples=["clips", "labels"])
    before = [examples_read(opened(line), one).digest for one in (clips, both)]
    label(line, "cat_take01", "walk", 5, 25, verdict="negative")
    after = [examples_read(opened(line), one) for one in (clips, both)]
    assert after[0].digest == before[0]
    assert after[1].digest != before[1]
    assert after[1].what == "9 clips, 1 labelled interval"


def test_names_of_intervals_are_read_again() -> None:
    takes = {"a", "b[1:2]"}
    assert interval_of("a", takes) == ("a", slice(None))
    assert interval_of("a[3:9]", takes) == ("a", slice(3, 9))
    assert interval_of("b[1:2]", takes) == ("b[1:2]", slice(None))
    assert interval_of("gone[1:2]", takes) == ("gone[1:2]", slice(None))


def test_a_rejected_interval_is_negative_for_its_class_alone(line: Line) -> None:
    label(line, "cat_take01", "walk", 5, 25, verdict="negative", origin="accepted")
    store, params = opened(line), ExampleParameters(examples=["clips", "labels"])
    (rejected,) = rejected_examples(store, params)
    assert (rejected.label, rejected.take, len(rejected.words)) == ("walk", "cat_take01", 20)
    assert rejected_examples(store, ExampleParameters()) == []
    label(line, "cat_take01", "walk", 40, 60, verdict="negative", origin="accepted")
    label(line, "cat_take01", "walk", 50, 59)  # the rejected one was cut badly
    assert len(rejected_examples(opened(line), params)) == 1
    clips = example_clips(store, examples_of(store, params).examples)
    plain = {one.subclass: one for one in training_sets(clips, load_classes("own", list(POSES)))}
    shown = {one.subclass: one for one in training_sets(clips, load_classes("own", list(POSES)), [rejected])}
    assert len(shown["walk"].negatives) == len(plain["walk"].negatives) + 1
    assert shown["kick"].clips_key() == plain["kick"].clips_key()
    assert shown["walk"].clips_key() != plain["walk"].clips_key()


def test_a_rejected_interval_lowers_the_threshold_of_its_class(tmp_path: Path) -> None:
    random = np.random.default_rng(5)

    def near(subclass: str, flips: int) -> np.ndarray:
        """Motion of a class with so many other features in each pose."""
        words = POSES[subclass].copy()
        for bit in random.choice(40, flips, replace=False):
            words ^= np.uint64(1 << int(bit))
        return np.repeat(words, 5)

    clips = [
        TrainingClips(name, ("ann_1", "bob_1"), (near(name, 1), near(name, 6)), takes=(f"ann_{name}", f"bob_{name}"))
        for name in ("walk", "kick")
    ]
    actors = {f"{actor}_{name}": actor for actor in ("ann", "bob") for name in ("walk", "kick")}
    executor = make_executor("serial")

    def learn(some: object) -> list[object]:
        return [one for task in learn_templates(some, ["soft"], 40, executor) for one in task]  # type: ignore[arg-type]

    def taus(*rejected: Rejected) -> dict[str, float]:
        classes = load_classes("own", ["walk", "kick"])
        return calibrate(clips, actors, classes, 0.05, learn, executor, rejected).taus  # type: ignore[arg-type]

    before = taus()
    for actor in ("ann", "bob", "cat"):
        after = taus(*[Rejected("walk", f"{actor}_walk" if actor != "cat" else "cat", near("walk", 9))] * 3)
        assert after["kick"] == before["kick"]
        assert after["walk"] < before["walk"]


def test_folds_exclude_intervals_by_the_takes_that_they_are_of(line: Line) -> None:
    label(line, "bob_take01", "wave", 0, 24)
    label(line, "cat_take01", "walk", 5, 25)
    store = opened(line)
    clips = example_clips(store, examples_of(store, ExampleParameters(examples=["clips", "labels"])).examples)
    (waves,) = (one for one in clips if one.subclass == "wave")
    assert "bob_take01[0:24]" in waves.names
    assert "bob_take01[0:24]" not in waves.without({"bob_take01"}).names
    assert waves.only({"bob_take01"}).names == ("bob_take01[0:24]",)
