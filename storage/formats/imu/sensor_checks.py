"""From the samples of a file to a sensor in SI units: units, axes, worlds, times, and what contradicts them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.catalog.sensorsets import FASTEST_HZ, SLOWEST_HZ
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.imu.signals import NWU, UNITS, Given, ImuSensor, RawSensor

F64 = npt.NDArray[np.float64]

LONGEST_GAP_S = 0.05
"""A longer interval without samples is a gap, in which nothing is interpolated."""

_DEFAULT_UNITS = {"acc": "m/s2", "gyr": "rad/s", "mag": "uT"}


def checked(path: Path, raw: RawSensor, given: Given) -> ImuSensor:
    """Return a sensor in SI units, with its orientation in F_GI.

    Raises
    ------
    SourceError
        The file contradicts itself.
    """
    chosen = given.sensor_set
    rate_hz, times = _times(path, raw, given.rate_hz or chosen.entries.rate_hz)
    parts: dict[str, F64 | None] = {}
    for name in ("acc", "gyr", "mag"):
        values = getattr(raw, name)
        unit = chosen.unit(name) or raw.units.get(name) or _DEFAULT_UNITS[name]
        parts[name] = None if values is None else values * UNITS[name][unit]
    gaps = tuple((float(times[i]), float(times[i + 1])) for i in np.flatnonzero(np.diff(times) > LONGEST_GAP_S))
    frame = NWU if raw.orientation is not None else ""
    return ImuSensor(
        raw.name, times, rate_hz, parts["acc"], parts["gyr"], parts["mag"], raw.orientation, frame, gaps,
        tuple(raw.warnings),
    )  # fmt: skip


def _times(path: Path, raw: RawSensor, given_hz: float | None) -> tuple[float, F64]:
    """Return samples per second and the time of every sample in seconds."""
    rate_hz = given_hz or raw.rate_hz
    if raw.times is None:
        if rate_hz is None:
            raise SourceError(path, "states no rate and no times; give rate_hz, samples per second")
        steps = np.arange(raw.samples) if raw.steps is None else raw.steps
        return rate_hz, steps / rate_hz
    back = np.flatnonzero(~(np.diff(raw.times) > 0))
    if len(back):
        row = int(back[0]) + 1
        raise SourceError(
            path, f"{raw.where(row)}time must ascend, got {raw.times[row]:.9g} s after {raw.times[row - 1]:.9g} s",
            line=raw.at(row),
        )  # fmt: skip
    if rate_hz is None:
        lengths = np.diff(raw.times)
        step = float(np.median(lengths)) if len(lengths) else 0.0
        counted = float(np.rint(lengths / step).sum()) if step > 0 else 0.0
        rate_hz = counted / float(raw.times[-1] - raw.times[0]) if counted else 0.0
    if not SLOWEST_HZ <= rate_hz <= FASTEST_HZ:
        raise SourceError(
            path, f"the times make {rate_hz:.3g} samples per second, and sensors have {SLOWEST_HZ:g} to "
            f"{FASTEST_HZ:g}; state the unit of times in a file of sensors, as `units: {{time: ms}}`",
        )  # fmt: skip
    return rate_hz, raw.times
