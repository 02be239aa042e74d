"""This module simulates the keypoints of a detector: systematic offsets, noise, confidence and outliers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.ops.errors import ParameterError


@dataclass(frozen=True)
class Detector:
    """The error model of a keypoint detector.

    Attributes
    ----------
    offset_m : float
        Standard deviation per axis of a keypoint's offset from its true point, in metres; the offset is fixed in the
        segment and constant over a take.
    noise_px : float
        Standard deviation per axis of the noise, in pixels.
    correlation : float
        Correlation of the noise of consecutive frames, an AR(1) process.
    confidence, confidence_sd : float
        Mean and standard deviation of the confidence, which is clipped to [0.5, 1].
    outliers : float
        Share of keypoints that are outliers.
    outlier_px : float
        Standard deviation per axis of their error, in pixels; their confidence is uniform in [0.3, 0.9].

    Raises
    ------
    ParameterError
        A value is out of range.
    """

    offset_m: float = 0.012
    noise_px: float = 4.0
    correlation: float = 0.7
    confidence: float = 0.85
    confidence_sd: float = 0.07
    outliers: float = 0.02
    outlier_px: float = 80.0

    def __post_init__(self) -> None:
        for name in ("offset_m", "noise_px", "confidence_sd", "outlier_px"):
            if not 0 <= getattr(self, name) < np.inf:
                raise ParameterError(name, "at least 0", getattr(self, name))
        for name, below in (("confidence", 1.0), ("outliers", 1.0), ("correlation", 0.999)):
            if not 0 <= getattr(self, name) <= below:
                raise ParameterError(name, f"from 0 to {below:g}", getattr(self, name))


LEAST_CONFIDENCE, OUTLIER_CONFIDENCE = 0.5, (0.3, 0.9)


def segment_offsets(detector: Detector, points: int, generator: np.random.Generator) -> F64:
    """Draw the offset (P, 3) of each keypoint in the frame of its node, in metres."""
    return generator.normal(0.0, detector.offset_m, (points, 3))


def detected_keypoints(detector: Detector, pixels: F64, generator: np.random.Generator) -> tuple[F64, F64]:
    """Draw the keypoints that a detector reports.

    Parameters
    ----------
    detector : Detector
        The errors.
    pixels : float64 array (T, V, P, 2)
        The true positions in the images; NaN for points behind a camera.
    generator : numpy.random.Generator
        Draws noise, outliers and confidence.

    Returns
    -------
    pixels : float64 array (T, V, P, 2)
        The reported positions.
    confidence : float64 array (T, V, P)
        Their confidence, above 0; `outside_hidden` sets that of keypoints outside the image to 0.
    """
    shape = pixels.shape[:3]
    noise = generator.normal(0.0, 1.0, (*shape, 2))
    fresh = np.sqrt(1.0 - detector.correlation**2)
    for t in range(1, len(noise)):
        noise[t] = detector.correlation * noise[t - 1] + fresh * noise[t]
    confidence = np.clip(generator.normal(detector.confidence, detector.confidence_sd, shape), LEAST_CONFIDENCE, 1.0)
    outlier = generator.random(shape) < detector.outliers
    errors = generator.normal(0.0, detector.outlier_px, (*shape, 2))
    doubted = generator.uniform(*OUTLIER_CONFIDENCE, shape)
    reported = pixels + detector.noise_px * noise + np.where(outlier[..., None], errors, 0.0)
    return reported, np.where(outlier, doubted, confidence)


def outside_hidden(pixels: F64, confidence: F64, size: tuple[int, int]) -> tuple[F64, F64]:
    """Set keypoints outside the image, and their confidence, to 0.

    Parameters
    ----------
    pixels : float64 array (T, V, P, 2)
        Positions in the images; NaN where there is none.
    confidence : float64 array (T, V, P)
        Their confidence.
    size : tuple of (int, int)
        Width and height of the images in pixels.

    Returns
    -------
    pixels : float64 array (T, V, P, 2)
        The positions, 0 where the keypoint is not visible.
    confidence : float64 array (T, V, P)
        The confidence, 0 where the keypoint is not visible.
    """
    inside = ((pixels >= 0.0) & (pixels < np.array(size, np.float64))).all(axis=-1)  # false for NaN
    seen = inside & (confidence > 0.0)
    return np.where(seen[..., None], pixels, 0.0), np.where(seen, confidence, 0.0)
