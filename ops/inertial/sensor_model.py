"""This module simulates an ideal inertial sensor on a limb: rates, specific force and field (thesis, Appendix A).

In the inertial world F_GI, X points to magnetic north, Y to the west and Z up; in the world of a take, Y points up. The
angular rates are in the sensor's axes. The thesis is corrected in two places: Algorithm 5, Im(q_k ∘ q̄_{k−1}), gives
rates in global axes, and Eq. A.22 is one sample late.

A `Grade` defines the errors of real sensors: noise, bias, scale, range, resolution, gaps, clocks, magnets and the
movement of soft tissue. Errors that a grade does not set are 0, and without any error the readings are ideal.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field
from types import ModuleType

import numpy as np

from kinedex.ops.arrays import F64, Bool
from kinedex.ops.errors import ParameterError
from kinedex.ops.inertial.lowpass import lowpass
from kinedex.ops.inertial.rotations import Z_TO_Y, conjugate, continuous, exp, log, multiply, rotate
from kinedex.ops.packages import imu_package

GRAVITY = np.array([0.0, 0.0, 9.81])
"""The reading of an accelerometer at rest in F_GI, in m/s²."""

FIELD_UT, INCLINATION_DEG = 48.255, 64.883
"""The magnetic field in Saarbrücken (thesis, A.1): strength in µT, and inclination in degrees below the horizon."""

CUTOFF_HZ = 15.0
"""Frequency in Hz at which positions and rotations of takes are smoothed before they are differentiated."""

MIN_SAMPLES = 8
"""The smallest number of samples for a quintic spline and a filter."""

SOFT_TISSUE_HZ = 3.0
"""Frequency in Hz below which skin and muscle move."""

CHANNELS = ("acc", "gyr", "mag")


@dataclass(frozen=True, eq=False)
class SensorMotion:
    """The true motion of a sensor in F_GI at evenly spaced times.

    Attributes
    ----------
    rate_hz : float
        Samples per second.
    orientation : float64 array (N, 4)
        Unit quaternions w x y z, sensor → F_GI.
    acceleration : float64 array (N, 3)
        Second derivative of the sensor's position, in m/s², in F_GI.
    """

    rate_hz: float
    orientation: F64
    acceleration: F64


def world_rotation(heading_deg: float) -> F64:
    """Return q_G, the rotation (4,) from F_GI to a take's world with Y up, for a heading about the vertical."""
    return multiply(Z_TO_Y, exp(np.array([0.0, 0.0, np.radians(heading_deg)])))


def magnetic_field(
    strength_ut: float = FIELD_UT, inclination_deg: float = INCLINATION_DEG, declination_deg: float = 0.0
) -> F64:
    """Return the magnetic field in F_GI (thesis, Eq. A.4 to A.7).

    Parameters
    ----------
    strength_ut : float, optional
        The strength of the field in µT.
    inclination_deg : float, optional
        The angle in degrees by which the field points below the horizon.
    declination_deg : float, optional
        The angle in degrees between X and magnetic north, which is 0 in F_GI.

    Returns
    -------
    float64 array (3,)
        The field in µT.
    """
    phi, theta = np.radians(inclination_deg), np.radians(declination_deg)
    return strength_ut * np.array([np.cos(phi) * np.cos(theta), -np.cos(phi) * np.sin(theta), -np.sin(phi)])


