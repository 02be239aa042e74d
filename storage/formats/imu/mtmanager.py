"""Read text exports of Xsens MT Manager: one sensor per file, a header of comments, then named columns.

Columns are separated by tabs, commas, semicolons or single blanks, and cells can be empty. Orientations are quaternions
(Quat_q0 … or Quat_w …), matrices (Mat[row][column]) or Euler angles (Roll, Pitch, Yaw in degrees, of Rz·Ry·Rx). Samples
are counted by PacketCounter, which wraps at 65,536 according to the manual; no sample file shows the wrap.
"""

from __future__ import annotations

import re
from pathlib import Path

from kinedex.ops.errors import SourceError
from kinedex.storage.formats.imu.number_rows import separator_of, text_lines
from kinedex.storage.formats.imu.signals import ENU, NED, NWU, RawSensor, UserStatements
from kinedex.storage.formats.imu.xsens_columns import CHANNELS, COUNTERS, PACKETS, named_columns, unwrapped
from kinedex.storage.formats.source_files import as_number

_RATE = re.compile(r"//\s*(?:Update Rate|Sample rate)\s*:\s*([0-9.]+)\s*Hz", re.IGNORECASE)
_DEVICE = re.compile(r"//\s*DeviceId\s*:\s*(\w+)")
_WORLD = re.compile(r"//\s*Coordinate system\s*:\s*(\w+)", re.IGNORECASE)
_NUMBERED = re.compile(r".*_([0-9A-F]{8})", re.IGNORECASE)
_WORLDS = {"ENU": ENU, "NWU": NWU, "NED": NED}


def recognises(path: Path, head: bytes) -> bool:
    """Return True for a text with a header of comments and a counter among its columns."""
    return head.lstrip(b"\xef\xbb\xbf").startswith(b"//") and re.search(rb"^(Packet)?Counter\b", head, re.M) is not None


def session_of(path: str, head: bytes) -> str:
    """Return the path of a file without the sensor number at its end; all files of a session share this path."""
    device = _DEVICE.search(head.decode("latin-1"))
    number = re.escape(device[1]) if device else "[0-9A-Fa-f]{8}"
    return re.sub(rf"[-_]{number}\.[^./]+$", "", path)


def read(path: Path, given: UserStatements) -> list[RawSensor]:
    """Read the sensor of a file.

    Raises
    ------
    SourceError
        The file is damaged; the message names line and column.
    """
    lines = text_lines(path)
    first = next((i for i, line in enumerate(lines) if line.strip() and not line.startswith("//")), None)
    if first is None:
        raise SourceError(path, "has no line with the names of its columns")
    head = "\n".join(lines[:first])
    separator = separator_of(lines[first])
    table = named_columns(path, lines, first, separator)
    device, rate, world = _DEVICE.search(head), _RATE.search(head), _WORLD.search(head)
    numbered = _NUMBERED.fullmatch(path.stem)
    sensor = RawSensor(device[1] if device else numbered[1] if numbered else path.stem, lines=table.rows.lines)
    sensor.rate_hz = None if rate is None else as_number(rate[1])
    if rate and sensor.rate_hz is None:
        raise SourceError(path, f"Update Rate must be samples per second, got {rate[1][:40]!r}")
    sensor.units = {"acc": "m/s2", "gyr": "rad/s", "mag": "1"}
    sensor.frame = _WORLDS.get(world[1].upper(), "") if world else NWU
    for channel, names in CHANNELS.items():
        setattr(sensor, channel, table.channel(names))
    sensor.orientation = table.orientation()
    counter = next((name for name in COUNTERS if name in table.indices), None)
    if counter is not None:
        sensor.steps = unwrapped(path, table.column(counter), table.rows.lines, PACKETS, counter)
        sensor.wrap = PACKETS
    return [sensor]
