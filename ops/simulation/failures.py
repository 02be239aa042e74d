"""This module simulates failures of a keypoint detector: cameras without output, and misplaced limbs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kinedex.ops.arrays import F64, I64
from kinedex.ops.errors import ParameterError

KINDS = ("views", "occluded", "swapped", "stuck")
"""The kinds of failures.

- views: half of the cameras report nothing.
- occluded: a limb is reported elsewhere, with little confidence, in half of the cameras or more, but not in all.
- swapped: left and right leg are exchanged from hip to toe, with full confidence, in half of the cameras or fewer.
- stuck: elbow and wrist are reported on those of the other arm, in half of the cameras or more, but not in all.
"""

LIMB_PX, KEYPOINT_PX, WOBBLE_PX, STUCK_PX = 70.0, 20.0, 8.0, 6.0
"""Standard deviations per axis, in pixels: of an occluded limb in a camera, of each of its keypoints, of its keypoints
in each frame, and of stuck keypoints in each frame."""

OCCLUDED_CONFIDENCE, STUCK_CONFIDENCE = (0.25, 0.6), 0.6


@dataclass(frozen=True)
class FailureRate:
    """The frequency and duration of failures.

    Attributes
    ----------
    per_second : float
        Failures a second.
    shortest_s, longest_s : float
        Least and greatest duration in seconds.

    Raises
    ------
    ParameterError
        A value is out of range.
    """

    per_second: float = 0.67
    shortest_s: float = 0.4
    longest_s: float = 1.2

    def __post_init__(self) -> None:
        if not 0 <= self.per_second <= 100:
            raise ParameterError("per_second", "from 0 to 100 failures a second", self.per_second)
        if not 0 < self.shortest_s <= self.longest_s < np.inf:
            raise ParameterError("shortest_s", "above 0 and not above longest_s", (self.shortest_s, self.longest_s))


LONG = FailureRate(shortest_s=1.2, longest_s=2.2)
"""The rate of long failures."""


@dataclass(frozen=True, eq=False)
class Limbs:
    """The keypoints of limbs, in the same order on both sides.

    Attributes
    ----------
    arms : tuple of int64 array
        Elbow and wrist, left and right.
    legs : tuple of int64 array
        Hip to toes, left and right; the hip comes first.
    """

    arms: tuple[I64, I64]
    legs: tuple[I64, I64]

    def named(self, limb: str) -> I64:
        """Return the keypoints of a limb that a failure displaces: of the whole arm, or of the leg without the hip."""
        side = "lr".index(limb[0])
        return self.arms[side] if limb[1:] == "arm" else self.legs[side][1:]


LIMBS = ("larm", "rarm", "lleg", "rleg")


@dataclass(frozen=True)
class Failure:
    """A failure of the detector in the frames [start, stop).

    Attributes
    ----------
    start, stop : int
        The frames.
    kind : str
        One of `KINDS`.
    limb : str
        One of `LIMBS`, "legs" for both, "body" for all keypoints.
    cameras : tuple of int
        The cameras in which it occurs.
    """

    start: int
    stop: int
    kind: str
    limb: str
    cameras: tuple[int, ...]


def draw_failures(
    rate: FailureRate, frames: int, rate_hz: float, cameras: int, generator: np.random.Generator
) -> list[Failure]:
    """Draw the failures of a take; they may overlap.

    Parameters
    ----------
    rate : FailureRate
        Their number and length.
    frames : int
        Frames of the take.
    rate_hz : float
        Frames a second.
    cameras : int
        Number of cameras, V.
    generator : numpy.random.Generator
        Draws kind, limb, length, start and cameras, each uniformly.

    Returns
    -------
    list of Failure
        The failures, sorted by start. With a single camera, only "views" occurs.
    """
    half = max(1, cameras // 2)
    counts = {
        "views": (half, half),
        "occluded": (half, cameras - 1),
        "swapped": (1, half),
        "stuck": (half, cameras - 1),
    }
    found = []
    for _ in range(round(rate.per_second * frames / rate_hz)):
        kind = KINDS[int(generator.integers(len(KINDS)))] if cameras > 1 else "views"
        limb = LIMBS[int(generator.integers(2 if kind == "stuck" else len(LIMBS)))]
        length = min(frames, max(1, round(generator.uniform(rate.shortest_s, rate.longest_s) * rate_hz)))
        start = int(generator.integers(frames - length + 1))
        low, high = counts[kind]
        number = int(generator.integers(low, high + 1))
        chosen = tuple(sorted(generator.permutation(cameras)[:number].tolist()))
        limb = {"views": "body", "swapped": "legs"}.get(kind, limb)
        found.append(Failure(start, start + length, kind, limb, chosen))
    return sorted(found, key=lambda one: (one.start, one.stop, one.kind, one.limb, one.cameras))


def with_failures(
    failures: Sequence[Failure], limbs: Limbs, pixels: F64, confidence: F64, generator: np.random.Generator
) -> tuple[F64, F64]:
    """Apply failures to keypoints, one after the other.

    Parameters
    ----------
    failures : sequence of Failure
        The failures.
    limbs : Limbs
        The keypoints of limbs.
    pixels : float64 array (T, V, P, 2)
        Positions in the images.
    confidence : float64 array (T, V, P)
        Their confidence.
    generator : numpy.random.Generator
        Draws the false positions of limbs.

    Returns
    -------
    pixels : float64 array (T, V, P, 2)
        The positions with failures.
    confidence : float64 array (T, V, P)
        Their confidence.
    """
    moved, trusted = pixels.copy(), confidence.copy()
    for one in failures:
        for camera in one.cameras:
            _fail(one, limbs, moved[one.start : one.stop, camera], trusted[one.start : one.stop, camera], generator)
    return moved, trusted


def _fail(one: Failure, limbs: Limbs, pixels: F64, confidence: F64, generator: np.random.Generator) -> None:
    """Apply a failure to the keypoints (T, P, 2) and the confidence (T, P) of a camera, in place."""
    if one.kind == "views":
        confidence[:] = 0.0
    elif one.kind == "swapped":
        left, right = limbs.legs
        for values in (pixels, confidence):
            values[:, np.concatenate([left, right])] = values[:, np.concatenate([right, left])]
    elif one.kind == "occluded":
        mine = limbs.named(one.limb)
        off = generator.normal(0.0, LIMB_PX, 2) + generator.normal(0.0, KEYPOINT_PX, (len(mine), 2))
        pixels[:, mine] += off + generator.normal(0.0, WOBBLE_PX, (len(pixels), len(mine), 2))
        confidence[:, mine] = generator.uniform(*OCCLUDED_CONFIDENCE, (len(pixels), len(mine)))
    else:
        mine = limbs.named(one.limb)
        other = limbs.named("rarm" if one.limb == "larm" else "larm")
        pixels[:, mine] = pixels[:, other] + generator.normal(0.0, STUCK_PX, (len(pixels), len(mine), 2))
        confidence[:, mine] = STUCK_CONFIDENCE
