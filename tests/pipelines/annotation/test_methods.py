"""Methods of one form: what they need is read and nothing else, and batches and processes change no label."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from kinedex.catalog.classes import load_classes
from kinedex.ops.annotation.segments import Segment
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.annotation import batches, material
from kinedex.pipelines.annotation.annotators import make_annotator
from kinedex.pipelines.annotation.material import clip_examples, template_examples, unlabelled_pieces, unlabelled_takes
from kinedex.pipelines.annotation.methods import (
    METHODS,
    AnnotationMethod,
    LabelledMotion,
    Material,
    Motion,
    Motions,
    Needs,
    Setting,
    Takes,
    annotation_method,
)
from kinedex.pipelines.annotation.template_methods import BestMethod, ThesisMethod
from kinedex.pipelines.engine.executors import make_executor
from kinedex.pipelines.stages.annotate import Annotate
from kinedex.pipelines.stages.compare_methods import CompareMethods
from kinedex.pipelines.stages.learn_templates import LearnTemplates
from kinedex.pipelines.templates.examples import Rejected
from kinedex.pipelines.templates.template_learning import read_templates
from kinedex.pipelines.templates.training import TemplateParameters, training_material
from kinedex.storage.snapshot.snapshot import Snapshot
from kinedex.storage.store.store import Store, open_store
from tests.pipelines.labelled import BODY, CLIPS, TAKES, TRUTH, Line, labelled_line, write_store

GROUND_TRUTH = "**/ground_truth.csv"
HEIGHTS = {"walk": 0.9, "kick": 1.2, "wave": 0.6, None: 0.9}


@dataclass(frozen=True)
class Heights(AnnotationMethod):
    """A method by positions alone: a take shows the class whose examples have the root nearest to its height."""

    name: ClassVar[str] = "heights"
    label: ClassVar[str] = "heights"
    needs: ClassVar[Needs] = Needs(positions=True)

    heights: tuple[float, ...]

    @classmethod
    def fit(cls, examples: Motions[LabelledMotion], unlabelled: Motions[Motion], setting: Setting) -> Heights:
        return cls(
            tuple(
                float(np.mean([one.positions[:, 0, 1].mean() for one in examples if one.label == name]))
                for name in setting.subclasses
            )
        )

    def annotate(self, takes: Takes) -> list[list[Segment]]:
        found = []
        for take in takes:
            place = int(np.abs(take.positions[:, 0, 1].mean() - np.array(self.heights)).argmin())
            found.append([Segment(0, len(take.positions), place, float("nan"), place)])
        return found


def with_heights(take: dict[str, object]) -> dict[str, object]:
    """Return a take whose joints move a little about the height of its class."""
    frames = len(take["words"])  # type: ignore[arg-type]
    noise = np.random.default_rng(frames).normal(0, 0.01, (len(BODY.joints), 3, frames))
    noise[:, 1] += HEIGHTS[take["class"]]  # type: ignore[index]
    return {**take, "positions": noise}


@pytest.fixture
def line(tmp_path: Path) -> Line:
    archive = tmp_path / "archive"
    archive.mkdir()
    (archive / "ground_truth.csv").write_text(TRUTH)
    return Line(write_store(tmp_path / "store", [with_heights(one) for one in CLIPS + TAKES], archive))


@pytest.fixture
def heights(monkeypatch: pytest.MonkeyPatch) -> None:
    places = METHODS._places | {"heights": f"{__name__}:Heights"}
    monkeypatch.setattr(METHODS, "_places", places)
    monkeypatch.delitem(vars(METHODS), "_built_in", raising=False)


@pytest.fixture(autouse=True)
def forget_methods() -> Iterator[None]:
    yield
    vars(METHODS).pop("_built_in", None)


def never() -> list[LabelledMotion]:
    raise AssertionError("this was read")


def clips(store: Store) -> list:
    return training_material(store, TemplateParameters()).clips


def test_the_method_of_the_thesis_reads_no_example_and_best_reads_no_unlabelled_take(line: Line) -> None:
    line.run(LearnTemplates, methods=["soft"])
    store = open_store(line.store)
    templates = read_templates(store, "test/learn_templates", "soft")
    classes = load_classes("own", {one.subclass for one in templates})
    nothing = Material(Motions(never), Motions(never))
    make_annotator(BODY, templates, classes, 0.05, 0.13, method=ThesisMethod, clips=nothing)
    examples = Motions(lambda: template_examples(store, templates, BestMethod.needs))
    some = Material(examples, Motions(never))
    make_annotator(BODY, templates, classes, 0.05, 0.13, method=BestMethod, clips=some)
    with pytest.raises(AssertionError, match="this was read"):
        make_annotator(BODY, templates, classes, 0.05, 0.13, method=BestMethod, clips=nothing)


@pytest.mark.parametrize("method", ["thesis", "best"])
def test_positions_are_read_only_for_methods_that_need_them(
    line: Line, method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError("positions were read")

    line.run(LearnTemplates, methods=["soft"])
    monkeypatch.setattr(Snapshot, "positions", refuse)
    assert line.run(Annotate, method=method)["segments"] == 4
    methods = [{"name": method, "method": method}]
    line.run(CompareMethods, methods=methods, splits=[{"name": "all"}], ground_truth=GROUND_TRUTH)


def test_a_method_by_positions_needs_no_templates(line: Line, heights: None, monkeypatch: pytest.MonkeyPatch) -> None:
    line.run(LearnTemplates, methods=["soft"])
    summary = line.run(Annotate, method="heights")
    assert (summary["segments"], summary["templates"]) == (2, 0)
    rows = open_store(line.store).result("annotations").to_pylist()
    assert [(row["class"], row["method"], row["cost"], row["confidence"]) for row in rows] == [
        ("walk", "heights", None, None)
    ] * 2
    assert open_store(line.store).result("distance_curves").num_rows == 0

    def refuse(*_: object) -> None:
        raise AssertionError("templates were learned")

    monkeypatch.setattr("kinedex.pipelines.evaluation.fold_setup.learn_templates", refuse)
    split = {"name": "clips", "test": "class IS NOT NULL", "leave_out": "actor", "clips_as_takes": True}
    methods = [{"name": "heights", "method": "heights"}]
    found = line.run(CompareMethods, methods=methods, splits=[split], ground_truth=GROUND_TRUTH)
    assert found["folds"] == 2


def test_batches_and_processes_change_nothing(line: Line, heights: None, monkeypatch: pytest.MonkeyPatch) -> None:
    line.run(LearnTemplates, methods=["soft"])
    found = []
    for name, frames, executor in (("a", 50_000, "serial"), ("b", 1, "serial"), ("c", 100, "processes")):
        monkeypatch.setattr(batches, "BATCH_FRAMES", frames)
        line.executor = make_executor(executor, 2)
        for method in ("thesis", "best", "heights"):
            line.run(Annotate, method=method, store_curves=False, where="true")
            rows = open_store(line.store).result("annotations").drop_columns(["run"]).to_pylist()
            found.append((name, method, str(rows)))
    for method in ("thesis", "best", "heights"):
        assert len({rows for _, one, rows in found if one == method}) == 1


def test_examples_have_their_edges_words_and_positions(line: Line) -> None:
    store = open_store(line.store)
    needs = Needs(words=True, positions=True)
    rejected = [
        Rejected("walk", "cat_take01", store.words([store.take_ids["cat_take01"]]).words[5:15], start=5, stop=15)
    ]
    examples = clip_examples(store, clips(store), rejected, needs)
    assert len(examples) == len(CLIPS) + 1
    assert [one.positive for one in examples] == [True] * len(CLIPS) + [False]
    for one in examples:
        words = store.words([store.take_ids[one.take]]).words[one.start : one.stop]
        (positions,) = store.positions([(store.take_ids[one.take], one.start, one.stop)])
        np.testing.assert_array_equal(one.words, words)
        np.testing.assert_array_equal(one.positions, positions)
        assert one.valid.all()
    words_alone = clip_examples(store, clips(store), (), Needs(words=True))
    assert all(not len(one.positions) for one in words_alone)


def test_a_mirrored_example_has_mirrored_positions(line: Line) -> None:
    store = open_store(line.store)
    params = TemplateParameters(mirror={"kick": "kickback"})
    trained = training_material(store, params).clips
    assert [one.mirrored for one in trained if one.subclass == "kickback"] == [3]
    trained = [one.without({"ann_kick_001"}) for one in trained]
    examples = clip_examples(store, trained, (), Needs(positions=True))
    kicks, images = ([one for one in examples if one.label == name] for name in ("kick", "kickback"))
    assert [one.mirrored for one in (*kicks, *images)] == [False] * len(kicks) + [True] * len(images)
    left, right = (BODY.joints.index(name) for name in ("lwrist", "rwrist"))
    for one, image in zip(kicks, images, strict=True):
        np.testing.assert_array_equal(image.positions[:, left] * [-1, 1, 1], one.positions[:, right])


def test_unlabelled_takes_of_positions_are_bounded_and_spread_over_the_archive(
    line: Line, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = open_store(line.store)
    assert sum(len(one.positions) for one in unlabelled_takes(store, Needs(positions=True))) == sum(
        store.take_frames.values()
    )
    assert [len(one.words) for one in unlabelled_takes(store, Needs(words=True))] == store.words().frames.tolist()
    monkeypatch.setattr(material, "MAX_FRAMES", 300)
    monkeypatch.setattr(material, "PIECE_FRAMES", 30)
    frames = {7: 1000, 3: 10, 5: 500}
    pieces = unlabelled_pieces([7, 3, 5], frames)
    assert sum(stop - start for _, start, stop in pieces) <= 300
    assert all(0 <= start < stop <= frames[take] for take, start, stop in pieces)
    assert [pieces.count(one) for one in pieces] == [1] * len(pieces)
    assert {take for take, _, _ in pieces} >= {7, 5}
    assert pieces == unlabelled_pieces([7, 3, 5], frames)


def test_motions_are_read_once_and_what_is_computed_of_them_is_kept() -> None:
    reads: list[int] = []

    def read() -> list[Motion]:
        reads.append(1)
        return [Motion(words=np.arange(3, dtype=np.uint64))]

    motions = Motions(read)
    assert reads == []
    assert motions.once(len) == motions.once(len) == len(motions) == 1
    assert reads == [1]


class Former:
    """A method of the former form."""

    name, label, uses_thresholds = "former", "former", False

    @classmethod
    def prepare(cls, templates: object, clips: object) -> Former:
        return cls()

    def annotate(self, words: object, ranges: object) -> list[list[Segment]]:
        return []


@pytest.mark.parametrize(
    ("place", "message"),
    [("Former", r"former form .*docs/extending/method\.md says how to change it"), ("Segment", "must be a class that")],
)
def test_a_method_of_another_form_is_refused(monkeypatch: pytest.MonkeyPatch, place: str, message: str) -> None:
    monkeypatch.setattr(METHODS, "_places", {"former": f"{__name__}:{place}"})
    monkeypatch.delitem(vars(METHODS), "_built_in", raising=False)
    with pytest.raises(KinedexError, match=message):
        annotation_method("former")


def test_an_archive_without_a_take_of_a_class_says_so(tmp_path: Path, heights: None) -> None:
    line = labelled_line(tmp_path)
    line.run(LearnTemplates, methods=["soft"])
    store = open_store(line.store)
    given = Material(Motions(lambda: clip_examples(store, clips(store), (), Needs(positions=True))))
    classes = load_classes("own", {"dance"})
    with pytest.raises(KinedexError, match="none of the classes dance has an example; there are examples of: kick, "):
        make_annotator(BODY, [], classes, 0.05, 0.13, method=Heights, clips=given)
