"""This module simulates measurements of depth sensors: true depth with noise, flying pixels and holes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64, U16, Bool
from kinedex.ops.errors import ParameterError

EDGE_M = 0.20
"""Difference of depths in metres within a 3 × 3 window above which the middle pixel counts as an edge."""

BASELINE_M = 0.075
"""Distance in metres of a structured-light projector to the right of the camera."""

UNIT_M = 0.001
"""Unit in metres to which depth is rounded."""

_FLYING, _EDGE_HOLES, _HOLES = 0.5, 0.3, 0.001
_DISPARITY_SD_PX, _SUBPIXELS, _REFERENCE_FOCAL_PX = 0.07, 8, 580.0
_LARGEST = 65_534  # 65,535 is excluded, as many cameras use it for a missing measurement


@dataclass(frozen=True)
class DepthSensor:
    """A depth camera without distortion, whose optical axis passes through the image centre.

    Attributes
    ----------
    kind : str
        "tof" for time of flight, "structured" for structured light.
    size : tuple of (int, int)
        Width and height of its images in pixels.
    focal_px : float
        Focal length in pixels.
    """

    kind: Literal["tof", "structured"]
    size: tuple[int, int]
    focal_px: float

    @property
    def centre(self) -> tuple[float, float]:
        """Return the column and row of the optical axis."""
        return (self.size[0] - 1) / 2, (self.size[1] - 1) / 2

    @property
    def matrix(self) -> F64:
        """Return the matrix (3, 3) of the camera in pixels."""
        return np.array([[self.focal_px, 0.0, self.centre[0]], [0.0, self.focal_px, self.centre[1]], [0.0, 0.0, 1.0]])


SENSORS = {
    "tof": DepthSensor("tof", (320, 288), 252.0),
    "tof_small": DepthSensor("tof", (176, 144), 206.0),
    "structured": DepthSensor("structured", (320, 240), 285.6),
}
"""The simulated cameras, by name."""


@dataclass(frozen=True)
class ExtraErrors:
    """Errors in addition to those of the sensor, as caused by dark or shiny clothes and warm electronics.

    Attributes
    ----------
    noise : float
        Factor of the sensor's noise on the body.
    correlation : float
        Fraction of the variance of the noise that a pixel has in common with its 3 × 3 window, from 0 to 1.
    ripple_m, ripple_length_m : float
        Amplitude and wavelength of a systematic depth error that is periodic in the true depth, in metres.
    dropouts : float
        Fraction of the pixels of the body in which nothing is measured.
    """

    noise: float = 1.0
    correlation: float = 0.0
    ripple_m: float = 0.0
    ripple_length_m: float = 1.0
    dropouts: float = 0.0

    def __post_init__(self) -> None:
        for name, greatest in (("noise", np.inf), ("correlation", 1.0), ("ripple_m", np.inf), ("dropouts", 1.0)):
            if not 0 <= getattr(self, name) <= greatest or getattr(self, name) == np.inf:
                must_be = "0 or more" if greatest == np.inf else f"from 0 to {greatest:g}"
                raise ParameterError(name, must_be, getattr(self, name))
        if not 0 < self.ripple_length_m < np.inf:
            raise ParameterError("ripple_length_m", "above 0", self.ripple_length_m)


def measured(
    sensor: DepthSensor, depth: F64, body: Bool, shadow: Bool, disturbance: ExtraErrors, generator: np.random.Generator
) -> U16:
    """Simulate a measurement of a sensor.

    Parameters
    ----------
    sensor : DepthSensor
        The sensor.
    depth : float64 array (H, W)
        True depth in metres.
    body : bool array (H, W)
        The pixels of the body.
    shadow : bool array (H, W)
        The pixels that the projector does not reach, which are holes with structured light.
    disturbance : ExtraErrors
        Errors in addition to those of the sensor.
    generator : numpy.random.Generator
        The generator from which the errors are drawn.

    Returns
    -------
    uint16 array (H, W)
        Depth in millimetres; 0 if nothing was measured, or if the depth does not fit into 16 bits.
    """
    noise = _noise(depth.shape, disturbance.correlation, generator)
    if disturbance.noise != 1.0:
        noise *= np.where(body, disturbance.noise, 1.0)
    near, far = window_range(depth)
    edge = far - near > EDGE_M
    seen = depth
    if disturbance.ripple_m:
        seen = depth + disturbance.ripple_m * np.sin(2.0 * np.pi * depth / disturbance.ripple_length_m)
    read = _flight if sensor.kind == "tof" else _pattern
    values, holes = read(sensor, seen, noise, near, far, edge, generator)
    if sensor.kind == "structured":
        holes |= shadow
    if disturbance.dropouts:
        holes |= body & (generator.random(depth.shape) < disturbance.dropouts)
    units = np.rint(values / UNIT_M)
    return np.where(holes | ~(units >= 0) | (units > _LARGEST), 0, units).astype(np.uint16)


def _noise(shape: tuple[int, ...], correlation: float, generator: np.random.Generator) -> F64:
    """Draw normal noise of standard deviation 1 with correlated neighbours."""
    noise = generator.standard_normal(shape)
    if correlation > 0.0:
        height, width = shape
        single = generator.standard_normal((height + 2, width + 2))
        shared = sum(single[i : i + height, j : j + width] for i in range(3) for j in range(3)) / 3.0
        noise = np.sqrt(1.0 - correlation) * noise + np.sqrt(correlation) * shared
    return noise


def _flight(
    sensor: DepthSensor, depth: F64, noise: F64, near: F64, far: F64, edge: Bool, generator: np.random.Generator
) -> tuple[F64, Bool]:
    """Return a time-of-flight measurement: depth with noise, and flying pixels between near and far at edges."""
    values = depth + noise * (0.004 + 0.0015 * depth**2)
    flying, share = generator.random((2, int(edge.sum())))
    mixed = near[edge] + share * (far[edge] - near[edge])
    values[edge] = np.where(flying < _FLYING, mixed, values[edge])
    return values, np.zeros(depth.shape, np.bool_)


def _pattern(
    sensor: DepthSensor, depth: F64, noise: F64, near: F64, far: F64, edge: Bool, generator: np.random.Generator
) -> tuple[F64, Bool]:
    """Return a structured-light measurement: depth from noisy disparity, quantised to subpixels, and holes."""
    scale = BASELINE_M * sensor.focal_px
    part = sensor.focal_px / (_SUBPIXELS * _REFERENCE_FOCAL_PX)
    disparity = np.rint((scale / depth + _DISPARITY_SD_PX * noise) / part) * part
    holes = (generator.random(depth.shape) < _HOLES) | ~(disparity > 0)
    holes[edge] |= generator.random(int(edge.sum())) < _EDGE_HOLES
    return np.divide(scale, disparity, out=np.zeros_like(depth), where=disparity > 0), holes


def window_range(depth: F64) -> tuple[F64, F64]:
    """Return the smallest and largest depth (H, W) in the 3 × 3 window of each pixel, cropped at the border."""
    near, far = np.empty_like(depth), np.empty_like(depth)
    _window_range(depth, near, far)
    return near, far


@njit(cache=True)
def _window_range(depth: F64, near: F64, far: F64) -> None:
    height, width = depth.shape
    for v in range(height):
        for u in range(width):
            low, high = depth[v, u], depth[v, u]
            for y in range(max(v - 1, 0), min(v + 2, height)):
                for x in range(max(u - 1, 0), min(u + 2, width)):
                    low, high = min(low, depth[y, x]), max(high, depth[y, x])
            near[v, u], far[v, u] = low, high
