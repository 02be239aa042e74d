"""Confidence that is calibrated on examples that are left out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kinedex.catalog.classes import OWN, load_classes
from kinedex.catalog.features import load_feature_set
from kinedex.pipelines.annotation.annotators import Annotator, make_annotator
from kinedex.pipelines.annotation.confidence_calibration import (
    FOLDS,
    MAX_CLIPS,
    CalibratedConfidence,
    Target,
    _concatenated,
    _parts,
    _thinned,
    calibrate_confidence,
    uncalibrated,
)
from kinedex.pipelines.annotation.methods import annotation_method
from kinedex.pipelines.engine.executors import make_executor
from kinedex.pipelines.templates.template_learning import SubclassTemplate, TrainingClips, learn_templates

BODY = load_feature_set("body40")


def clips(label: str, motion: int, actors: Sequence[str], seed: int) -> TrainingClips:
    """Clips of a drawn motion of 12 frames, with one bit in fifty wrong."""
    shown = np.random.default_rng(1000 + motion).integers(0, 1 << 40, 12).astype(np.uint64)
    random = np.random.default_rng(seed)
    words = []
    for _ in actors:
        noise = sum((random.random(12) < 0.02).astype(np.uint64) << np.uint64(bit) for bit in range(40))
        words.append(shown ^ noise)
    return TrainingClips(label, tuple(f"{actor}_{label}" for actor in actors), tuple(words))


def calibrated(some: Sequence[TrainingClips], method: str = "best", actor: str | None = None) -> CalibratedConfidence:
    executor = make_executor("serial", None)
    classes = load_classes(OWN, {one.subclass for one in some})

    def learn(few: Sequence[TrainingClips]) -> list[SubclassTemplate]:
        return [one for task in learn_templates(few, ["soft"], 40, executor) for one in task]

    def make(rest: Sequence[TrainingClips], *_: object) -> Annotator:
        chosen, words = annotation_method(method), [words for one in rest for words in one.words]
        return make_annotator(BODY, learn(rest), classes, 0.05, 0.13, method=chosen, clips=lambda: words)

    actors = {name: actor or name.split("_")[0] for one in some for name in one.names}
    return calibrate_confidence(some, actors, classes, method, Target([30, 30], ["new", None]), make, executor)


PEOPLE = [f"p{number}" for number in range(8)]


def test_a_class_that_others_are_taken_for_is_less_sure() -> None:
    # what is labelled "bend" is a wave in three of eight examples
    mixed, shown = clips("bend", 3, PEOPLE, 2), clips("wave", 2, PEOPLE, 3)
    unsure = TrainingClips("bend", mixed.names, (*mixed.words[:5], *shown.words[5:]))
    found = calibrated([clips("jump", 1, PEOPLE, 0), unsure, clips("wave", 2, PEOPLE, 1)])
    assert found.confidence is not None
    assert found.segments > found.right > 0
    assert f"calibrated on {found.segments} segments" in found.remark
    jump, wave = found.confidence.of(np.array([found.confidence.prior.centres] * 2), np.array([1, 2]))
    assert jump > wave


def test_the_other_method_is_calibrated_as_well() -> None:
    found = calibrated([clips("jump", 1, PEOPLE, 0), clips("wave", 2, PEOPLE, 1)], "thesis")
    assert found.segments >= found.right > 0


def test_the_same_examples_give_the_same_confidence() -> None:
    some = [clips("jump", 1, PEOPLE, 0), clips("wave", 2, PEOPLE, 1)]
    first, second = calibrated(some), calibrated(some)
    assert first.confidence is not None
    assert second.confidence is not None
    assert np.array_equal(first.confidence.coefficients, second.confidence.coefficients)


def test_examples_of_one_actor_are_left_out_take_by_take() -> None:
    some = [clips("jump", 1, PEOPLE, 0), clips("wave", 2, PEOPLE, 1)]
    assert calibrated(some, actor="ann").segments > 0


def test_one_example_a_class_leaves_the_prior() -> None:
    alone = calibrated([clips("jump", 1, ["ann"], 0), clips("wave", 2, ["bob"], 1)])
    prior = uncalibrated("best", 2)
    assert alone.confidence is not None
    assert prior is not None
    assert alone.segments == 0
    assert "not calibrated" in alone.remark
    assert np.array_equal(alone.confidence.coefficients, prior.coefficients)


def test_a_method_without_prior_has_no_confidence_without_examples() -> None:
    assert uncalibrated("mine", 3) is None


def test_actors_are_dealt_whole_to_few_parts() -> None:
    actors = {f"take{number}": f"p{number % 7}" for number in range(30)}
    parts = _parts(actors)
    assert sorted(set(parts.values())) == list(range(FOLDS))
    for person in set(actors.values()):
        assert len({parts[take] for take, actor in actors.items() if actor == person}) == 1


def test_takes_are_about_as_long_as_those_to_annotate() -> None:
    some = [clips("jump", 1, PEOPLE, 0), clips("wave", 2, PEOPLE, 1)]
    for frames, count in ((1, 1), (12, 1), (40, 4), (50, 4), (10**9, 16)):
        assert Target([frames], [None]).clips_per_take([12, 12]) == count
        takes = list(_concatenated(some, {"jump": "jump", "wave": "wave"}, count))
        assert len(takes) == 16 // count
        assert sum(len(one.words) for one in takes) == 16 * 12
        for one in takes:
            assert [part[1] for part in one.parts] == list(range(0, len(one.words), 12))


def test_actors_are_known_where_most_takes_are_of_theirs() -> None:
    assert Target([1, 1, 1], ["ann", "bob", None]).is_performed_by(["ann", "bob", None])
    assert not Target([1, 1], ["ann", None]).is_performed_by(["ann", "bob", None])


def test_of_many_examples_some_take_part() -> None:
    many = clips("jump", 1, [f"p{number:03}" for number in range(100)], 0)
    few = _thinned(many)
    assert len(few.names) == MAX_CLIPS
    assert (few.names[0], few.names[-1]) == (many.names[0], many.names[-1])
