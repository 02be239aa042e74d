"""This module models the classes of motions that examples teach: where they may lie in a take, and which span is which.

Rows of states say where a motion may begin and end, and a discriminant says which class exactly this span is; the spans
with the greatest sum of scores are the segments.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from kinedex.ops.arrays import F32, F64, I64, Bool
from kinedex.ops.numeric.candidate_cuts import Candidates, candidate_cuts
from kinedex.ops.numeric.channels import Channels
from kinedex.ops.numeric.discriminant import Discriminant
from kinedex.ops.numeric.partial_bodies import chosen_columns, restricted_discriminant
from kinedex.ops.numeric.span_chain import Chain, Spans, best_chain, span_evidence, spans_between
from kinedex.ops.numeric.span_descriptors import SpanSums
from kinedex.ops.numeric.state_columns import StateColumns
from kinedex.ops.numeric.state_rows import StateRows

PER_FRAME = 1.0
"""The weight of a frame's share in the log-probability of its span's class."""

DURATION_WEIGHT = 10.0
"""The weight of the squared deviation of a span's log duration from that of its class."""

CUTS = ((0.0, 1.0), (0.2, 1.0), (0.0, 0.8))
"""The parts of an example by which its class is taught: spans in a take are rarely cut as examples are."""

LEAST_SPREAD = 0.02
"""The variance of log durations that is added to that of the examples."""


class DescribedMotion(NamedTuple):
    """An example of a class, prepared for learning.

    Attributes
    ----------
    found : Channels
        Its channels.
    described : float64 array (C, D)
        The descriptors of the example and of its `CUTS`.
    label : int
        Its class.
    image : float64 array (C, D), optional
        The descriptors of its mirror image; None where no class has them.
    image_label : int
        The class of the mirror image.
    """

    found: Channels
    described: F64
    label: int
    image: F64 | None = None
    image_label: int = -1


class Archive(NamedTuple):
    """The background of an archive, and which numbers are known in it.

    Attributes
    ----------
    frames : float32 array (A, n)
        The learned channels of frames of all kinds.
    columns : bool array (C,)
        The n channels that are learned.
    numbers : bool array (D,)
        The numbers of descriptors that are learned.
    rate_hz : float
        Frames per second.
    """

    frames: F32
    columns: Bool
    numbers: Bool
    rate_hz: float


class TakeSpans(NamedTuple):
    """The spans of a take between candidate cuts, with what their scores are computed from.

    Attributes
    ----------
    projected : float32 array (L, d + 1)
        The projected frames of the take, with a 1 appended to each.
    columns : StateColumns
        The states of the classes.
    candidates : Candidates
        The candidate cuts.
    spans : Spans
        The spans between them.
    posteriors : float64 array (M, P)
        The logarithm of the probability of each class by the discriminant, times the frames of the span.
    lengths : float64 array (M, P)
        The score of the duration of each span in each class.
    descriptors : float64 array (M, D)
        The descriptors of the spans.
    """

    projected: F32
    columns: StateColumns
    candidates: Candidates
    spans: Spans
    posteriors: F64
    lengths: F64
    descriptors: F64

    @property
    def worth(self) -> F64:
        """Return what is added to the evidence of states in the score of each span and class, float64 (M, P)."""
        return self.posteriors + self.lengths

    def chain(self, readiness: float) -> Chain:
        """Return the best chain of spans, where each labelled frame adds a readiness to the score."""
        return best_chain(self.projected, self.columns, self.candidates, self.spans, self.worth, readiness)

    def evidence(self, chosen: I64) -> F64:
        """Return the evidence of the states of every class in spans of a chain, float64 (n, P); −∞ where none fits."""
        starts, stops = self.spans.starts[chosen], self.spans.stops[chosen]
        fits = self.spans.fits[chosen]
        return span_evidence(self.projected, self.columns, self.candidates.background, starts, stops, fits)


@dataclass(frozen=True)
class MotionClasses:
    """Models of P classes.

    Attributes
    ----------
    rate_hz : float
        Frames per second.
    rows : StateRows
        Their states.
    discriminant : Discriminant
        The discriminant that tells spans of the classes apart.
    log_frames : float64 array (P,)
        The mean of the logarithm of the examples' lengths.
    spread : float
        The variance of it within classes.
    examples : float
        The mean number of examples of a class.
    columns : bool array (C,)
        The channels of frames that were learned.
    numbers : bool array (D,)
        The numbers of descriptors that were learned.
    """

    rate_hz: float
    rows: StateRows
    discriminant: Discriminant
    log_frames: F64
    spread: float
    examples: float
    columns: Bool
    numbers: Bool

    @classmethod
    def learn(cls, examples: Sequence[DescribedMotion], archive: Archive) -> MotionClasses:
        """Learn classes from examples.

        Parameters
        ----------
        examples : sequence of DescribedMotion
            The examples, one of each class at least.
        archive : Archive
            The background, and the numbers to learn.
        """
        own = np.array([one.label for one in examples], np.int64)
        frames = [chosen_columns(one.found.frames, archive.columns) for one in examples]
        rows = StateRows.fit(frames, own, archive.frames, archive.rate_hz)
        images = [one for one in examples if one.image is not None]
        described = [*(one.described for one in examples), *(one.image for one in images if one.image is not None)]
        labels = [*own.tolist(), *(one.image_label for one in images)]
        descriptors: F64 = chosen_columns(np.concatenate(described), archive.numbers)
        discriminant = Discriminant.fit(descriptors, np.repeat(labels, len(CUTS)))
        logs = np.log([len(one.found.yaw) for one in examples])
        count = int(own.max()) + 1
        means = np.array([logs[own == one].mean() for one in range(count)])
        variance = np.mean([logs[own == one].var() for one in range(count)])
        return cls(
            archive.rate_hz, rows, discriminant, means, float(1.25 * variance + LEAST_SPREAD), len(examples) / count,
            archive.columns, archive.numbers,
        )  # fmt: skip

    def restricted(self, columns: Bool, numbers: Bool) -> MotionClasses:
        """Return the same classes by some of the channels (C,) and numbers of descriptors (D,) that were learned."""
        rows = self.rows.restricted(columns[self.columns])
        discriminant = restricted_discriminant(self.discriminant, numbers[self.numbers])
        return replace(self, rows=rows, discriminant=discriminant, columns=columns, numbers=numbers)

    def spans(self, found: Channels) -> TakeSpans:
        """Return the spans of a take between candidate cuts, with what their scores are computed from."""
        projected, columns = self.rows.project(chosen_columns(found.frames, self.columns)), self.rows.columns
        candidates = candidate_cuts(projected, columns)
        spans = spans_between(candidates.cuts, np.exp(self.log_frames))
        sums = SpanSums(found, self.rate_hz)
        descriptors = chosen_columns(sums.describe(spans.starts, spans.stops), self.numbers)
        frames = (spans.stops - spans.starts)[:, None]
        posteriors = PER_FRAME * frames * self.discriminant.log_posteriors(descriptors)
        lengths = -0.5 * DURATION_WEIGHT * (np.log(frames) - self.log_frames) ** 2 / self.spread
        return TakeSpans(projected, columns, candidates, spans, posteriors, lengths, descriptors)


def described(found: Channels, rate_hz: float) -> F64:
    """Return the descriptors of an example with its own cuts and with others, float64 (len(CUTS), D)."""
    starts, stops = np.rint(np.array(CUTS) * len(found.yaw)).astype(np.int64).T
    return SpanSums(found, rate_hz).describe(starts, stops)
