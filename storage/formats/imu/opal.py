"""Read CSV exports of Opal (APDM) in two layouts: with lines of names and of units, or beginning with `Format=7`.

The first layout has a line `Sample Rate:,128,Hz`, names such as `Label/Acceleration/X`, and units below the names; its
times are seconds. The second has a line with number and label of each sensor, then lines with the quantities and axes
of the columns; its times are microseconds. In both, quaternions rotate from the sensor to F_GI.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from kinedex.ops.errors import SourceError
from kinedex.storage.formats.imu.number_rows import cells_of, number_rows, text_lines
from kinedex.storage.formats.imu.signals import NWU, UNITS, RawSensor, UserStatements, unit_name
from kinedex.storage.formats.imu.tables import MAX_SENSORS
from kinedex.storage.formats.source_files import as_number

_RATE = re.compile(r"Sample Rate:?[,;\t ]+([0-9.]+)", re.IGNORECASE)
_QUANTITIES = {
    "Acceleration": "acc", "Angular Velocity": "gyr", "Magnetic Field": "mag", "Orientation": "orientation",
    "Accelerometer": "acc", "Gyroscope": "gyr", "Magnetometer": "mag",
}  # fmt: skip
_AXES = {"acc": "XYZ", "gyr": "XYZ", "mag": "XYZ", "orientation": "SXYZ"}
_UNITS = {"acc": "m/s2", "gyr": "rad/s", "mag": "uT"}
_MAX_SETTINGS = 20


def recognises(path: Path, head: bytes) -> bool:
    """Return True for a file that begins with the header of either layout."""
    head = head.lstrip(b"\xef\xbb\xbf")
    return (
        re.match(rb'"?Format=\d+\s*,', head) is not None
        or re.search(rb"/Acceleration/X|/Orientation/S", head) is not None
    )


def read(path: Path, given: UserStatements) -> list[RawSensor]:
    """Read the sensors of a file.

    Raises
    ------
    SourceError
        The file is damaged; the message names line and column.
    """
    lines = text_lines(path)
    return _numbered(path, lines) if lines[0].strip('\ufeff" ').startswith("Format=") else _named(path, lines)


def _named(path: Path, lines: Sequence[str]) -> list[RawSensor]:
    first = next((i for i, line in enumerate(lines[:_MAX_SETTINGS]) if re.match(r'"?Time"?,', line)), None)
    if first is None:
        raise SourceError(path, "has no line with the names of its columns, which begins with Time")
    rate = next((found for line in lines[:first] if (found := _RATE.match(line))), None)
    header = cells_of(lines[first], ",")
    below = cells_of(lines[first + 1], ",") if len(lines) > first + 1 else []
    columns: dict[str, dict[str, dict[str, int]]] = {}
    units: dict[str, str] = {}
    for place, name in enumerate(header):
        label, _, rest = name.partition("/")
        quantity, _, axis = rest.partition("/")
        if quantity in _QUANTITIES:
            channel = _QUANTITIES[quantity]
            axes = columns.setdefault(label, {}).setdefault(channel, {})
            axis = "S" if axis == "Scalar" else axis
            if axis in axes:
                raise SourceError(path, f"has the column '{name}' twice; remove one", line=first + 1)
            axes[axis] = place
            stated = unit_name(below[place], channel) if channel in UNITS and place < len(below) else ""
            if stated is None:
                raise SourceError(path, f"column '{name}' has the unit {below[place][:30]!r}, unknown", line=first + 2)
            if stated:
                units[channel] = stated
    tick = unit_name(below[0], "time") if below else None
    body = first + 1 if tick is None else first + 2
    return _sensors(
        path, lines, header, body, columns, UNITS["time"][tick or "s"], _UNITS | units, rate and as_number(rate[1])
    )


def _numbered(path: Path, lines: Sequence[str]) -> list[RawSensor]:
    if len(lines) < 4:
        raise SourceError(path, "has three lines of header and no rows")
    above, quantities, axes = (cells_of(line, ",") for line in lines[:3])
    columns: dict[str, dict[str, dict[str, int]]] = {}
    label, quantity = "", ""
    for place, name in enumerate(quantities):
        quantity = name or quantity
        if name == "Accelerometer":
            number, *_ = [*above[place : place + 1], ""]
            named = next((cell for cell in above[place + 1 : place + 4] if cell), "")
            label = named or number or f"sensor {len(columns) + 1}"
            label = f"{label} {number}".strip() if label in columns else label
            if label in columns:
                raise SourceError(path, f"has the sensor '{label}' twice", line=1)
            columns[label] = {}
        if label and quantity in _QUANTITIES and place < len(axes):
            columns[label].setdefault(_QUANTITIES[quantity], {})[axes[place].upper()] = place
    header = [f"{name} {axis}".strip() for name, axis in zip(quantities, axes, strict=False)]
    return _sensors(path, lines, header, 3, columns, 1e-6, dict(_UNITS), None)


def _sensors(
    path: Path, lines: Sequence[str], header: Sequence[str], body: int,
    columns: dict[str, dict[str, dict[str, int]]], tick_s: float, units: dict[str, str], rate_hz: float | None,
) -> list[RawSensor]:  # fmt: skip
    """Return the sensors of a table, given the column of every axis of their channels."""
    if not columns or len(columns) > MAX_SENSORS:
        raise SourceError(path, f"must have the columns of 1 to {MAX_SENSORS} sensors, got {len(columns)}")
    places: dict[str, dict[str, list[int]]] = {}
    for label, channels in columns.items():
        for channel, axes in channels.items():
            lacking = [axis for axis in _AXES[channel] if axis not in axes]
            if lacking:
                raise SourceError(path, f"sensor '{label}' lacks {channel} {', '.join(lacking)}; export all axes")
            places.setdefault(label, {})[channel] = [axes[axis] for axis in _AXES[channel]]
    wanted = [0, *(place for channels in places.values() for found in channels.values() for place in found)]
    rows = number_rows(path, lines, body, ",", header, wanted)
    at = {place: i for i, place in enumerate(wanted)}
    times = rows.numbers[:, 0] * tick_s
    found = []
    for label, wide in places.items():
        sensor = RawSensor(label, times=times, units=dict(units), frame=NWU, lines=rows.lines, rate_hz=rate_hz)
        sensor.absolute = tick_s != 1.0
        for channel, listed in wide.items():
            values = rows.numbers[:, np.array([at[place] for place in listed])]
            setattr(sensor, channel, None if np.isnan(values).all() else values)
        found.append(sensor)
    return found
