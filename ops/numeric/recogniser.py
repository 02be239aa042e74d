"""This module recognises motions by numbers: it learns classes from examples, and labels takes.

Rows of states determine where a motion may begin and end, and a discriminant which class a span belongs to. The labels
are the spans with the greatest sum of scores.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.ops.body.facing_direction import mirrored_positions
from kinedex.ops.errors import ParameterError
from kinedex.ops.numeric.candidate_cuts import candidate_cuts
from kinedex.ops.numeric.channels import Channels, channels
from kinedex.ops.numeric.discriminant import Discriminant
from kinedex.ops.numeric.span_chain import best_chain, spans_between
from kinedex.ops.numeric.span_descriptors import SpanSums
from kinedex.ops.numeric.state_rows import StateRows

READINESS = 8.0
"""The evidence that is added to each frame of a label, for archives in which most motions are taught."""

PER_FRAME = 1.0
"""The weight of a frame's share in the log-probability of its span's class."""

DURATION_WEIGHT = 10.0
"""The weight of the squared deviation of a span's log duration from that of its class."""

LEAST_FRAMES = 3
"""The fewest frames of an example."""

CUTS = ((0.0, 1.0), (0.2, 1.0), (0.0, 0.8))
"""The parts of an example by which its class is taught: spans in a take are rarely cut as examples are."""

LEAST_SPREAD = 0.02
"""The variance of log durations that is added to that of the examples."""


class TaughtMotion(NamedTuple):
    """A motion that teaches a class.

    Attributes
    ----------
    positions : float64 array (L, J, 3)
        The joints in metres, Y up, at the common rate.
    label : str
        The name of the class.
    """

    positions: F64
    label: str


class Recognised(NamedTuple):
    """A span of a take with its class.

    Attributes
    ----------
    start, stop : int
        The half-open range of its frames.
    label : str
        The name of the class.
    probability : float
        The probability of the class by the discriminant, for a span that shows one of the taught classes. It is not
        calibrated.
    """

    start: int
    stop: int
    label: str
    probability: float


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
    rows : StateRows
        The states of the classes.
    discriminant : Discriminant
        The discriminant that tells spans of the classes apart.
    log_frames : float64 array (P,)
        The mean of the logarithm of the examples' lengths.
    spread : float
        The variance of this logarithm within classes.
    """

    joints: tuple[str, ...]
    rate_hz: float
    classes: tuple[str, ...]
    rows: StateRows
    discriminant: Discriminant
    log_frames: F64
    spread: float

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
        own = np.array([classes.index(one.label) for one in examples], np.int64)
        found = [channels(one.positions, joints, rate_hz) for one in examples]
        archive = [channels(one, joints, rate_hz) for one in unlabelled] or found
        rows = StateRows.fit(
            [one.frames for one in found], own, np.concatenate([one.frames for one in archive]), rate_hz
        )
        described = [_taught(one, rate_hz) for one in found]
        labels = own.tolist()
        for one in examples:
            other = (mirror or {}).get(one.label)
            if other in classes:
                image = channels(mirrored_positions(one.positions, joints), joints, rate_hz)
                described.append(_taught(image, rate_hz))
                labels.append(classes.index(other))
        descriptors = np.concatenate(described)
        discriminant = Discriminant.fit(descriptors, np.repeat(labels, len(CUTS)))
        logs = np.log([len(one.positions) for one in examples])
        means = np.array([logs[own == one].mean() for one in range(len(classes))])
        variance = np.mean([logs[own == one].var() for one in range(len(classes))])
        return cls(tuple(joints), rate_hz, classes, rows, discriminant, means, float(1.25 * variance + LEAST_SPREAD))

    def label(self, positions: F64, readiness: float = READINESS) -> list[Recognised]:
        """Return the labelled spans of a take in their order; they do not overlap.

        Parameters
        ----------
        positions : float64 array (L, J, 3)
            The joints in metres, at the rate of the examples.
        readiness : float
            The evidence that is added to each frame of a label; with a lower value, more frames have no label.
        """
        found = channels(positions, self.joints, self.rate_hz)
        projected, columns = self.rows.project(found.frames), self.rows.columns
        candidates = candidate_cuts(projected, columns)
        spans = spans_between(candidates.cuts, np.exp(self.log_frames))
        posteriors = self.discriminant.log_posteriors(SpanSums(found, self.rate_hz).describe(spans.starts, spans.stops))
        frames = (spans.stops - spans.starts)[:, None]
        away = (np.log(frames) - self.log_frames) ** 2 / self.spread
        worth = PER_FRAME * frames * posteriors - 0.5 * DURATION_WEIGHT * away
        chain = best_chain(projected, columns, candidates, spans, worth, readiness)
        return [
            Recognised(
                int(spans.starts[span]),
                int(spans.stops[span]),
                self.classes[kind],
                float(np.exp(posteriors[span, kind])),
            )
            for span, kind in zip(chain.spans.tolist(), chain.classes.tolist(), strict=True)
        ]

    def classify(self, positions: F64) -> F64:
        """Return the logarithm of the probability of each class for a whole take, float64 (P,)."""
        return self.discriminant.log_posteriors(_whole(channels(positions, self.joints, self.rate_hz), self.rate_hz))[0]


def _whole(found: Channels, rate_hz: float) -> F64:
    """Return the descriptor of a whole take, float64 (1, D)."""
    return SpanSums(found, rate_hz).describe(np.zeros(1, np.int64), np.array([len(found.yaw)], np.int64))


def _taught(found: Channels, rate_hz: float) -> F64:
    """Return the descriptors of an example and of parts of it, the spans of `CUTS`, float64 (len(CUTS), D)."""
    starts, stops = np.rint(np.array(CUTS) * len(found.yaw)).astype(np.int64).T
    return SpanSums(found, rate_hz).describe(starts, stops)
