"""Read CSV files of Xsens DOT (Movella DOT): one sensor per file, lines of settings, then named columns.

The format is taken from the manual, without a sample file. The settings are `sep=,`, `DeviceTag:,…` and
`OutputRate:,60Hz`. The columns are PacketCounter, SampleTimeFine (µs, which wraps at 2³²), Quat_W … or Euler_X …,
FreeAcc_X … or Acc_X …, Gyr_X … (degrees/s) and Mag_X … Free accelerations have no gravity and are not read. Settings
may be missing; only the names of the columns are required.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from kinedex.ops.errors import SourceError
from kinedex.storage.formats.imu.number_rows import separator_of, text_lines
from kinedex.storage.formats.imu.signals import ENU, RawSensor, UserStatements
from kinedex.storage.formats.imu.xsens_columns import CHANNELS, PACKETS, named_columns, unwrapped
from kinedex.storage.formats.source_files import as_number

_CLOCK, _COUNTER = "SampleTimeFine", "PacketCounter"
_WRAP = 1 << 32
_TICK_S = 1e-6
_SETTING = re.compile(r'"?(?P<key>[A-Za-z ]{1,40}):?"?[,;:\t] {0,9}"?(?P<value>[^,;\t"]{0,200})')
_MAX_SETTINGS = 60


def recognises(path: Path, head: bytes) -> bool:
    """Return True for a text with the columns PacketCounter and SampleTimeFine."""
    return b"SampleTimeFine" in head and b"PacketCounter" in head and not head.lstrip(b"\xef\xbb\xbf").startswith(b"//")


def read(path: Path, given: UserStatements) -> list[RawSensor]:
    """Read the sensor of a file.

    Raises
    ------
    SourceError
        The file is damaged; the message names line and column.
    """
    lines = text_lines(path)
    first = next((i for i, line in enumerate(lines[:_MAX_SETTINGS]) if _CLOCK in line), None)
    if first is None:
        raise SourceError(path, f"has no line with the names of its columns, such as PacketCounter,{_CLOCK}")
    settings = {}
    for line in lines[:first]:
        if found := _SETTING.match(line):
            settings[found["key"].replace(" ", "").lower()] = found["value"].strip()
    table = named_columns(path, lines, first, separator_of(lines[first]))
    sensor = RawSensor(settings.get("devicetag") or path.stem, lines=table.rows.lines)
    sensor.units, sensor.frame = {"acc": "m/s2", "gyr": "deg/s", "mag": "1"}, ENU
    sensor.frame_assumed = True
    for channel, names in CHANNELS.items():
        setattr(sensor, channel, table.channel(names))
    sensor.orientation = table.orientation()
    rate = re.match(r"[0-9.]+", settings.get("outputrate", ""))
    sensor.rate_hz = None if rate is None else as_number(rate[0])
    clock = table.column(_CLOCK) if _CLOCK in table.indices else np.array([np.nan])
    if np.isfinite(clock).all():
        ticks = unwrapped(path, clock, table.rows.lines, _WRAP, _CLOCK)
        sensor.times, sensor.absolute = np.asarray(ticks * _TICK_S, np.float64), True
    elif _COUNTER in table.indices:
        sensor.steps = unwrapped(path, table.column(_COUNTER), table.rows.lines, PACKETS, _COUNTER)
    return [sensor]