def sensor_motion(
    times: F64,
    position: F64,
    orientation: F64,
    at: F64,
    q_global: F64,
    q_mount: F64,
    lever: F64 | None = None,
    cutoff_hz: float = CUTOFF_HZ,
) -> SensorMotion:
    """Return the motion of a sensor that is mounted on a limb.

    Positions are smoothed and interpolated by a quintic spline, orientations by a spline of rotations.

    Parameters
    ----------
    times : float64 array (T,)
        Times of the limb's frames in seconds, evenly spaced.
    position : float64 array (T, 3)
        A point of the limb in metres, in the take's world.
    orientation : float64 array (T, 4)
        Unit quaternions of the limb, segment → the take's world.
    at : float64 array (N,)
        The evenly spaced times of the sensor's samples, within the times of the frames.
    q_global : float64 array (4,)
        F_GI → the take's world.
    q_mount : float64 array (4,)
        Sensor → segment.
    lever : float64 array (3,), optional
        The vector from the point to the sensor in metres, in the segment's axes.
    cutoff_hz : float, optional
        Frequency in Hz at which positions and orientations are smoothed; no smoothing if the rate is not above twice
        the frequency.

    Raises
    ------
    ParameterError
        There are fewer than 8 frames, a frame is not known, or a time of `at` lies outside the frames.
    MissingPackageError
        The package scipy is not installed.
    """
    if len(times) < MIN_SAMPLES or position.shape != (len(times), 3) or orientation.shape != (len(times), 4):
        raise ParameterError(
            "times, position, orientation", f"of {MIN_SAMPLES} frames or more, (T,), (T, 3) and (T, 4)",
            (times.shape, position.shape, orientation.shape),
        )  # fmt: skip
    if not (np.isfinite(position).all() and np.isfinite(orientation).all()):
        raise ParameterError("position and orientation", "finite in all frames", "NaN or infinity")
    if len(at) < 2 or at[0] < times[0] - 1e-9 or at[-1] > times[-1] + 1e-9:
        raise ParameterError("at", f"two times or more within {times[0]:g} to {times[-1]:g} s", f"{len(at)} times")
    rate_hz = (len(times) - 1) / (times[-1] - times[0])
    place = position if lever is None else position + rotate(orientation, lever)
    place, turned = smooth(place, rate_hz, cutoff_hz), smooth(continuous(orientation), rate_hz, cutoff_hz)
    turned = turned / np.linalg.norm(turned, axis=1, keepdims=True)
    inside = np.clip(at, times[0], times[-1])
    spline = _scipy("interpolate").make_interp_spline(times, place, k=5)
    acceleration = np.asarray(spline.derivative(2)(inside), np.float64)
    back = conjugate(q_global)
    whole = multiply(back, multiply(_interpolated_rotations(times, turned, inside), q_mount))
    return SensorMotion((len(at) - 1) / (at[-1] - at[0]), continuous(whole), rotate(back, acceleration))


def _interpolated_rotations(times: F64, turned: F64, at: F64) -> F64:
    """Return rotations (N, 4) w x y z, interpolated by a spline with continuous angular accelerations."""
    transform = _scipy("spatial.transform")
    spline = transform.RotationSpline(times, transform.Rotation.from_quat(turned[:, [1, 2, 3, 0]]))
    return np.asarray(spline(at).as_quat(), np.float64)[:, [3, 0, 1, 2]]


def smooth(values: F64, rate_hz: float, cutoff_hz: float) -> F64:
    """Return values (T, K), smoothed by a zero-phase Butterworth filter of order 2.

    Values are returned unchanged if the rate is not above twice the frequency, or if there are fewer than 8.
    """
    if cutoff_hz >= 0.5 * rate_hz or len(values) < MIN_SAMPLES:
        return values
    padding = min(len(values) - 1, int(np.ceil(3 * rate_hz / cutoff_hz)))
    return lowpass(values, rate_hz, cutoff_hz, padding)


def gyroscope_rates(orientation: F64, rate_hz: float) -> F64:
    """Return a gyroscope's readings: the rotation since the previous sample over the time step, in sensor axes.

    Integrating the rates reproduces the orientations. With central differences instead, integrated orientations would
    be half a sample ahead.

    Parameters
    ----------
    orientation : float64 array (N, 4)
        Unit quaternions w x y z, sensor → world.
    rate_hz : float
        Samples per second.

    Returns
    -------
    float64 array (N, 3)
        Angular velocities in radians per second; 0 in the first sample.
    """
    rates = np.zeros((len(orientation), 3))
    rates[1:] = log(multiply(conjugate(orientation[:-1]), orientation[1:])) * rate_hz
    return rates


def specific_force(orientation: F64, acceleration: F64) -> F64:
    """Return an accelerometer's readings (N, 3) in m/s²: acceleration plus gravity's reaction, in sensor axes."""
    return rotate(conjugate(orientation), acceleration + GRAVITY)


