"""This module simulates errors of inertial sensors: noise, bias, scale, range, resolution, gaps, clocks and magnets.

It includes soft tissue. Errors that a grade does not set are 0, and a grade without any error keeps the ideal readings.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field

import numpy as np

from kinedex.ops.arrays import F64, Bool
from kinedex.ops.errors import ParameterError
from kinedex.ops.inertial.rotations import exp, multiply
from kinedex.ops.inertial.sensor_model import (
    SensorMotion,
    field_in_sensor,
    smooth,
    specific_force,
    turn_rates,
)

SOFT_TISSUE_HZ = 3.0
"""Frequency in Hz below which skin and muscle move."""

CHANNELS = ("acc", "gyr", "mag")


@dataclass(frozen=True)
class ChannelErrors:
    """The errors of one kind of reading, in SI units or µT, equal in size and independent on three axes.

    Attributes
    ----------
    density : float
        Noise density, in units per square root of a hertz: white noise of density · √(rate/2).
    bias : float
        Standard deviation of the bias at the start.
    walk : float
        Walk of the bias, in units per square root of a second.
    scale : float
        Standard deviation of the scale factors' relative errors.
    axis_deg : float
        Standard deviation of the angles between the axes and those of the case, in degrees.
    range : float
        Largest reading; larger ones are clipped, and flagged. 0: no limit.
    resolution : float
        Readings are multiples of it. 0: any number.
    """

    density: float = 0.0
    bias: float = 0.0
    walk: float = 0.0
    scale: float = 0.0
    axis_deg: float = 0.0
    range: float = 0.0
    resolution: float = 0.0


@dataclass(frozen=True)
class Grade:
    """The errors of a kind of sensor and of its attachment.

    Attributes
    ----------
    acc, gyr, mag : ChannelErrors
        In m/s², rad/s and µT.
    gaps_per_minute, gap_s : float
        Number of gaps per minute, and the longest gap in seconds.
    clock_offset_s, clock_ppm : float
        Largest offset of the clock in seconds, and standard deviation of its drift in parts per million.
    magnets_per_minute, magnet_ut, magnet_s : float
        Number of passing magnets per minute, the strength of its field in µT, and its duration in seconds.
    soft_tissue_deg : float
        Root mean square rotation of the sensor relative to the bone, in degrees.
    """

    acc: ChannelErrors = field(default_factory=ChannelErrors)
    gyr: ChannelErrors = field(default_factory=ChannelErrors)
    mag: ChannelErrors = field(default_factory=ChannelErrors)
    gaps_per_minute: float = 0.0
    gap_s: float = 0.0
    clock_offset_s: float = 0.0
    clock_ppm: float = 0.0
    magnets_per_minute: float = 0.0
    magnet_ut: float = 0.0
    magnet_s: float = 0.0
    soft_tissue_deg: float = 0.0


@dataclass(frozen=True, eq=False)
class Readings:
    """The readings of a sensor.

    Attributes
    ----------
    acc, gyr, mag : float64 array (N, 3)
        Specific force in m/s², turn rates in rad/s and field in µT; NaN in gaps.
    orientation : float64 array (N, 4)
        The true orientation of the sensor, sensor → F_GI, soft tissue included.
    clipped : bool array (N,)
        The samples in which a reading was beyond its range.
    lost : bool array (N,)
        The samples in gaps.
    """

    acc: F64
    gyr: F64
    mag: F64
    orientation: F64
    clipped: Bool
    lost: Bool


@dataclass(frozen=True)
class Clock:
    """A sensor's clock: its time is the take's, plus an offset, plus a drift in parts per million."""

    offset_s: float = 0.0
    ppm: float = 0.0

    def of_take(self, seconds: F64) -> F64:
        """Convert times of the take to times of the sensor's clock, in seconds."""
        return seconds * (1.0 + 1e-6 * self.ppm) + self.offset_s

    def to_take(self, seconds: F64) -> F64:
        """Convert times of the sensor's clock to times of the take, in seconds."""
        return (seconds - self.offset_s) / (1.0 + 1e-6 * self.ppm)


def generator(seed: int, *names: str) -> np.random.Generator:
    """Return a random generator that is seeded by a number and names, such as a take's and a sensor's."""
    if seed < 0:
        raise ParameterError("seed", "at least 0", seed)
    return np.random.default_rng(np.random.SeedSequence([seed, *(zlib.crc32(name.encode()) for name in names)]))


def random_mount(random: np.random.Generator) -> F64:
    """Return a uniformly distributed random rotation (4,)."""
    q = random.standard_normal(4)
    q = q / np.linalg.norm(q)
    return -q if q[0] < 0 else q


def random_clock(grade: Grade, random: np.random.Generator) -> Clock:
    """Draw a clock of a grade: its offset is uniform up to the largest one, its drift is normal."""
    offset_s = random.uniform(-grade.clock_offset_s, grade.clock_offset_s)
    return Clock(float(offset_s), float(grade.clock_ppm * random.standard_normal()))


