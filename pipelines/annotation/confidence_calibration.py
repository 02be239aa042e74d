"""Calibrate the confidence of annotations by cross-validation on the training examples.

Labels of the takes to annotate are not used. In each fold, the examples of some actors are held out; if the actors of
the examples also perform most takes to annotate, the examples of some takes are held out instead. The held-out examples
are concatenated to takes about as long as the takes to annotate, and annotated with templates of the other examples.
The label of a segment is right if most frames of the segment belong to examples of the labelled class.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby, pairwise

import numpy as np

from kinedex.catalog.classes import Classes
from kinedex.ops.annotation.confidence import PRIORS, UNKNOWN, Confidence, learn_confidence
from kinedex.ops.annotation.evidence import evidence_of
from kinedex.ops.arrays import F64, I64, U64, Bool
from kinedex.ops.wording import counted
from kinedex.ops.words import ALL_KNOWN, TakeWords
from kinedex.pipelines.annotation.annotators import Annotator
from kinedex.pipelines.annotation.batches import annotate_words
from kinedex.pipelines.engine.executors import Executor
from kinedex.pipelines.templates.examples import Rejected
from kinedex.pipelines.templates.template_learning import TrainingClips

FOLDS = 5
"""The largest number of folds."""

MAX_CLIPS = 24
"""The largest number of examples of each subclass that are used, spread evenly over their names."""

MAX_CLIPS_PER_TAKE = 16
"""The largest number of examples that are concatenated to one take."""

MIN_SEGMENTS = 20
"""The smallest number of segments from which a confidence is learned, for a method without a prior."""

MakeAnnotator = Callable[[Sequence[TrainingClips], Sequence[Rejected]], Annotator]
"""A function that makes an annotator with templates that it learns from clips, and with rejected intervals."""


@dataclass(frozen=True)
class Target:
    """The lengths and actors of the takes to annotate, which the calibration imitates.

    Attributes
    ----------
    frames : sequence of int
        The length of each take, in frames.
    actors : sequence of str or None
        The actor of each take.
    """

    frames: Sequence[int]
    actors: Sequence[str | None]

    def is_performed_by(self, actors: Iterable[str | None]) -> bool:
        """Return whether the given actors perform more than half of the takes to annotate."""
        known = set(actors) - {None}
        return 2 * sum(one in known for one in self.actors) > len(self.actors)

    def clips_per_take(self, lengths: Sequence[int]) -> int:
        """Return how many clips make a take of typical length, rounded to a power of two so that it seldom changes."""
        ratio = float(np.median(self.frames)) / max(float(np.median(lengths)), 1.0)
        return int(2 ** np.clip(np.round(np.log2(max(ratio, 1.0))), 0, np.log2(MAX_CLIPS_PER_TAKE)))


@dataclass(frozen=True)
class KnownTake:
    """A take of concatenated examples, whose classes are known.

    Attributes
    ----------
    words : uint64 array (L,)
        The words.
    known : int
        The mask of the features that are known in all examples.
    parts : tuple of (str, int, int)
        Class and frames [start, stop) of each example.
    """

    words: U64
    known: int
    parts: tuple[tuple[str, int, int], ...]


@dataclass(frozen=True)
class CalibrationFold:
    """One fold: takes of held-out examples, an annotator with templates of the others, and the classes of examples."""

    annotator: Annotator
    evidence: tuple[str, ...]
    takes: tuple[KnownTake, ...]
    labels: frozenset[str]


@dataclass(frozen=True)
class JudgedSegments:
    """Segments whose labels are known to be right or wrong.

    Attributes
    ----------
    evidence : float64 array (S, E)
        The evidence for the label of each segment.
    classes : int64 array (S,)
        The class index of each segment.
    right : bool array (S,)
        True where the label is right.
    """

    evidence: F64
    classes: I64
    right: Bool


@dataclass(frozen=True)
class CalibratedConfidence:
    """A confidence learned from segments, with the number of segments, the number of right ones, and a remark."""

    confidence: Confidence | None
    segments: int
    right: int
    remark: str


def calibrate_confidence(
    clips: Sequence[TrainingClips],
    actors: Mapping[str, str | None],
    classes: Classes,
    method: str,
    target: Target,
    make: MakeAnnotator,
    executor: Executor,
    rejected: Sequence[Rejected] = (),
) -> CalibratedConfidence:
    """Learn the confidence of labels from held-out examples.

    Parameters
    ----------
    clips : sequence of TrainingClips
        The examples by subclass. Of more than `MAX_CLIPS` examples, those from the takes of so many evenly spread ones
        are used.
    actors : mapping of str to str
        The actor of each take by its name. With fewer than two actors, folds hold out takes instead of actors.
    classes : Classes
        The classes to label with.
    method : str
        The name of the method.
    target : Target
        The takes to annotate.
    make : callable
        Makes an annotator from clips.
    executor : Executor
        The workers.
    rejected : sequence of Rejected, optional
        Intervals that people have rejected, held out like examples; every label of such an interval is wrong.
    """
    some, every = [_thinned(one) for one in clips], classes.of_subclass()
    of_subclass = {one.subclass: every[one.subclass] for one in some if one.subclass in every}
    prior = PRIORS.get(method, UNKNOWN)
    names = {one for each in some for one in each.of_takes} | {one.take for one in rejected}
    people = {name: actors.get(name) for name in names}
    several = len(set(people.values())) > 1 and not target.is_performed_by(people.values())
    groups = _parts({name: (people[name] or "") if several else name for name in names})
    count = target.clips_per_take([len(words) for one in some for words in one.words] or [1])
    folds = []
    for number in sorted(set(groups.values())):
        names = {take for take, part in groups.items() if part == number}
        rest = [part for one in some if (part := one.without(names)).names]
        shown = {of_subclass[one.subclass] for one in rest if one.subclass in of_subclass}
        theirs = [part for one in some if of_subclass.get(one.subclass) in shown and (part := one.only(names)).names]
        if theirs:
            annotator = make(rest, [one for one in rejected if one.take not in names])
            refused = [(one.known, "", one.words) for one in rejected if one.take in names]
            takes = tuple(_concatenated(theirs, of_subclass, count, refused))
            folds.append(CalibrationFold(annotator, prior.evidence, takes, frozenset(of_subclass.values())))
    return _learned(method, list(executor.map(annotate_fold, folds)), len(classes.names))


_UNKNOWN = "no confidence: too few examples to leave some out, and the method has no confidence of its own"


def uncalibrated(method: str, class_count: int) -> Confidence | None:
    """Return the confidence that a method has without examples; None if the method has no prior."""
    return _learned(method, (), class_count).confidence


def _learned(method: str, found: Sequence[JudgedSegments], class_count: int) -> CalibratedConfidence:
    prior = PRIORS.get(method, UNKNOWN)
    right = np.concatenate([np.empty(0, np.bool_), *(one.right for one in found)])
    if prior is UNKNOWN and len(right) < MIN_SEGMENTS:
        return CalibratedConfidence(None, len(right), int(right.sum()), _UNKNOWN)
    evidence = np.concatenate([np.empty((0, len(prior.evidence))), *(one.evidence for one in found)])
    classes = np.concatenate([np.empty(0, np.int64), *(one.classes for one in found)])
    confidence = learn_confidence(prior, evidence, classes, right, class_count)
    remark = (
        f"confidence is calibrated on {counted(len(right), 'segment')} of examples that were left out in "
        f"{counted(len(found), 'part')}, {int(right.sum())} of them right"
        if len(right)
        else "confidence is not calibrated on this archive: there are too few examples to leave some out"
    )
    return CalibratedConfidence(confidence, len(right), int(right.sum()), remark)


def annotate_fold(fold: CalibrationFold) -> JudgedSegments:
    """Annotate the takes of one fold, and mark which segments are right, in a worker.

    Segments of classes without examples, such as combinations, are ignored, because they cannot be right.
    """
    takes, offsets = fold.takes, np.cumsum([0, *(len(one.words) for one in fold.takes)]).astype(np.int64)
    masks = np.array([one.known for one in takes], np.uint64)
    known = None if (masks == ALL_KNOWN).all() else masks
    laid = TakeWords(np.arange(len(takes)), offsets, np.concatenate([one.words for one in takes]), known)
    annotator = replace(fold.annotator, confidence=None)
    labels = [name in fold.labels for name in annotator.classes]
    found = [
        [segment for segment in one.segments if labels[segment.class_index]] for one in annotate_words(annotator, laid)
    ]
    evidence = evidence_of(fold.evidence, found, offsets, *annotator.shapes)
    classes, right = [], []
    for take, segments in zip(takes, found, strict=True):
        for one in segments:
            label = annotator.classes[one.class_index]
            own = sum(
                max(0, min(one.stop, stop) - max(one.start, start)) for name, start, stop in take.parts if name == label
            )
            classes.append(one.class_index)
            right.append(2 * own > one.stop - one.start)
    return JudgedSegments(evidence, np.array(classes, np.int64), np.array(right, np.bool_))


def _thinned(clips: TrainingClips) -> TrainingClips:
    """Return the clips from the takes of `MAX_CLIPS` clips that are spread evenly over the names; all, if fewer."""
    if len(clips.names) <= MAX_CLIPS:
        return clips
    places = np.linspace(0, len(clips.names) - 1, MAX_CLIPS).round().astype(int).tolist()
    takes = {clips.of_takes[place] for place in places}
    return clips.only(takes) if len(takes) < len(set(clips.of_takes)) else clips


def _parts(group_of: Mapping[str, str]) -> dict[str, int]:
    """Assign takes to at most `FOLDS` parts of similar size, keeping takes of one group together."""
    groups: dict[str, list[str]] = {}
    for name, group in sorted(group_of.items()):
        groups.setdefault(group, []).append(name)
    sizes, found = np.zeros(min(FOLDS, len(groups)), np.int64), dict[str, int]()
    for own in sorted(groups.values(), key=lambda one: (-len(one), one)):
        part = int(np.argmin(sizes))
        sizes[part] += len(own)
        found |= dict.fromkeys(own, part)
    return found


def _concatenated(
    clips: Sequence[TrainingClips],
    of_subclass: Mapping[str, str],
    count: int,
    refused: Sequence[tuple[int, str, U64]] = (),
) -> Iterator[KnownTake]:
    """Concatenate clips with the same known features in random order, `count` clips per take."""
    every = [*((one.known, of_subclass[one.subclass], words) for one in clips for words in one.words), *refused]
    drawn = [every[place] for place in np.random.default_rng(0).permutation(len(every)).tolist()]
    for mask, group in groupby(sorted(drawn, key=lambda one: one[0]), key=lambda one: one[0]):
        alike = list(group)
        for first in range(0, len(alike), count):
            yield _joined(mask, alike[first : first + count])


def _joined(mask: int, clips: Sequence[tuple[int, str, U64]]) -> KnownTake:
    edges = pairwise(np.cumsum([0, *(len(words) for _, _, words in clips)]).tolist())
    parts = tuple((label, *edge) for (_, label, _), edge in zip(clips, edges, strict=True))
    return KnownTake(np.concatenate([words for _, _, words in clips]), mask, parts)
