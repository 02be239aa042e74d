"""Convert the samples of a sensor to SI units, and check its units, axes, world and times for contradictions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.catalog.sensorsets import FASTEST_HZ, SLOWEST_HZ
from kinedex.ops.errors import SourceError
from kinedex.ops.inertial import readings
from kinedex.ops.inertial.orientation_filter import TO_NORTH_WEST_UP, field_axis
from kinedex.ops.inertial.rotations import LONGEST_GAP_S, conjugate, exp, from_matrix, multiply, rotate
from kinedex.storage.formats.imu.signals import (
    ENU,
    GRAVITY,
    NED,
    NWU,
    UNITS,
    ImuSensor,
    RawSensor,
    UserStatements,
)

F64 = npt.NDArray[np.float64]

OFF_LENGTH = 0.01
"""The largest deviation of a quaternion's length from 1."""

OFF_GRAVITY = 0.3
"""The largest relative deviation of the median specific force from gravity."""

LARGEST = 1e7
"""The largest plausible reading, in any unit."""

LATEST_S = 1e11
"""The latest plausible time of a clock in seconds, some 3,000 years."""

FASTEST_RAD_S = 70.0
"""The largest plausible angular velocity: 4,000 degrees per second."""

_LONG_STEPS = 10.0  # a step longer than this number of mean steps is a gap
_MAX_MISSING = 1.5  # largest ratio of the steps that fit the median period to those present, for an even clock
_DEFAULT_UNITS = {"acc": "m/s2", "gyr": "rad/s", "mag": "uT"}
_WORLDS = {"NWU": NWU, "ENU": ENU, "NED": NED}
_TO_NWU = {NWU: None, ENU: TO_NORTH_WEST_UP, NED: exp(np.array([np.pi, 0.0, 0.0]))}
_TURNING_RAD_S = 0.1  # slower rotation is mostly noise
_STILL_RAD_S = 0.1
_ALIKE = 0.7
_SURELY_ALIKE, _MIN_RATIO = 0.9, 0.75  # sample files: 0.95 and more, 0.97 to 1.04
_WAY_OUT = "in a file of sensors"


def checked_sensor(path: Path, raw: RawSensor, given: UserStatements) -> ImuSensor:
    """Return a sensor in SI units, with its orientation in F_GI.

    Parameters
    ----------
    path : Path
        The file, for messages.
    raw : RawSensor
        The sensor as read from the file.
    given : UserStatements
        The user's statements about the file.

    Raises
    ------
    SourceError
        The file contradicts itself or the user's statements.
    """
    return _Checks(path, raw, given).sensor()