def field_in_sensor(orientation: F64, field: F64) -> F64:
    """Return a field (3,) or (N, 3), given in F_GI, in the axes of a sensor, (N, 3)."""
    return rotate(conjugate(orientation), np.broadcast_to(field, (len(orientation), 3)))


def centred_acceleration(position: F64, rate_hz: float) -> F64:
    """Return central second differences (N, 3) of positions (N, 3); both ends repeat their neighbour."""
    found = np.empty_like(position)
    found[1:-1] = (position[2:] - 2.0 * position[1:-1] + position[:-2]) * rate_hz**2
    found[0], found[-1] = found[1], found[-2]
    return found


def _scipy(part: str) -> ModuleType:
    return imu_package(f"scipy.{part}", "simulated sensors need")


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
        Largest reading; larger values are clipped and flagged. 0 for no limit.
    resolution : float
        Step of the readings, which are multiples of it. 0 for no rounding.
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
        The errors of accelerometer, gyroscope and magnetometer in m/s², rad/s and µT.
    gaps_per_minute, gap_s : float
        Number of gaps per minute, and the longest gap in seconds.
    clock_offset_s, clock_ppm : float
        Largest offset of the clock in seconds, and standard deviation of its drift in parts per million.
    magnets_per_minute, magnet_ut, magnet_s : float
        Number of passing magnets per minute, and the strength in µT and duration in seconds of the field of a magnet.
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
        Specific force in m/s², angular velocity in rad/s and field in µT; NaN in gaps.
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
    """A sensor's clock, whose time is the time t of the take plus offset_s + ppm · 10⁻⁶ · t."""

    offset_s: float = 0.0
    ppm: float = 0.0

    def of_take(self, seconds: F64) -> F64:
        """Convert times of the take to times of the sensor's clock, in seconds."""
        return seconds * (1.0 + 1e-6 * self.ppm) + self.offset_s

    def to_take(self, seconds: F64) -> F64:
        """Convert times of the sensor's clock to times of the take, in seconds."""
        return (seconds - self.offset_s) / (1.0 + 1e-6 * self.ppm)


def seeded_generator(seed: int, *names: str) -> np.random.Generator:
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
    """Draw a clock of a grade, with an offset uniform up to the grade's largest offset, and a normal drift."""
    offset_s = random.uniform(-grade.clock_offset_s, grade.clock_offset_s)
    return Clock(float(offset_s), float(grade.clock_ppm * random.standard_normal()))


def measured(motion: SensorMotion, grade: Grade, field_ut: F64, random: np.random.Generator) -> Readings:
    """Return the readings of a sensor with the errors of a grade.

    Parameters
    ----------
    motion : SensorMotion
        The true motion of the sensor.
    grade : Grade
        The errors of the sensor.
    field_ut : float64 array (3,)
        The magnetic field in F_GI in µT.
    random : Generator
        Random numbers; the same state gives the same readings.
    """
    parts = random.spawn(6)
    count, rate_hz = len(motion.orientation), motion.rate_hz
    orientation = multiply(motion.orientation, soft_tissue(count, rate_hz, grade.soft_tissue_deg, parts[0]))
    around = field_ut + magnet_fields(count, rate_hz, grade, parts[1])
    ideal = {
        "acc": specific_force(orientation, motion.acceleration),
        "gyr": gyroscope_rates(orientation, rate_hz),
        "mag": field_in_sensor(orientation, around),
    }
    lost = missing_samples(count, rate_hz, grade, parts[2])
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


def magnet_fields(count: int, rate_hz: float, grade: Grade, random: np.random.Generator) -> F64:
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


def missing_samples(count: int, rate_hz: float, grade: Grade, random: np.random.Generator) -> Bool:
    """Return a mask (N,) of the lost samples; the lengths of gaps are uniform up to the longest one."""
    lost = np.zeros(count, np.bool_)
    if grade.gaps_per_minute and grade.gap_s:
        for _ in range(int(random.poisson(grade.gaps_per_minute * count / rate_hz / 60.0))):
            start = int(random.integers(count))
            lost[start : start + max(1, round(rate_hz * random.uniform(0.0, grade.gap_s)))] = True
    return lost
