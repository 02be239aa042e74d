"""Every example as a template of its own: a twin of `best`, what was rejected, and bodies that lack joints."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.catalog.classes import load_classes
from kinedex.ops.annotation.background import background
from kinedex.ops.errors import KinedexError
from kinedex.ops.words import TakeWords
from kinedex.pipelines.annotation.annotators import Annotator, make_annotator
from kinedex.pipelines.annotation.batches import annotate_words
from kinedex.pipelines.annotation.earlier_annotations import setting_digest
from kinedex.pipelines.annotation.methods import AnnotationMethod, LabelledMotion, Material, Motion, Motions
from kinedex.pipelines.annotation.parameters import AnnotationParameters
from kinedex.pipelines.annotation.single_examples import MAX_FRAMES, SingleExamples, usual_postures
from kinedex.pipelines.annotation.template_methods import BestMethod
from kinedex.pipelines.engine.executors import make_executor
from kinedex.pipelines.templates.template_learning import TrainingClips, learn_templates
from tests.pipelines.labelled import BODY, POSES, motion

NAMES = ("rest", "walk", "rest", "kick", "wave", "rest")
TAKE = np.concatenate([motion(name) for name in NAMES])
USUAL = background([TAKE], 40)
EDGES = np.cumsum([0, *(len(motion(name)) for name in NAMES)]).tolist()


def clips_of(label: str, *words: np.ndarray) -> TrainingClips:
    return TrainingClips(label, tuple(f"{label}{place}" for place in range(len(words))), words)


def averaged(clips: list[TrainingClips]) -> Annotator:
    return made_by(BestMethod, clips, lambda: [TAKE])


def made_by(method: type[AnnotationMethod], clips: list[TrainingClips], given: object) -> Annotator:
    templates = [one for task in learn_templates(clips, ["soft"], 40, make_executor("serial", None)) for one in task]
    classes = load_classes("own", {one.subclass for one in clips})
    return make_annotator(BODY, templates, classes, 0.05, 0.13, method=method, clips=given)


def single(clips: list[TrainingClips], *rejected: np.ndarray, examples: bool = True) -> Annotator:
    shown = [LabelledMotion(label=one.subclass, words=words) for one in clips if examples for words in one.words]
    shown += [LabelledMotion(label="walk", words=words, positive=False) for words in rejected]
    archive = Motions(lambda: [Motion(words=TAKE)])
    return made_by(SingleExamples, clips, Material(Motions(lambda: shown), archive))


def laid_out(take: np.ndarray, known: int | None = None) -> TakeWords:
    masks = None if known is None else np.array([known], np.uint64)
    return TakeWords(np.zeros(1, np.int64), np.array([0, len(take)], np.int64), take, masks)


def found(made: Annotator, words: TakeWords) -> list[tuple[str, str, int, int]]:
    (take,) = annotate_words(made, words)
    return [(made.classes[s.class_index], made.subclasses[s.subclass], s.start, s.stop) for s in take.segments]


@settings(max_examples=25, deadline=None)
@given(
    st.lists(st.sampled_from(sorted(POSES)), min_size=1, max_size=6),
    st.sets(st.sampled_from(["walk", "kick", "wave"]), min_size=1),
)
def test_one_example_of_each_class_labels_as_best_does(names: list[str], known: set[str]) -> None:
    take = np.concatenate([motion(name, 4) for name in names])
    clips = [clips_of(name, motion(name, 5)) for name in sorted(known)]
    twin = averaged(clips)
    one = single(clips)
    assert annotate_words(one, laid_out(take))[0].segments == annotate_words(twin, laid_out(take))[0].segments


def test_examples_that_differ_are_each_found_and_named_after_their_class() -> None:
    made = single([clips_of("turn", motion("walk"), motion("wave")), clips_of("kick", motion("kick"))])
    rotations = [("turn", "turn", EDGES[place], EDGES[place + 1]) for place in (1, 4)]
    assert found(made, laid_out(TAKE)) == [rotations[0], ("kick", "kick", EDGES[3], EDGES[4]), rotations[1]]
    assert made.label == "examples in a row"


def test_what_is_like_a_rejected_interval_has_no_label() -> None:
    noise = np.random.default_rng(1).integers(0, 1 << 40, len(POSES["walk"]), dtype=np.uint64)
    near = np.repeat(POSES["walk"] ^ (noise & np.uint64(0x01010101)), 5)  # up to four features differ
    take = np.concatenate([motion("rest"), near, motion("rest"), motion("walk"), motion("rest")])
    clips = [clips_of("walk", motion("walk"))]
    walk = ("walk", "walk", 2 * len(motion("rest")) + len(near), len(take) - len(motion("rest")))
    assert [one[0] for one in found(single(clips), laid_out(take))] == ["walk", "walk"]
    assert found(single(clips, near), laid_out(take)) == [walk]
    assert setting_digest(single(clips), False, "") != setting_digest(single(clips, near), False, "")


def test_a_take_that_lacks_features_is_labelled_by_those_that_it_has() -> None:
    clips = [clips_of("walk", motion("walk"))]
    most = (1 << 40) - 1 - 0b111  # three features are not known
    made = single(clips, motion("wave"))
    assert found(made, laid_out(TAKE & np.uint64(most), most)) == [("walk", "walk", EDGES[1], EDGES[2])]
    few = 0b111
    assert found(made, laid_out(TAKE & np.uint64(few), few)) == []


def test_a_template_without_examples_stays_as_it_is() -> None:
    clips = [clips_of("kick", motion("kick"))]
    assert found(single(clips, examples=False), laid_out(TAKE)) == found(averaged(clips), laid_out(TAKE))


def test_the_method_of_the_thesis_has_no_single_examples() -> None:
    assert AnnotationParameters(method="best", each_example=True).annotation_method is SingleExamples
    with pytest.raises(KinedexError, match="`each_example` is for `method: best`"):
        _ = AnnotationParameters(method="thesis", each_example=True).annotation_method


def test_usual_postures_are_learned_from_words_of_the_whole_archive() -> None:
    words = np.concatenate([TAKE] * (2 * MAX_FRAMES // len(TAKE)))
    assert usual_postures([Motion(words=words)], 40).shape == USUAL.shape
    np.testing.assert_allclose(usual_postures([Motion(words=TAKE)], 40), USUAL)
    assert usual_postures([], 40).shape == (1, 40)