def measured(motion: SensorMotion, grade: Grade, field_ut: F64, random: np.random.Generator) -> Readings:
    """Return the readings of a sensor with the errors of a grade.

    Parameters
    ----------
    motion : SensorMotion
        The true motion of the sensor.
    grade : Grade
        Its errors.
    field_ut : float64 array (3,)
        The magnetic field in F_GI in µT.
    random : Generator
        Random numbers; the same state gives the same readings.
    """
    parts = random.spawn(6)
    count, rate_hz = len(motion.orientation), motion.rate_hz
    orientation = multiply(motion.orientation, soft_tissue(count, rate_hz, grade.soft_tissue_deg, parts[0]))
    around = field_ut + magnets(count, rate_hz, grade, parts[1])
    ideal = {
        "acc": specific_force(orientation, motion.acceleration),
        "gyr": turn_rates(orientation, rate_hz),
        "mag": field_in_sensor(orientation, around),
    }
    lost = gaps(count, rate_hz, grade, parts[2])
    clipped = np.zeros(count, np.bool_)
    read = {}
    for channel, own in zip(CHANNELS, parts[3:], strict=True):
        read[channel], over = with_errors(ideal[channel], getattr(grade, channel), rate_hz, own)
        clipped |= over & ~lost
        read[channel][lost] = np.nan
    return Readings(read["acc"], read["gyr"], read["mag"], orientation, clipped, lost)


def with_errors(values: F64, errors: ChannelErrors, rate_hz: float, random: np.random.Generator) -> tuple[F64, Bool]:
    """Return readings (N, 3) with the errors of a channel, and the samples beyond its range.

    Scale and axis errors are applied first, then bias and noise, then range and resolution.
    """
    count = len(values)
    scale, angles, bias = (random.standard_normal(shape) for shape in ((3,), (3, 3), (3,)))
    np.fill_diagonal(angles, 0.0)
    mixed = np.eye(3) + np.diag(errors.scale * scale) + np.radians(errors.axis_deg) * angles
    read = values @ mixed.T if errors.scale or errors.axis_deg else values.copy()
    if errors.bias:
        read += errors.bias * bias
    if errors.walk:
        read += np.cumsum(errors.walk / np.sqrt(rate_hz) * random.standard_normal((count, 3)), axis=0)
    if errors.density:
        read += errors.density * np.sqrt(0.5 * rate_hz) * random.standard_normal((count, 3))
    over = np.zeros(count, np.bool_)
    if errors.range:
        over = np.logical_or.reduce(np.abs(read) > errors.range, axis=1)
        np.clip(read, -errors.range, errors.range, out=read)
    if errors.resolution:
        read = np.round(read / errors.resolution) * errors.resolution
    return read, over


def soft_tissue(count: int, rate_hz: float, degrees: float, random: np.random.Generator) -> F64:
    """Return smooth random rotations (N, 4) of a sensor relative to the bone, with a given root mean square angle."""
    if not degrees:
        return np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    return exp(np.radians(degrees) * smooth_noise(count, rate_hz, SOFT_TISSUE_HZ, random) / np.sqrt(3.0))


def smooth_noise(count: int, rate_hz: float, cutoff_hz: float, random: np.random.Generator) -> F64:
    """Return three smooth random curves (N, 3) below a cutoff frequency, with an expected variance of 1."""
    ahead = int(np.ceil(2.0 * rate_hz / cutoff_hz))
    white = random.standard_normal((count + 2 * ahead, 3))
    curves = smooth(white, rate_hz, cutoff_hz)
    # the filter runs forwards and backwards: each curve is white noise convolved with its impulse response
    impulse = np.zeros((2 * ahead + 1, 1))
    impulse[ahead] = 1.0
    weights = smooth(impulse, rate_hz, cutoff_hz)
    curves /= np.sqrt(np.square(weights).sum())
    return curves[ahead : ahead + count]


def magnets(count: int, rate_hz: float, grade: Grade, random: np.random.Generator) -> F64:
    """Return the fields (N, 3) in µT of passing magnets in F_GI, as bell curves in random directions."""
    fields = np.zeros((count, 3))
    if not (grade.magnets_per_minute and grade.magnet_ut and grade.magnet_s):
        return fields
    seconds = np.arange(count) / rate_hz
    for _ in range(int(random.poisson(grade.magnets_per_minute * count / rate_hz / 60.0))):
        centre = random.uniform(0.0, count / rate_hz)
        way = random.standard_normal(3)
        bell = np.exp(-0.5 * np.square((seconds - centre) / (0.25 * grade.magnet_s)))
        fields += grade.magnet_ut * bell[:, None] * way / np.linalg.norm(way)
    return fields


def gaps(count: int, rate_hz: float, grade: Grade, random: np.random.Generator) -> Bool:
    """Return a mask (N,) of the lost samples; the lengths of gaps are uniform up to the longest one."""
    lost = np.zeros(count, np.bool_)
    if grade.gaps_per_minute and grade.gap_s:
        for _ in range(int(random.poisson(grade.gaps_per_minute * count / rate_hz / 60.0))):
            start = int(random.integers(count))
            lost[start : start + max(1, round(rate_hz * random.uniform(0.0, grade.gap_s)))] = True
    return lost
