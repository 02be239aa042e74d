"""This module learns how probable it is that a segment of a recogniser has the right class, and how unlike it is.

Examples are left out in turn, by takes or persons, laid end to end and labelled by what the others teach; the labels
are compared with the truth. The unlabelled takes of an archive say how much of it shows taught motion at all.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from kinedex.ops.annotation.confidence import Confidence, Prior, learn_confidence
from kinedex.ops.arrays import F64, I64, Bool
from kinedex.ops.numeric.channels import Channels
from kinedex.ops.numeric.motion_classes import Archive, DescribedMotion, MotionClasses, TakeSpans

CLASS_PRIOR = Prior(
    ("evidence", "within", "outside", "margin", "duration", "examples"),
    (0.206, 2.634, 0.904, 5.157, 1.661, 1.473),
    (2.246, 1.959, 1.427, 1.402, 2.442, 0.829),
    2.324,
    (0.426, 0.015, -0.548, 1.222, -0.132, 0.986),
)
"""The numbers of a segment that tell how probable its class is, if it shows any that was taught.

They are the evidence of states in a frame, the logarithms of both squared distances of `Discriminant.distances`, of the
lead over the second class in a frame and of the number of examples of a class, and the squared deviation of the
duration. What is expected of them was learned from HDM05's actors bd, bk and dg, each left out, and Bandai's dataset 1.
"""

KNOWN = (0, 1, 2, 4, 5)
"""The numbers of these that tell whether a segment shows any of the taught classes."""

KNOWN_CENTRES = np.array([0.251, 2.084, 0.549, 1.315, 1.863])
KNOWN_SCALES = np.array([2.149, 1.129, 0.879, 1.822, 0.521])
KNOWN_OFFSET, KNOWN_SLOPES = 3.35, np.array([1.099, -1.277, -0.305, -0.548, -0.567])
"""A logistic model of it, learned from the same takes, with CMU's between and with half of the classes untaught."""

KNOWN_SHARE = 0.826
"""The share of segments there that show a taught class."""

EXPECTED_SHARE, EXPECTED_SEGMENTS = 0.9, 20.0
"""The share that is expected of an archive, and the number of segments that this is worth."""

MOST_SHARE = 0.99

FEW_EXAMPLES = 1.5
"""With fewer examples of a class in the mean, nothing says what is not taught: all segments count as taught ones."""

READINESS = 8.0
"""The evidence that is added to each labelled frame of what is left out, and where there is nothing unlabelled."""

READY = (0.0, 1.0, 2.0, 3.0, 5.0, 8.0, 12.0)
"""The values of readiness from which one is chosen by the unlabelled takes of an archive."""

LEAST_PROBABLE = tuple((np.arange(10) / 10).tolist())
"""The least probabilities of segments from which one is chosen by the unlabelled takes of an archive."""

FOLDS = 5
"""The number of parts of the examples that are left out in turn."""

MAX_CHECKED = 10
"""The most examples of a class that are left out."""

MAX_FRAMES = 20_000
"""The number of unlabelled frames by which readiness is chosen."""

UNLIKENESS_SPREAD = 2.8
"""The deviation of unlikeness in right segments, where no example can be left out."""

STEPS = 200

LEAST_RIGHT = 10
"""The fewest right segments from which probabilities are learned."""

MOST_LEAD, MOST_EVIDENCE, MOST_AWAY = 1000.0, 10.0, 10.0
"""Limits of the numbers of a segment."""


class Segments(NamedTuple):
    """The segments of a take.

    Attributes
    ----------
    starts, stops : int64 array (S,)
        Their frames, stop excluded.
    classes : int64 array (S,)
        Their classes.
    evidence : float64 array (S, E)
        The numbers of `CLASS_PRIOR`.
    """

    starts: I64
    stops: I64
    classes: I64
    evidence: F64


def segments(model: MotionClasses, take: TakeSpans, readiness: float) -> Segments:
    """Return the segments of a take with the evidence for them.

    Parameters
    ----------
    model : MotionClasses
        The classes.
    take : TakeSpans
        The spans of the take.
    readiness : float
        The evidence that is added to each labelled frame.
    """
    chosen, classes, _ = take.chain(readiness)
    evidence = take.evidence(chosen)
    scores = evidence + take.worth[chosen]
    starts, stops = take.spans.starts[chosen], take.spans.stops[chosen]
    places, frames = np.arange(len(chosen)), stops - starts
    within, outside = model.discriminant.distances(take.descriptors[chosen], classes).T
    others = scores.copy()
    others[places, classes] = -np.inf
    lead = np.maximum(scores[places, classes] - others.max(axis=1, initial=-np.inf), 0.0) / frames
    away = (np.log(frames) - model.log_frames[classes]) ** 2 / model.spread
    inner = max(len(model.log_frames) - 1, 1)
    numbers = [
        np.clip(evidence[places, classes] / frames, -MOST_EVIDENCE, MOST_EVIDENCE),
        np.log(within / inner + 0.1),
        np.log(outside / max(take.descriptors.shape[1] - inner, 1) + 0.1),
        np.log1p(np.minimum(lead, MOST_LEAD)),
        np.minimum(away, MOST_AWAY),
        np.full(len(chosen), np.log(model.examples)),
    ]
    return Segments(starts, stops, classes, np.stack(numbers, axis=1))


