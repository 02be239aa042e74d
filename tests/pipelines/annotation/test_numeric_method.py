"""Method numeric labels takes by joint positions, in the stages, in comparisons and in Python, with the same labels."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import kinedex
from kinedex.catalog.classes import load_classes
from kinedex.catalog.queries.keyframe_query import Keyframe, KeyframeQuery
from kinedex.ops.errors import KinedexError
from kinedex.ops.numeric.recogniser import Recogniser, TaughtMotion
from kinedex.ops.templates.templates import learn_soft
from kinedex.ops.words import NO_WORD, TakeWords
from kinedex.pipelines.annotation import batches
from kinedex.pipelines.annotation.annotators import Annotator, make_annotator
from kinedex.pipelines.annotation.batches import annotate_words
from kinedex.pipelines.annotation.earlier_annotations import setting_digest
from kinedex.pipelines.annotation.methods import LabelledMotion, Material, Motion, Motions
from kinedex.pipelines.annotation.numeric_method import NumericMethod
from kinedex.pipelines.engine.executors import make_executor
from kinedex.pipelines.stages.annotate import Annotate
from kinedex.pipelines.stages.compare_methods import CompareMethods
from kinedex.pipelines.stages.learn_templates import LearnTemplates
from kinedex.pipelines.templates.template_learning import SubclassTemplate
from kinedex.storage.store.store import open_store
from tests.ops.numeric.motions import RATE_HZ, in_a_row, motion
from tests.pipelines.labelled import BODY, Line, write_store

CLASSES = ("bow", "raise left", "raise right")
ROWS = {
    "cat_take01": (["walk", "bow", "stand", "raise left", "walk"], [50, 40, 45, 42, 50]),
    "cat_take02": (["stand", "raise right", "bow", "walk", "raise left"], [40, 38, 42, 60, 36]),
    "dan_take01": (["walk", "raise right", "walk"], [45, 40, 45]),
}


def words_of(frames: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 1 << 40, frames, dtype=np.uint64)


def take(name: str, label: str | None, positions: np.ndarray, seed: int) -> dict[str, object]:
    words = words_of(len(positions), seed)
    moved = positions.transpose(1, 2, 0)
    return {"name": name, "actor": name[:3], "class": label, "words": words, "positions": moved}


def archive() -> list[dict[str, object]]:
    clips = [
        take(f"{actor}_{label}_{k}", label, motion(label, 36 + 2 * k, 10 * place + k), 100 + 10 * place + k)
        for place, label in enumerate(CLASSES)
        for k, actor in enumerate(("ann", "bob", "ann", "bob"))
    ]
    rows = [take(name, None, in_a_row(*row, 300 + 10 * k), 400 + k) for k, (name, row) in enumerate(ROWS.items())]
    return clips + rows


def truth_of(folder: Path) -> None:
    lines = ["take,class,start,stop"]
    for name, (labels, frames) in ROWS.items():
        edges = (4 * np.cumsum([0, *frames])).tolist()  # of frames at 120 Hz
        parts = zip(labels, edges, edges[1:], strict=False)
        lines += [f"{name},{label},{start},{stop}" for label, start, stop in parts if label in CLASSES]
    (folder / "ground_truth.csv").write_text("\n".join(lines) + "\n")


@pytest.fixture
def line(tmp_path: Path) -> Line:
    folder = tmp_path / "archive"
    folder.mkdir()
    truth_of(folder)
    made = Line(write_store(tmp_path / "store", archive(), folder))
    made.run(LearnTemplates, methods=["soft"])
    return made


def rows(line: Line) -> list[dict]:
    return open_store(line.store).result("annotations").drop_columns(["run"]).to_pylist()


def test_the_stage_labels_the_motions_of_takes_with_probabilities(line: Line) -> None:
    summary = line.run(Annotate, method="numeric")
    found = rows(line)
    named = {name: [row["class"] for row in found if row["take"] == name] for name in ROWS}
    assert all(set(named[name]) & set(labels) for name, (labels, _) in ROWS.items())
    assert all(row["method"] == "numbers" and row["cost"] is None for row in found)
    assert all(0 < row["confidence"] <= 1 and row["confidence"] == row["margin"] for row in found)
    assert summary["templates"] == 0
    assert "confidences are the probabilities that the method gives" in line.printed.getvalue()


def test_the_stage_finds_what_the_recogniser_finds(line: Line) -> None:
    line.run(Annotate, method="numeric")
    store = open_store(line.store)
    whole = {
        name: store.positions([(take_id, 0, store.take_frames[take_id])])[0].astype(np.float64)
        for name, take_id in store.take_ids.items()
    }
    labels = dict(store.takes().select("name", "class").iter_rows())
    examples = [TaughtMotion(whole[name], label, name) for name, label in sorted(labels.items()) if label is not None]
    mirror = {"raise left": "raise right", "raise right": "raise left"}
    ordered = sorted(examples, key=lambda one: one.label)
    taught = Recogniser.fit(ordered, [whole[name] for name in store.take_ids], BODY.joints, RATE_HZ, mirror)
    expected = [
        (name, one.label, one.start, one.stop, one.probability) for name in ROWS for one in taught.label(whole[name])
    ]
    assert [(row["take"], row["class"], row["start"], row["stop"], row["confidence"]) for row in rows(line)] == expected


def test_batches_and_processes_change_no_label(line: Line, monkeypatch: pytest.MonkeyPatch) -> None:
    found = []
    for frames, executor in ((50_000, "serial"), (1, "serial"), (100, "processes")):
        monkeypatch.setattr(batches, "BATCH_FRAMES", frames)
        line.executor = make_executor(executor, 2)
        line.run(Annotate, method="numeric")
        found.append(rows(line))
    assert found[0] == found[1] == found[2]


def test_methods_are_compared_and_a_comparison_learns_no_more_than_it_needs(
    line: Line, monkeypatch: pytest.MonkeyPatch
) -> None:
    methods = [{"name": name, "method": name} for name in ("thesis", "best", "numeric")]
    line.run(CompareMethods, methods=methods, splits=[{"name": "rows"}], ground_truth="**/ground_truth.csv")
    cells = open_store(line.store).result("method_cells").to_pylist()
    line.run(Annotate, method="numeric")
    annotated = rows(line)
    for name in ROWS:
        (cell,) = [one for one in cells if one["method"] == "numeric" and one["take"] == name]
        own = [row for row in annotated if row["take"] == name]
        assert cell["classes"] == [row["class"] for row in own]
        assert cell["starts"] == [row["start"] for row in own]
        assert cell["confidences"] == [row["margin"] for row in own]
    split = {"name": "clips", "test": "class IS NOT NULL", "leave_out": "actor", "clips_as_takes": True}
    found = line.run(CompareMethods, methods=methods[2:], splits=[split], ground_truth="**/ground_truth.csv")
    assert found["folds"] == 2
    assert found["f1"] > 0.8


def test_labels_of_people_are_examples_with_their_edges(line: Line) -> None:
    (_, frames) = ROWS["cat_take01"]
    edges = np.cumsum([0, *frames]).tolist()
    marked = {"class": "march", "start": edges[0], "stop": edges[1]}
    kinedex.open_store(line.store).labels.add([{"take": "cat_take01", **marked}], annotator="ann")
    line.run(LearnTemplates, methods=["soft"], examples=["clips", "labels"])
    line.run(Annotate, method="numeric", where="name = 'cat_take01'")
    marches = [row for row in rows(line) if row["class"] == "march"]
    assert abs(marches[0]["start"] - edges[0]) < 8
    assert abs(marches[0]["stop"] - edges[1]) < 8


def test_python_gives_the_labels_of_the_pipeline(line: Line) -> None:
    line.run(Annotate, method="numeric")
    store = kinedex.open_store(line.store)
    examples = {label: [store[name] for name in store.takes(f"class = '{label}'")["name"]] for label in CLASSES}
    found = kinedex.annotate(store, examples, method="numeric", where="class IS NULL")
    columns = ["take", "class", "start", "stop", "confidence", "margin", "method"]
    piped = pl.DataFrame(rows(line)).select(columns)
    assert found.select(columns).equals(piped)
    learned = [kinedex.Template.learn(own, name) for name, own in examples.items()]
    by_templates = kinedex.annotate(store, learned, method="numeric", where="class IS NULL")
    assert by_templates.select(columns).equals(piped)
    loaded = [store[name] for name in ROWS]
    alone = kinedex.annotate(loaded, examples, method="numeric")  # with another background
    assert alone["class"].to_list() == piped["class"].to_list()


def example(label: str, positions: np.ndarray, **more: object) -> LabelledMotion:
    return LabelledMotion(
        label=label, take=f"{label} {len(positions)}", stop=len(positions), positions=positions, **more
    )


def annotator(
    examples: list[LabelledMotion],
    queries: tuple[KeyframeQuery, ...] = (),
    templates: Sequence[SubclassTemplate] = (),
    **more: object,
) -> Annotator:
    archive = Motions(lambda: [Motion(positions=in_a_row(["walk", "stand"], [60, 50], 500))])
    classes = load_classes("own", {one.label for one in examples})
    material = Material(Motions(lambda: examples), archive, RATE_HZ, **more)
    return make_annotator(BODY, templates, classes, 0.05, 0.13, queries, NumericMethod, material)


TAUGHT = [example(label, motion(label, 36 + 2 * k, 10 * p + k)) for p, label in enumerate(CLASSES) for k in range(3)]
TAKE = in_a_row(*ROWS["cat_take02"], 700)


def found_in(made: Annotator, positions: np.ndarray, words: np.ndarray | None = None) -> list[tuple[str, int, int]]:
    own = words_of(len(positions), 5) if words is None else words
    laid = TakeWords(np.zeros(1, np.int64), np.array([0, len(own)], np.int64), own)
    (one,) = annotate_words(made, laid, positions=[positions])
    return [(made.classes[segment.class_index], segment.start, segment.stop) for segment in one.segments]


def test_invalid_frames_divide_a_take() -> None:
    made = annotator(TAUGHT)
    broken = TAKE.copy()
    middle = sum(ROWS["cat_take02"][1][:3]) + 30  # within the walk
    broken[middle : middle + 4, 3] = np.nan
    parts = [found_in(made, TAKE[:middle]), found_in(made, TAKE[middle + 4 :])]
    moved = [(label, start + middle + 4, stop + middle + 4) for label, start, stop in parts[1]]
    assert found_in(made, broken) == parts[0] + moved
    words = words_of(len(TAKE), 5)
    words[middle : middle + 4] = NO_WORD
    assert found_in(made, TAKE, words) == parts[0] + moved


def test_examples_that_cannot_teach_are_left_out_and_named() -> None:
    hole = motion("bow", 40)
    hole[20, 3] = np.nan
    made = annotator([*TAUGHT, example("nod", motion("bow", 2)), example("bow", hole)])
    assert made.remarks[:2] == (
        "examples with fewer than 3 frames, or too few joints for a heading and a size, left out: nod 2[0:2]",
        "classes that are left without an example, which nothing can be labelled with: nod",
    )
    with pytest.raises(KinedexError, match=r"no example has 3 frames or more .*: nod 2\[0:2\]; learn from other clips"):
        annotator([example("nod", motion("bow", 2))])


def test_one_take_alone_gives_no_calibrated_probabilities() -> None:
    alone = [LabelledMotion(label=one.label, take="only", positions=one.positions) for one in TAUGHT]
    (remark,) = annotator(alone).remarks
    assert remark.startswith("all examples are of one take or person")


def test_a_mirrored_example_teaches_a_class_that_has_no_other() -> None:
    one_sided = [one for one in TAUGHT if one.label != "raise right"]
    mirrored = [example("raise right", own.positions, mirrored=True) for own in TAUGHT if own.label == "raise right"]
    labels = [label for label, *_ in found_in(annotator([*one_sided, *mirrored]), TAKE)]
    assert "raise right" in labels
    # those of a class that has others are left to the recogniser
    others = [example("raise right", TAUGHT[0].positions, mirrored=True)]
    same = found_in(annotator([*TAUGHT, *others]), TAKE)
    assert same == found_in(annotator(TAUGHT), TAKE)


def test_keyframe_queries_preselect_frames_with_the_margins_of_templates() -> None:
    pose = 0b1010_1010_1010
    query = KeyframeQuery("it", "raise right", (Keyframe("upper", 0x3FFF, pose),), ())
    template = SubclassTemplate("raise right", "soft", learn_soft([np.full(40, pose, np.uint64)], 40), ("clip",))
    made = annotator(TAUGHT, (query,), templates=[template])
    edges = np.cumsum([0, *ROWS["cat_take02"][1]])
    words = np.zeros(len(TAKE), np.uint64)
    every = found_in(annotator(TAUGHT), TAKE)
    assert found_in(made, TAKE, words) == [one for one in every if one[0] != "raise right"]
    words[edges[1] : edges[2]] = pose
    raised = [one for one in every if one[0] == "raise right"]
    within = [one for one in raised if edges[1] - 45 <= one[1] and one[2] <= edges[2] + 45]
    assert within
    assert found_in(made, TAKE, words) == [one for one in every if one[0] != "raise right" or one in within]
    assert made.label == "numbers within keyframe hits"


def test_everything_that_teaches_decides_the_hash_of_the_annotator() -> None:
    base = setting_digest(annotator(TAUGHT), True, "")
    assert setting_digest(annotator(TAUGHT), True, "") == base
    for other in (annotator(TAUGHT[1:]), annotator(TAUGHT, mirror={"bow": "bow"})):
        assert setting_digest(other, True, "") != base


def test_a_take_that_cannot_be_measured_is_named(line: Line) -> None:
    made = annotator(TAUGHT)
    with pytest.raises(KinedexError, match="take_id 0 cannot be labelled by `method: numeric`: positions must be"):
        found_in(made, np.zeros((50, 24, 3)))


def test_a_body_that_lacks_joints_is_labelled_by_the_others() -> None:
    made = annotator(TAUGHT)
    mask = BODY.known([joint for joint in BODY.joints if joint not in ("ltoes", "rtoes")])
    own = words_of(len(TAKE), 5) & np.uint64(mask)
    laid = TakeWords(np.zeros(1, np.int64), np.array([0, len(own)], np.int64), own, np.array([mask], np.uint64))
    without = TAKE.copy()
    without[:, [BODY.joints.index(joint) for joint in ("ltoes", "rtoes")]] = np.nan
    whole = {one[0] for one in found_in(made, TAKE)}
    (found,) = annotate_words(made, laid, positions=[without])
    assert {made.classes[one.class_index] for one in found.segments} == whole
    legless = TAKE.copy()
    legless[:, [BODY.joints.index(joint) for joint in ("lknee", "rknee")]] = np.nan
    assert [one.segments for one in annotate_words(made, laid, positions=[legless])] == [()]
    (remark,) = made.remarks_on({0: mask})
    assert remark.startswith("1 take whose bodies lack joints (")
    assert "without a pair of hips or shoulders" in remark
