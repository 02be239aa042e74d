"""This module recognises motions by numbers: it learns classes from examples, and labels takes.

Rows of states say where a motion may begin and end, and a discriminant says which class exactly this span is; the spans
with the greatest sum of scores are the labels. Examples that are left out in turn say how probable a label is.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from kinedex.ops.arrays import F64, Bool
from kinedex.ops.body.facing_direction import mirrored_positions
from kinedex.ops.errors import ParameterError
from kinedex.ops.numeric.channels import Channels, channels
from kinedex.ops.numeric.motion_classes import Archive, DescribedMotion, MotionClasses, described
from kinedex.ops.numeric.partial_bodies import channel_columns, completed, descriptor_columns, known_stretches
from kinedex.ops.numeric.segment_confidence import SegmentConfidence, adapted, learn_segment_confidence, segments
from kinedex.ops.numeric.span_descriptors import SpanSums

LEAST_FRAMES = 3
"""The fewest frames of an example."""

ONE_GROUP = (
    "all examples are of one take or person, so that none can be left out: probabilities are those of usual archives, "
    "and are not calibrated"
)
"""The remark on examples of a single group."""

FEW = (
    "most classes have a single example, or examples of a single take or person, so that none can be left out: "
    "probabilities are those of usual archives, and are not calibrated"
)
"""The remark on examples that cannot be left out."""


class TaughtMotion(NamedTuple):
    """A motion that teaches a class.

    Attributes
    ----------
    positions : float64 array (L, J, 3)
        The joints in metres, Y up, at the common rate.
    label : str
        The name of the class.
    group : str
        The take, or the person, that it is of: examples of one group are left out together when confidence is learned.
        Examples without one are groups of their own.
    """

    positions: F64
    label: str
    group: str = ""


class Recognised(NamedTuple):
    """A span of a take with its class.

    Attributes
    ----------
    start, stop : int
        Its frames, stop excluded.
    label : str
        The name of the class.
    probability : float
        The probability that the label is right: that the span shows a taught class, and that it is this one.
    unlikeness : float
        The share of right segments of examples which is less unlike the other examples of their classes than this span
        is, from 0 to 1: near 1, the span shows what was never taught, or it is cut wrong.
    """

    start: int
    stop: int
    label: str
    probability: float
    unlikeness: float


@dataclass(frozen=True)
class Recogniser:
    """Classes that were learned from examples, by `fit`.

    Attributes
    ----------
    joints : tuple of str
        The names of the joints.
    rate_hz : float
        Frames per second of examples and takes.
    classes : tuple of str
        The names of the classes.
    known : bool array (J,)
        The joints that were learned.
    model : MotionClasses
        What tells where the classes lie, and which is which.
    confidence : SegmentConfidence
        What tells how probable segments are.
    remarks : tuple of str
        What a user should know of the examples.
    """

    joints: tuple[str, ...]
    rate_hz: float
    classes: tuple[str, ...]
    known: Bool
    model: MotionClasses
    confidence: SegmentConfidence
    remarks: tuple[str, ...] = ()
    _restricted: dict[bytes, MotionClasses] = field(default_factory=dict, compare=False, repr=False)

    @classmethod
    def fit(
        cls,
        examples: Sequence[TaughtMotion],
        unlabelled: Sequence[F64],
        joints: Sequence[str],
        rate_hz: float,
        mirror: Mapping[str, str] | None = None,
    ) -> Recogniser:
        """Learn classes from examples.

        Parameters
        ----------
        examples : sequence of TaughtMotion
            At least one of each class, each of three frames at least.
        unlabelled : sequence of float64 arrays (L, J, 3)
            Takes of the archive, whose usual frames are the background; the examples serve where there are none. Takes
            that lack a joint which is learned are no part of it.
        joints : sequence of str, length J
            The names of the joints, the root first.
        rate_hz : float
            Frames per second.
        mirror : mapping of str to str, optional
            Class → the class of its mirror images, itself for motions without a side. The mirror image of an example is
            a further example where both classes are taught.

        Raises
        ------
        ParameterError
            There is no example, or one has fewer than three frames, or too few joints for a heading and a size.
        """
        if not examples:
            raise ParameterError("examples", "at least one", "none")
        for place, one in enumerate(examples):
            if len(one.positions) < LEAST_FRAMES:
                name = f"example {place} of '{one.label}'"
                raise ParameterError(name, f"of {LEAST_FRAMES} frames or more", f"{len(one.positions)}")
        classes = tuple(sorted({one.label for one in examples}))
        described, known = _described(examples, classes, joints, rate_hz, mirror or {})
        takes = list(_whole_bodies(unlabelled, joints, rate_hz, known))
        columns = channel_columns(known, joints)
        frames = [one.frames[:, columns] for one in takes or [one.found for one in described]]
        archive = Archive(np.concatenate(frames), columns, descriptor_columns(known), rate_hz)
        groups = [one.group or f"example {place}" for place, one in enumerate(examples)]
        model = MotionClasses.learn(described, archive)
        confidence = learn_segment_confidence(described, groups, archive)
        remarks = () if len(confidence.tail) else (ONE_GROUP if len(set(groups)) == 1 else FEW,)
        return cls(tuple(joints), rate_hz, classes, known, model, adapted(confidence, model, takes), remarks)

    def label(self, positions: F64, readiness: float | None = None) -> list[Recognised]:
        """Return the labelled spans of a take in their order; they do not overlap.

        No label reaches over a gap of the root that is longer than `HELD_S`. Joints that are known in fewer than half
        of the frames between such gaps do not count.

        Parameters
        ----------
        positions : float64 array (L, J, 3)
            The joints in metres, at the rate of the examples; NaN where they are not known.
        readiness : float, optional
            The evidence that is added to each frame of a label; less leaves more frames without one. Unless given, it
            is what suits the unlabelled takes, and spans that are hardly probable are left out.
        """
        return [
            one._replace(start=start + one.start, stop=start + one.stop)
            for start, stop in known_stretches(positions, self.rate_hz)
            for one in self._labelled(positions[start:stop], readiness)
        ]

    def _labelled(self, positions: F64, readiness: float | None) -> list[Recognised]:
        """Return the labelled spans of a take without long gaps."""
        found = channels(positions, self.joints, self.rate_hz)
        model = self._of_joints(found.known)
        spans = segments(model, model.spans(found), self.confidence.readiness if readiness is None else readiness)
        sure, unlike = self.confidence.probabilities(spans), self.confidence.unlikeness(spans)
        least = self.confidence.least if readiness is None else 0.0
        return [
            Recognised(start, stop, self.classes[kind], probability, unlikeness)
            for start, stop, kind, probability, unlikeness in zip(
                spans.starts.tolist(), spans.stops.tolist(), spans.classes.tolist(), sure.tolist(), unlike.tolist(),
                strict=True,
            )
            if probability >= least
        ]  # fmt: skip

    def _of_joints(self, known: Bool) -> MotionClasses:
        """Return what was learned, by those joints alone that are known (J,)."""
        if known[self.known].all():
            return self.model
        both = self.known & known
        if (found := self._restricted.get(both.tobytes())) is None:
            found = self.model.restricted(channel_columns(both, self.joints), descriptor_columns(both))
            self._restricted[both.tobytes()] = found
        return found

    def classify(self, positions: F64) -> F64:
        """Return the logarithm of the probability of each class for a whole take, float64 (P,)."""
        found = channels(positions, self.joints, self.rate_hz)
        model = self._of_joints(found.known)
        whole = SpanSums(found, self.rate_hz).describe(np.zeros(1, np.int64), np.array([len(found.yaw)], np.int64))
        return model.discriminant.log_posteriors(whole[:, model.numbers])[0]


def _described(
    examples: Sequence[TaughtMotion],
    classes: Sequence[str],
    joints: Sequence[str],
    rate_hz: float,
    mirror: Mapping[str, str],
) -> tuple[list[DescribedMotion], Bool]:
    """Return examples as they are learned from, and the joints that can be learned, bool (J,)."""
    given, labels = [one.positions for one in examples], [classes.index(one.label) for one in examples]
    images: dict[int, int] = {}
    for place, one in enumerate(examples):
        other = mirror.get(one.label)
        if other in classes:
            images[place] = len(given)
            given.append(mirrored_positions(one.positions, joints))
            labels.append(classes.index(other))
    found, known = completed([channels(one, joints, rate_hz) for one in given], np.array(labels), joints)
    described_motions = []
    for place in range(len(examples)):
        own = DescribedMotion(found[place], described(found[place], rate_hz), labels[place])
        if (image := images.get(place)) is not None:
            own = own._replace(image=described(found[image], rate_hz), image_label=labels[image])
        described_motions.append(own)
    return described_motions, known


def _whole_bodies(takes: Sequence[F64], joints: Sequence[str], rate_hz: float, known: Bool) -> Iterator[Channels]:
    """Yield the channels of those takes, or parts of them, that have all known joints."""
    for take in takes:
        for start, stop in known_stretches(take, rate_hz):
            try:
                found = channels(take[start:stop], joints, rate_hz)
            except ParameterError:  # no heading or size: it cannot be labelled, either
                continue
            if found.known[known].all():
                yield found