@dataclass(frozen=True)
class SegmentConfidence:
    """The confidence of segments, from examples that were left out and the unlabelled takes of an archive.

    Attributes
    ----------
    confidence : Confidence
        The model that gives a segment the probability of its class, if it shows any that was taught.
    tail : float64 array (N,)
        How unlike the others right segments of examples left out are, ascending; empty if none could be left out.
    share : float
        The share of the archive's segments that show a taught class; 1 if the examples are too few to tell.
    readiness : float
        The evidence that is added to each frame of a label.
    least : float
        Segments of a smaller probability are no labels.
    """

    confidence: Confidence
    tail: F64
    share: float = KNOWN_SHARE
    readiness: float = READINESS
    least: float = 0.0

    def probabilities(self, found: Segments) -> F64:
        """Return the probability that the label of each segment is right, float64 (S,)."""
        return self.confidence.of(found.evidence, found.classes) * known_chances(found.evidence, self.share)

    def unlikeness(self, found: Segments) -> F64:
        """Return the share of right segments of examples left out that are more like the others, float64 (S,).

        Where no example could be left out, it is the share of segments of usual archives.
        """
        away = -_odds(found.evidence)
        if len(self.tail):
            return np.searchsorted(self.tail, away) / (len(self.tail) + 1.0)
        return _sigmoid(1.7 * (away + KNOWN_OFFSET) / UNLIKENESS_SPREAD)


class Checked(NamedTuple):
    """Segments whose truth is known.

    Attributes
    ----------
    evidence : float64 array (S, E)
        The numbers of `CLASS_PRIOR`.
    classes : int64 array (S,)
        Their classes.
    right, foreign : bool array (S,)
        True where most frames show the class, and where most show one that was not taught.
    """

    evidence: F64
    classes: I64
    right: Bool
    foreign: Bool


def learn_segment_confidence(
    examples: Sequence[DescribedMotion], groups: Sequence[str], archive: Archive
) -> SegmentConfidence:
    """Learn the confidence of segments by leaving examples out.

    Parameters
    ----------
    examples : sequence of DescribedMotion, length E
        The examples, one of each class at least.
    groups : sequence of str, length E
        The take, or the person, of each example; those of one group are left out together.
    archive : Archive
        The background, and the numbers to learn.
    """
    count = max(one.label for one in examples) + 1
    found = list(_checked(examples, groups, archive))
    evidence, classes, right = (
        np.concatenate([getattr(one, name)[~one.foreign] for one in found] or [empty]) for name, empty in _NONE.items()
    )
    twice = [
        len({group for one, group in zip(examples, groups, strict=True) if one.label == k}) > 1 for k in range(count)
    ]
    if right.sum() < LEAST_RIGHT or 2 * sum(twice) < count:
        evidence, classes, right = _NONE.values()
    learned = learn_confidence(CLASS_PRIOR, evidence, classes, right, count)
    return SegmentConfidence(learned, np.sort(-_odds(evidence[right])))


_NONE = {
    "evidence": np.empty((0, len(CLASS_PRIOR.evidence))),
    "classes": np.empty(0, np.int64),
    "right": np.empty(0, np.bool_),
}


def known_chances(evidence: F64, share: float) -> F64:
    """Return the probability that segments show any taught class, float64 (S,).

    Parameters
    ----------
    evidence : float64 array (S, E)
        The numbers of `CLASS_PRIOR`.
    share : float
        The share of segments that show one; 1 for all.
    """
    if share >= 1.0:
        return np.ones(len(evidence))
    return _sigmoid(_odds(evidence) + _logit(share) - _logit(KNOWN_SHARE))


def share_of_known(evidence: F64) -> float:
    """Return the share of an archive's segments that show a taught class.

    It is the share that agrees with the mean probability by it, and an expected one where segments are few (Saerens,
    Latinne and Decaestecker, Adjusting the outputs of a classifier to new a priori probabilities, 2002).

    Parameters
    ----------
    evidence : float64 array (S, E)
        The numbers of `CLASS_PRIOR`.
    """
    share = EXPECTED_SHARE
    for _ in range(STEPS):
        before = share
        known = known_chances(evidence, share).sum() + EXPECTED_SEGMENTS * EXPECTED_SHARE
        share = min(float(known) / (len(evidence) + EXPECTED_SEGMENTS), MOST_SHARE)
        if abs(share - before) < 1e-6:
            break
    return share