class _Checks:
    """The checks and conversions of one sensor, and their intermediate results."""

    def __init__(self, path: Path, raw: RawSensor, given: UserStatements) -> None:
        self.path, self.raw, self.set = path, raw, given.sensor_set
        self.warnings = list(raw.warnings)
        self.given_hz = given.rate_hz or self.set.entries.rate_hz

    def error(self, message: str, row: int | None = None) -> SourceError:
        """Return an error that names the sensor, and the line of a sample."""
        where = "" if row is None else self.raw.where(row)
        line = None if row is None else self.raw.at(row)
        return SourceError(self.path, f"sensor '{self.raw.name}': {where}{message}", line=line)

    def sensor(self) -> ImuSensor:
        """Return the checked sensor in SI units."""
        times, rate_hz = self.times()
        acc, gyr, mag = (self.channel(name) for name in ("acc", "gyr", "mag"))
        acc, gyr, mag = (
            None if part is None else readings.bridge(times, part, LONGEST_GAP_S) for part in (acc, gyr, mag)
        )
        orientation = self.unit_quaternions()
        if acc is None and gyr is None and mag is None and orientation is None:
            raise self.error("nothing was measured")
        if orientation is not None:
            orientation = readings.bridge(times, orientation, LONGEST_GAP_S)
        self.check_rates(times, acc, gyr, orientation)
        if acc is not None:
            acc = acc * self.acc_factor(times, acc, gyr, orientation)
        frame, assumed = "", False
        if orientation is not None:
            frame, assumed = self.world(orientation, acc, mag)
            turn = _TO_NWU[frame]
            orientation = orientation if turn is None else multiply(turn, orientation)
        acc, gyr, mag, orientation = self.turned(acc, gyr, mag, orientation)
        return ImuSensor(
            self.raw.name, times, rate_hz, acc, gyr, mag, orientation, frame,
            _gaps(times, rate_hz, (acc, gyr, orientation), mag), tuple(self.warnings), assumed,
        )  # fmt: skip

    def times(self) -> tuple[F64, float]:
        """Return the time of every sample in seconds, and the number of samples per second."""
        rate_hz, times = self.raw.rate_hz, self.raw.times
        if times is None:
            rate_hz = rate_hz or self.given_hz
            if rate_hz is None:
                raise self.error(
                    f"the file states no rate and no times; give the rate: --rate HZ, or `rate_hz:` {_WAY_OUT}"
                )
            self.check_rate(rate_hz)
            steps = np.arange(self.raw.samples) if self.raw.steps is None else self.raw.steps
            return np.asarray(steps) / rate_hz, rate_hz
        unknown = np.flatnonzero(~(np.abs(times) <= LATEST_S))
        if len(unknown):
            raise self.error("has no time; write the time of the sample, or remove the sample", int(unknown[0]))
        back = np.flatnonzero(~(np.diff(times) > 0))
        if len(back):
            row = int(back[0]) + 1
            raise self.error(
                f"time must ascend, got {times[row]:.9g} s after {times[row - 1]:.9g} s; cut the file where a new "
                "recording begins, or leave out `time` of `columns:` and state `rate_hz:` to count samples", row,
            )  # fmt: skip
        measured = _measured_rate(times)
        if rate_hz and measured and abs(measured / rate_hz - 1) > 0.02:
            self.warnings.append(
                f"the file states {rate_hz:g} samples per second, and its times make {measured:.5g}; the times are used"
            )
        rate_hz = measured or rate_hz or self.given_hz
        if rate_hz is None:
            raise self.error("has one sample only, and no rate; state `rate_hz`")
        self.check_rate(rate_hz)
        return times, rate_hz

    def check_rate(self, rate_hz: float) -> None:
        """Raise an error for a rate that no sensor has."""
        if not SLOWEST_HZ <= rate_hz <= FASTEST_HZ:
            raise self.error(
                f"its times make {rate_hz:.3g} samples per second, and sensors have {SLOWEST_HZ:g} to {FASTEST_HZ:g}; "
                f"state the unit of times {_WAY_OUT}, as `units: {{time: ms}}`"
            )

    def channel(self, name: str) -> F64 | None:
        """Return a channel's readings in SI units; readings without a stated unit count as SI."""
        values: F64 | None = getattr(self.raw, name)
        if values is None:
            return None
        if (row := _first_beyond(values)) is not None:
            raise self.error(f"{name} of {np.nanmax(np.abs(values[row])):.3g} is no reading of a sensor", row)
        unit = self.set.unit(name) or self.raw.units.get(name) or _DEFAULT_UNITS[name]
        return values * UNITS[name][unit]

    def acc_factor(self, times: F64, acc: F64, gyr: F64 | None, orientation: F64 | None) -> float:
        """Return the factor that corrects accelerations of unknown unit; raise an error if gravity contradicts a unit.

        Gravity is estimated in three ways: from the median, from the mean in world axes, and from the median at rest.
        A unit is accepted if any estimate fits it. If no unit is stated, the factor is that of the first unit that
        fits.
        """
        sizes = _gravity_sizes(times, acc, gyr, orientation)
        if not sizes or any(_fits(size) for size in sizes):
            return 1.0
        stated = self.set.unit("acc")
        unit = stated or self.raw.units.get("acc") or _DEFAULT_UNITS["acc"]
        own = UNITS["acc"][unit]
        factors = {name: factor / own for name, factor in UNITS["acc"].items()}
        other = next((name for name in factors if any(_fits(size * factors[name]) for size in sizes)), None)
        found = f"|acc| is {sizes[0] / own:.3g} {unit}, and gravity is {GRAVITY / own:.3g}"
        if other is not None and stated is None and "acc" not in self.raw.units:
            return factors[other]
        if other is not None:
            raise self.error(f"{found}; state `units: {{acc: {other}}}` {_WAY_OUT}")
        if stated is None and not any(0.5 <= size / GRAVITY <= 2 for size in sizes):
            raise self.error(
                f"{found}; are these accelerations without gravity, or in an unknown unit? To read them "
                f"nevertheless, state `units: {{acc: {unit}}}` {_WAY_OUT}"
            )
        self.warnings.append(f"{found}: the sensor moves fast all the time, or its unit is wrong")
        return 1.0

    def unit_quaternions(self) -> F64 | None:
        """Return the orientations (from sensor to world) as unit quaternions; None if all are missing.

        Zero quaternions count as missing, and become NaN.
        """
        given = self.raw.orientation
        if given is None:
            return None
        if (row := _first_beyond(given)) is not None:
            raise self.error("a quaternion must have the length 1", row)
        lengths = np.linalg.norm(given, axis=1)
        quaternions = np.where((lengths == 0)[:, None], np.nan, given)
        off = np.flatnonzero((lengths > 0) & ~(np.abs(lengths - 1) <= OFF_LENGTH))
        if len(off):
            row = int(off[0])
            raise self.error(
                f"a quaternion has the length {lengths[row]:.4g}, expected 1 to {OFF_LENGTH:.0%}; are the columns w, "
                f"x, y and z? Name them {_WAY_OUT}, as `columns: {{orientation: [qw, qx, qy, qz]}}`", row,
            )  # fmt: skip
        quaternions = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
        if np.isnan(quaternions).any(axis=1).all():
            return None
        turned = self.set.entries.orientation == "world_to_sensor"
        return conjugate(quaternions) if turned else quaternions

    def check_rates(self, times: F64, acc: F64 | None, gyr: F64 | None, orientation: F64 | None) -> None:
        """Raise an error if angular velocities are in another unit than stated, or if orientations are inverse."""
        if gyr is None:
            return
        fastest = float(np.nanmax(np.linalg.norm(gyr, axis=1), initial=0.0))
        unit = self.set.unit("gyr") or self.raw.units.get("gyr") or _DEFAULT_UNITS["gyr"]
        if fastest > FASTEST_RAD_S:
            raise self.wrong_rates(unit, f"gyr reaches {np.degrees(fastest):,.0f} degrees per second")
        if orientation is not None:
            self.compare_orientation(times, gyr, orientation, unit)
        elif acc is not None:
            _, ratio, turning = readings.compare_with_gravity(times, acc, gyr)
            if ratio > 5 and ratio * turning > 0.5:
                raise self.wrong_rates(
                    unit, f"gyr turns {ratio:.0f} times as fast as gravity does in the sensor's axes"
                )

    def compare_orientation(self, times: F64, gyr: F64, orientation: F64, unit: str) -> None:
        """Compare angular velocities with those that follow from the orientations of the file."""
        rate_hz = 1.0 / max(float(np.median(np.diff(times))), 1e-9) if len(times) > 1 else 0.0
        as_read, ratio, turning = readings.compare_with_orientation(times, gyr, orientation)
        if not turning > _TURNING_RAD_S:
            return
        around, _, _ = readings.compare_with_orientation(times, gyr, conjugate(orientation))
        if around > _ALIKE and around > as_read + 0.2:
            turned = self.set.entries.orientation == "world_to_sensor"
            raise self.error(
                f"the quaternions turn from the world to the sensor: their rate and gyr correlate at {as_read:.2f}, "
                f"and turned around at {around:.2f}; state `orientation: "
                f"{'sensor_to_world' if turned else 'world_to_sensor'}` {_WAY_OUT}"
            )
        if as_read > _ALIKE and not 0.1 < ratio < 10:
            raise self.wrong_rates(unit, f"gyr turns {ratio:.3g} times as fast as the file's own quaternions")
        if as_read > _SURELY_ALIKE and not _MIN_RATIO < ratio < 1 / _MIN_RATIO:
            self.warnings.append(
                f"gyr turns {ratio:.3g} times as fast as the file's own quaternions: is the rate of {rate_hz:.4g} Hz "
                "right?"
            )
        if as_read < 0.3:
            self.warnings.append(
                f"gyr and the rate of the file's own quaternions correlate at {as_read:.2f}: are they of one sensor?"
            )

    def wrong_rates(self, unit: str, found: str) -> SourceError:
        """Return an error about the unit of angular velocities that suggests the unit to try."""
        other = "deg/s" if unit == "rad/s" else "rad/s"
        return self.error(f"{found}; its unit is taken as {unit}: state `units: {{gyr: {other}}}` {_WAY_OUT}")

    def world(self, orientation: F64, acc: F64 | None, mag: F64 | None) -> tuple[str, bool]:
        """Return the world of the orientations, and whether it is assumed.

        The user's statement takes precedence over gravity and the magnetic field, and these over the file's header.
        """
        stated = self.set.entries.frame
        user, header = _WORLDS.get(stated or ""), self.raw.frame
        shown = _shown_world(orientation, acc, mag)
        self.check_upright(orientation, acc)
        found = user or shown or header or NWU
        if shown is not None and (user or header) not in (shown, "", None):
            source = "the file of sensors" if user else "the header"
            self.warnings.append(
                f"{source} states orientations in {user or header}, and the mean of the field lies as in {shown}; "
                f"{found} is used"
            )
        return found, not (user or shown or (header and not self.raw.frame_assumed))

    def check_upright(self, orientation: F64, acc: F64 | None) -> None:
        """Add a warning about orientations in which gravity is not vertical."""
        if acc is None:
            return
        mean = _median_up(orientation, acc)
        size = float(np.linalg.norm(mean))
        if size > 0 and abs(mean[2]) < 0.8 * size:
            tilt = np.degrees(np.arccos(abs(mean[2]) / size))
            self.warnings.append(
                f"gravity is {tilt:.0f}° off the vertical of the file's own orientations; do they turn from the sensor "
                "to the world, with Z up?"
            )

    def turned(
        self, acc: F64 | None, gyr: F64 | None, mag: F64 | None, orientation: F64 | None
    ) -> tuple[F64 | None, F64 | None, F64 | None, F64 | None]:
        """Rotate acc, gyr, mag and orientation to the sensor axes that the user states; None stays None."""
        matrix = self.set.matrix()
        if matrix is None:
            return acc, gyr, mag, orientation
        acc, gyr, mag = (None if part is None else part @ matrix.T for part in (acc, gyr, mag))
        if orientation is not None:
            orientation = multiply(orientation, from_matrix(matrix.T))
        return acc, gyr, mag, orientation


