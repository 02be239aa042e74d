"""The methods that the study of recognition compares: each learns the examples of a trial, and labels its takes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from kinedex.catalog.classes import OWN, load_classes
from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.numeric.candidate_cuts import CUTTING_READINESS, Candidates
from kinedex.ops.numeric.channels import channels
from kinedex.ops.numeric.recogniser import Recogniser, TaughtMotion
from kinedex.ops.numeric.segment_confidence import READINESS
from kinedex.ops.words import TakeWords
from kinedex.pipelines.annotation.annotators import Annotator, make_annotator
from kinedex.pipelines.annotation.batches import annotate_words
from kinedex.pipelines.annotation.methods import AnnotationMethod, LabelledMotion, Material, Motions
from kinedex.pipelines.annotation.methods import Motion as Unlabelled
from kinedex.pipelines.annotation.single_examples import SingleExamples
from kinedex.pipelines.annotation.template_methods import BestMethod, ThesisMethod
from kinedex.pipelines.engine.executors import make_executor
from kinedex.pipelines.templates.template_learning import TrainingClips, learn_templates
from kinedex.storage.store.store import Store
from studies.recognition_protocols import Motion, Trial

DELTA, TAU = 0.05, 0.13


class Found(NamedTuple):
    """A segment that a method found: its frames, its class, and how sure the method is of it."""

    start: int
    stop: int
    label: str
    sureness: float


Method = Callable[[Store, Trial], list[list[Found]]]
"""Labels the takes of a trial; the store has the features of words and the rate."""


def by_thesis(store: Store, trial: Trial) -> list[list[Found]]:
    """Label by the thesis's method, with a template for each class."""
    return _labelled(_annotator(store, trial.examples, ThesisMethod), trial.takes)


def by_best(store: Store, trial: Trial) -> list[list[Found]]:
    """Label by method best, with a template for each class."""
    return _labelled(_annotator(store, trial.examples, BestMethod), trial.takes)


def by_each_example(store: Store, trial: Trial) -> list[list[Found]]:
    """Label by method best, with a template for each example."""
    return _labelled(_annotator(store, trial.examples, SingleExamples, trial.takes), trial.takes)


def by_numbers(store: Store, trial: Trial) -> list[list[Found]]:
    """Label by numbers beside bits."""
    taught = learned(store, trial)
    return [
        [Found(one.start, one.stop, one.label, one.probability) for one in taught.label(take.positions)]
        for take in trial.takes
    ]


def by_discriminant(store: Store, trial: Trial) -> list[list[Found]]:
    """Label by the discriminant of pooled numbers alone; candidate cuts are those of the states."""
    taught = learned(store, trial)
    if not trial.whole:
        return [_by_part(taught, take, states=False) for take in trial.takes]
    found = []
    for take in trial.takes:
        chances = taught.classify(take.positions)
        best = int(chances.argmax())
        found.append([Found(0, len(take.words), taught.classes[best], float(np.exp(chances[best])))])
    return found


def by_states(store: Store, trial: Trial) -> list[list[Found]]:
    """Label by rows of states alone."""
    taught = learned(store, trial)
    return [_by_part(taught, take, states=True) for take in trial.takes]


METHODS: Mapping[str, Method] = {
    "thesis": by_thesis,
    "best": by_best,
    "each_example": by_each_example,
    "numeric": by_numbers,
    "discriminant": by_discriminant,
    "states": by_states,
}


def learned(store: Store, trial: Trial) -> Recogniser:
    """Return the recogniser that has learned the examples of a trial."""
    mirror = {one.label: mirrored(one.label) for one in trial.examples} if trial.sides else None
    given = [TaughtMotion(one.positions, one.label, one.group) for one in trial.examples]
    return Recogniser.fit(given, [one.positions for one in trial.takes], JOINTS, store.rate_hz, mirror)


def mirrored(label: str) -> str:
    """Return the content of mirror images: with left for right, and itself without a side."""
    return label.replace("left", "\0").replace("right", "left").replace("\0", "right")


def most_of(labels: Sequence[Found]) -> str:
    """Return the class that labels most frames; of several, the one of the surest label."""
    frames: Counter[str] = Counter()
    sureness: dict[str, float] = {}
    for one in labels:
        frames[one.label] += one.stop - one.start
        sureness[one.label] = max(one.sureness, sureness.get(one.label, -np.inf))
    return max(frames, key=lambda label: (frames[label], sureness[label]), default="")


def _by_part(taught: Recogniser, take: Motion, *, states: bool) -> list[Found]:
    """Label a take as the recogniser does, but by its states or its discriminant alone."""
    own = taught.model.spans(channels(take.positions, taught.joints, taught.rate_hz))
    if states:
        own = own._replace(posteriors=0 * own.posteriors)
    else:
        rows = replace(taught.model.rows, states=0 * taught.model.rows.states, usual=0 * taught.model.rows.usual)
        cuts = own.candidates.cuts
        alike = Candidates(cuts, CUTTING_READINESS * cuts, np.zeros_like(own.projected[:, 0]))
        own = own._replace(columns=rows.columns, candidates=alike)
    frames = own.spans.stops - own.spans.starts
    return [
        Found(
            int(own.spans.starts[span]), int(own.spans.stops[span]), taught.classes[kind], score / float(frames[span])
        )
        for span, kind, score in zip(*(one.tolist() for one in own.chain(READINESS)), strict=True)
    ]


def _annotator(
    store: Store, examples: Sequence[Motion], method: type[AnnotationMethod], takes: Sequence[Motion] = ()
) -> Annotator:
    """Return the annotator of a method by templates, learned from examples and unlabelled takes."""
    executor = make_executor("serial", None)
    clips = _clips(examples)
    templates = [
        one for task in learn_templates(clips, ["soft"], len(store.feature_set.features), executor) for one in task
    ]
    return make_annotator(
        store.feature_set, templates, load_classes(OWN, {one.subclass for one in clips}), DELTA, TAU,
        method=method, clips=Material(
            Motions(lambda: [LabelledMotion(words=one.words, label=one.label) for one in examples]),
            Motions(lambda: [Unlabelled(words=one.words) for one in takes]),
        ),
    )  # fmt: skip


def _clips(examples: Sequence[Motion]) -> list[TrainingClips]:
    """Return the words of examples by class."""
    labels = sorted({one.label for one in examples})
    own = {label: [one for one in examples if one.label == label] for label in labels}
    return [
        TrainingClips(label, tuple(one.name for one in some), tuple(one.words for one in some))
        for label, some in own.items()
    ]


def _words(takes: Sequence[Motion]) -> TakeWords:
    """Return the words of takes, one after the other."""
    offsets = np.cumsum([0, *(len(one.words) for one in takes)])
    return TakeWords(np.arange(len(takes)), offsets, np.concatenate([one.words for one in takes]))


def _labelled(annotator: Annotator, takes: Sequence[Motion]) -> list[list[Found]]:
    """Label takes by an annotator."""
    return [
        [Found(one.start, one.stop, annotator.classes[one.class_index], -one.cost) for one in own.segments]
        for own in annotate_words(annotator, _words(takes))
    ]