def adapted(learned: SegmentConfidence, model: MotionClasses, unlabelled: Sequence[Channels]) -> SegmentConfidence:
    """Return the confidence of segments in an archive, with the readiness by which its takes are labelled best.

    Parameters
    ----------
    learned : SegmentConfidence
        The confidence of segments, as examples alone teach it.
    model : MotionClasses
        The classes.
    unlabelled : sequence of Channels
        Takes of the archive; the first of them are enough, up to `MAX_FRAMES`.
    """
    before = np.cumsum([0, *(len(one.yaw) for one in unlabelled)]).tolist()
    some = [model.spans(one) for one, at in zip(unlabelled, before, strict=False) if at < MAX_FRAMES]
    if model.examples < FEW_EXAMPLES:
        learned = replace(learned, share=1.0)
    elif some:
        evidence = np.concatenate([segments(model, one, READINESS).evidence for one in some])
        learned = replace(learned, share=share_of_known(evidence))
    if not some:
        return learned
    readiness, least = chosen_readiness(learned, model, some)
    return replace(learned, readiness=readiness, least=least)


def chosen_readiness(
    learned: SegmentConfidence, model: MotionClasses, takes: Sequence[TakeSpans]
) -> tuple[float, float]:
    """Return the readiness and the least probability by which unlabelled takes would be labelled best.

    For want of true labels, the probabilities of segments say how many frames are right; the greatest number that any
    readiness finds counts as all there are. The chosen values have the greatest F-measure by frames.

    Parameters
    ----------
    learned : SegmentConfidence
        The confidence of segments.
    model : MotionClasses
        The classes.
    takes : sequence of TakeSpans
        The spans of the takes.
    """
    kept = np.zeros((len(READY), len(LEAST_PROBABLE), 2))
    for row, readiness in enumerate(READY):
        for take in takes:
            found = segments(model, take, readiness)
            sure, frames = learned.probabilities(found), found.stops - found.starts
            for column, least in enumerate(LEAST_PROBABLE):
                own = sure >= least
                kept[row, column] += (frames[own] @ sure[own], frames[own].sum())
    right, labelled = np.moveaxis(kept, -1, 0)
    score = right / (labelled + right.max() + 1.0)
    best = divmod(int(score.argmax()), len(LEAST_PROBABLE))
    return READY[best[0]], LEAST_PROBABLE[best[1]]


def _checked(examples: Sequence[DescribedMotion], groups: Sequence[str], archive: Archive) -> Iterator[Checked]:
    """Yield the segments of what is left out, groups in turn."""
    names = sorted(set(groups))
    if len(names) < 2:
        return
    drawn = np.random.default_rng(0).permutation(len(names)).tolist()
    part = {names[place]: turn % FOLDS for turn, place in enumerate(drawn)}
    count = max(one.label for one in examples) + 1
    for fold in range(min(FOLDS, len(names))):
        kept = [one for one, group in zip(examples, groups, strict=True) if part[group] != fold]
        out = _few([one for one, group in zip(examples, groups, strict=True) if part[group] == fold], count)
        known = {one.label for one in kept}
        if known and out:
            yield _labelled(kept, out, archive)


def _few(examples: Sequence[DescribedMotion], count: int) -> list[DescribedMotion]:
    """Return some examples of each class, in a drawn order."""
    seen = np.zeros(count, np.int64)
    found = []
    for place in np.random.default_rng(0).permutation(len(examples)).tolist():
        seen[examples[place].label] += 1
        if seen[examples[place].label] <= -(-MAX_CHECKED // FOLDS):
            found.append(examples[place])
    return found


def _labelled(kept: Sequence[DescribedMotion], out: Sequence[DescribedMotion], archive: Archive) -> Checked:
    """Return the segments that some examples find in others, which are laid end to end."""
    taught = sorted({one.label for one in kept})
    place = {label: index for index, label in enumerate(taught)}
    own = [
        one._replace(label=place[one.label], image_label=place[one.image_label])
        if one.image_label in place
        else one._replace(label=place[one.label], image=None)
        for one in kept
    ]
    model = MotionClasses.learn(own, archive)
    parts = [one.found for one in out]
    frames, yaw = (np.concatenate([getattr(one, name) for one in parts]) for name in ("frames", "yaw"))
    laid = Channels(frames, yaw, parts[0].known)
    found = segments(model, model.spans(laid), READINESS)
    true = np.repeat([one.label for one in out], [len(one.found.yaw) for one in out])
    classes = np.array(taught, np.int64)[found.classes]
    right, foreign = (
        [
            2 * np.count_nonzero(agree(true[start:stop], label)) > stop - start
            for start, stop, label in zip(found.starts.tolist(), found.stops.tolist(), classes.tolist(), strict=True)
        ]
        for agree in (np.equal, lambda own, _: ~np.isin(own, taught))
    )
    return Checked(found.evidence, classes, np.array(right, np.bool_), np.array(foreign, np.bool_))


def _odds(evidence: F64) -> F64:
    """Return the log odds that segments show a taught class, as in the takes of `KNOWN_SHARE`, float64 (S,)."""
    normal = (evidence[:, list(KNOWN)] - KNOWN_CENTRES) / KNOWN_SCALES
    return KNOWN_OFFSET + normal @ KNOWN_SLOPES


def _logit(share: float) -> float:
    return float(np.log(share / (1.0 - share)))


def _sigmoid(odds: F64) -> F64:
    found: F64 = 0.5 * (1.0 + np.tanh(odds / 2.0))
    return found