def _gravity_sizes(times: F64, acc: F64, gyr: F64 | None, orientation: F64 | None) -> list[float]:
    """Return estimates of gravity's magnitude: the median, the mean in world axes, and the median at rest."""
    sizes = [readings.typical_length(acc)]
    if orientation is not None:
        mean = np.ma.masked_invalid(rotate(orientation, acc)).mean(axis=0).filled(np.nan)
        sizes.append(float(np.linalg.norm(mean)))
    if gyr is not None:
        sizes.append(readings.typical_length(acc[np.linalg.norm(gyr, axis=1) < _STILL_RAD_S]))
    return [size for size in sizes if np.isfinite(size)]


def _fits(size: float) -> bool:
    return bool(abs(size / GRAVITY - 1) <= OFF_GRAVITY)


def _median_up(orientation: F64, acc: F64) -> F64:
    """Return the median (3,) of the accelerations in world axes; zeros if none is known."""
    found = rotate(orientation, acc)
    known = np.isfinite(found).all(axis=1)
    return np.median(found[known], axis=0) if known.any() else np.zeros(3)


def _first_beyond(values: F64) -> int | None:
    """Return the first sample with an implausible number, None if there is none; NaN is ignored."""
    beyond = np.flatnonzero((np.abs(values) > LARGEST).any(axis=1))
    return int(beyond[0]) if len(beyond) else None


