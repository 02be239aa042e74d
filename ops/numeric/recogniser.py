"""This module recognises motions by numbers: it learns classes from examples, and labels takes.

Rows of states say where a motion may begin and end, and a discriminant says which class exactly this span is; the spans
with the greatest sum of scores are the labels. Examples that are left out in turn say how probable a label is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.ops.body.facing_direction import mirrored_positions
from kinedex.ops.errors import ParameterError
from kinedex.ops.numeric.channels import channels
from kinedex.ops.numeric.motion_classes import DescribedMotion, MotionClasses, described
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
    model: MotionClasses
    confidence: SegmentConfidence
    remarks: tuple[str, ...] = ()

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
            Takes of the archive, whose usual frames are the background; the examples serve where there are none.
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
            There is no example, or one has fewer than three frames or unknown positions.
        """
        if not examples:
            raise ParameterError("examples", "at least one", "none")
        for place, one in enumerate(examples):
            if len(one.positions) < LEAST_FRAMES:
                name = f"example {place} of '{one.label}'"
                raise ParameterError(name, f"of {LEAST_FRAMES} frames or more", f"{len(one.positions)}")
        classes = tuple(sorted({one.label for one in examples}))
        described = [_described(one, classes, joints, rate_hz, mirror or {}) for one in examples]
        archive = [channels(one, joints, rate_hz) for one in unlabelled]
        frames = np.concatenate([one.frames for one in archive or [one.found for one in described]])
        groups = [one.group or f"example {place}" for place, one in enumerate(examples)]
        model = MotionClasses.learn(described, frames, rate_hz)
        confidence = learn_segment_confidence(described, groups, frames, rate_hz)
        remarks = () if len(confidence.tail) else (ONE_GROUP if len(set(groups)) == 1 else FEW,)
        return cls(tuple(joints), rate_hz, classes, model, adapted(confidence, model, archive), remarks)

    def label(self, positions: F64, readiness: float | None = None) -> list[Recognised]:
        """Return the labelled spans of a take in their order; they do not overlap.

        Parameters
        ----------
        positions : float64 array (L, J, 3)
            The joints in metres, at the rate of the examples.
        readiness : float, optional
            The evidence that is added to each frame of a label; less leaves more frames without one. Unless given, it
            is what suits the unlabelled takes, and spans that are hardly probable are left out.
        """
        take = self.model.spans(channels(positions, self.joints, self.rate_hz))
        found = segments(self.model, take, self.confidence.readiness if readiness is None else readiness)
        sure, unlike = self.confidence.probabilities(found), self.confidence.unlikeness(found)
        least = self.confidence.least if readiness is None else 0.0
        return [
            Recognised(start, stop, self.classes[kind], probability, unlikeness)
            for start, stop, kind, probability, unlikeness in zip(
                found.starts.tolist(), found.stops.tolist(), found.classes.tolist(), sure.tolist(), unlike.tolist(),
                strict=True,
            )
            if probability >= least
        ]  # fmt: skip

    def classify(self, positions: F64) -> F64:
        """Return the logarithm of the probability of each class for a whole take, float64 (P,)."""
        found = channels(positions, self.joints, self.rate_hz)
        whole = SpanSums(found, self.rate_hz).describe(np.zeros(1, np.int64), np.array([len(found.yaw)], np.int64))
        return self.model.discriminant.log_posteriors(whole)[0]


def _described(
    example: TaughtMotion, classes: Sequence[str], joints: Sequence[str], rate_hz: float, mirror: Mapping[str, str]
) -> DescribedMotion:
    """Return an example as it is learned from."""
    found = channels(example.positions, joints, rate_hz)
    own = DescribedMotion(found, described(found, rate_hz), classes.index(example.label))
    other = mirror.get(example.label)
    if other not in classes:
        return own
    image = channels(mirrored_positions(example.positions, joints), joints, rate_hz)
    return own._replace(image=described(image, rate_hz), image_label=classes.index(other))