def _shown_world(orientation: F64, acc: F64 | None, mag: F64 | None) -> str | None:
    """Return the world axes that gravity and the magnetic field imply; None if they imply none."""
    if acc is not None and _median_up(orientation, acc)[2] < -0.5 * GRAVITY:
        return NED
    found = field_axis(orientation, mag) if mag is not None else ""
    return found if found in (NWU, ENU) else None


def _measured_rate(times: F64) -> float | None:
    """Return samples per second from times with gaps or jitter; None for a single sample.

    The median step of a regular clock is its period, even if samples are lost. If samples at the median step would be
    more than one and a half times as many as there are between long gaps, the times jitter or come in bursts, and the
    mean step is used instead.
    """
    steps = np.diff(times)
    if not len(steps):
        return None
    step = float(np.median(steps))
    near = steps[steps <= max(LONGEST_GAP_S, _LONG_STEPS * float(steps.mean()))]
    if np.rint(near / step).sum() > _MAX_MISSING * len(near):
        return float(len(near) / near.sum())
    return float(np.rint(steps / step).sum() / (times[-1] - times[0]))


def _gaps(
    times: F64, rate_hz: float, parts: tuple[F64 | None, ...], mag: F64 | None
) -> tuple[tuple[float, float], ...]:
    """Return the intervals of more than 50 ms in which a channel is missing.

    Below 30 Hz, intervals must be longer than one and a half steps. The magnetic field is considered only if the sensor
    has no other channel.
    """
    known = np.ones(len(times), bool)
    present = [part for part in parts if part is not None] or [part for part in (mag,) if part is not None]
    for part in present:
        known &= np.isfinite(part).all(axis=1)
    at = times[known]
    if len(at) == 0:
        return ((float(times[0]), float(times[-1])),)
    at = np.concatenate([times[:1], at, times[-1:]])
    long = np.flatnonzero(np.diff(at) > max(LONGEST_GAP_S, 1.5 / rate_hz) * (1 + 1e-9))
    return tuple((float(at[i]), float(at[i + 1])) for i in long)
