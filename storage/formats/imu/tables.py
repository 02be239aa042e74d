"""Read tables of sensor data by the names of their columns: CSV with one or more header rows, Parquet and HDF5.

The column names of kinedex and common variants are known: `acc_x`, `accel x`, `gyro.y`, `Magnetometer Z (uT)`, `q_w`,
`quat_x`, `q0`, with the name of the sensor before them if there are several sensors (`left_sensor/acc_x`), and
`time_s`, `time (ms)`, `t`. Other names must be declared in a file of sensors (`columns:`).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from kinedex.catalog.sensorsets import Columns
from kinedex.ops.errors import SourceError, did_you_mean
from kinedex.storage.formats.csv_tables import decoded
from kinedex.storage.formats.imu.number_rows import cells_of, number_rows, separator_of, text_lines
from kinedex.storage.formats.imu.signals import UNITS, RawSensor, UserStatements, unit_name
from kinedex.storage.formats.source_files import as_number

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]

MAX_SENSORS = 1_000
"""The largest number of sensors in a file."""

MAX_ROWS = 50_000_000
"""The largest number of rows in a table."""

_MAX_HEADER_ROWS = 6
_LONGEST_NAME = 200
_HEAD = 1 << 16
_WORDS = {
    "acc": "accelerometer|acceleration|accelero|accel|acc",
    "gyr": "gyroscope|angular ?velocity|angularvelocity|gyro|gyr",
    "mag": "magnetometer|magnetic ?field|magneticfield|magneto|mag",
    "orientation": "orientation|quaternion|quat|q",
}
_CHANNEL = re.compile(
    r"(?:(?P<sensor>.*?)[\s/._:-]+)??(?:"
    + "|".join(f"(?P<{channel}>{words})" for channel, words in _WORDS.items())
    + r")[\s/._:-]*(?P<axis>[wxyz0-3]|element)[\s/._:-]*(?P<unit>[(\[].*[)\]])?",
    re.IGNORECASE,
)
_TIME = re.compile(r"(?:time|timestamp|t)(?:[\s_]?(?P<unit>s|ms|us|µs|ns|sec|seconds|[(\[].*[)\]]))?", re.IGNORECASE)
_OTHERS = ("free", "lin", "linear", "user", "global", "world")
"""Words before the name of a channel that mark a derived quantity, not a reading of the sensor."""

_AXES = {"acc": "xyz", "gyr": "xyz", "mag": "xyz", "orientation": "wxyz"}


@dataclass
class Layout:
    """The columns of a table that are used.

    Attributes
    ----------
    channels : dict of str to dict
        Sensor ("" if there is only one) → channel → its columns, in the order of the axes.
    time, sensor : int or None
        The columns of times and of sensors' names.
    units : dict of str to dict
        Sensor → quantity → unit, as the header states it.
    time_unit : str
        The unit of times; empty where the header does not state it.
    """

    channels: dict[str, dict[str, list[int]]] = field(default_factory=dict)
    time: int | None = None
    sensor: int | None = None
    units: dict[str, dict[str, str]] = field(default_factory=dict)
    time_unit: str = ""

    def columns(self) -> list[int]:
        """Return the columns of numbers: those of the channels in order, then that of times."""
        found = [place for parts in self.channels.values() for places in parts.values() for place in places]
        return found + ([] if self.time is None else [self.time])


def recognises(path: Path, head: bytes) -> bool:
    """Return True for a table, judged by its extension or its first bytes."""
    return path.suffix.lower() in (".csv", ".txt", ".tsv", ".parquet") or head.startswith(b"PAR1")


def has_readings(path: Path, wanted: Iterable[str] = ("acc", "gyr")) -> bool:
    """Return whether a table has columns with known names for at least one of the given channels."""
    try:
        if _is_parquet(path):
            with pq.ParquetFile(path) as file:
                header = file.schema_arrow.empty_table().flatten().column_names
        else:
            with path.open("rb") as text:
                lines = decoded(path, text.read(_HEAD)).replace("\r", "\n").split("\n")
            header, _ = _joined(_header_rows(path, lines, UserStatements())[0])
    except (SourceError, OSError, pa.ArrowException):
        return False
    try:
        channels = _known(path, header).channels.values()
    except SourceError:
        return True  # some axes are missing: `read` reports which
    return any(channel in parts for parts in channels for channel in wanted)


def _is_parquet(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(4) == b"PAR1" or path.suffix.lower() == ".parquet"


def read(path: Path, given: UserStatements) -> list[RawSensor]:
    """Read the sensors of a table.

    Raises
    ------
    SourceError
        The file is not such a table; the message names the line or the column.
    """
    return _parquet(path, given) if _is_parquet(path) else _csv(path, given)


def layout_of(path: Path, header: Sequence[str], given: UserStatements) -> Layout:
    """Return the columns that are used: those with known names, or those that the file of sensors declares.

    Raises
    ------
    SourceError
        There is no known column, or a channel lacks an axis.
    """
    columns = given.sensor_set.entries.columns
    layout = _known(path, header) if columns is None else _named(path, header, columns)
    if not layout.channels:
        raise SourceError(
            path, "has no columns of a sensor; expected acc_x, acc_y, acc_z, gyr_x … or `columns:` in a file of "
            f"sensors, got {', '.join(header[:12])[:300]}",
        )  # fmt: skip
    if len(layout.channels) > MAX_SENSORS:
        raise SourceError(path, f"has {len(layout.channels)} sensors, and {MAX_SENSORS} are read at most")
    return layout


def _known(path: Path, header: Sequence[str]) -> Layout:
    """Return the columns that have known names."""
    layout, found = Layout(), dict[tuple[str, str], dict[str, int]]()
    for place, name in enumerate(header):
        plain = name.strip()
        if len(plain) > _LONGEST_NAME:
            continue
        if plain.lower() in ("sensor", "sensor_id", "sensor_name", "device") and layout.sensor is None:
            layout.sensor = place
        elif layout.time is None and (time := _TIME.fullmatch(plain)):
            layout.time = place
            layout.time_unit = unit_name(time["unit"] or "", "time") or ""
        elif (column := _column(path, plain)) is not None:
            sensor, channel, axis, unit = column
            if axis in found.setdefault((sensor, channel), {}):
                raise SourceError(path, f"has two columns for {channel} {axis} of one sensor: see '{plain}'")
            found[sensor, channel][axis] = place
            if unit:
                layout.units.setdefault(sensor, {})[channel] = unit
    for (sensor, channel), axes in found.items():
        missing = [axis for axis in _AXES[channel] if axis not in axes]
        if missing:
            have = ", ".join(f"'{header[place]}'" for place in axes.values())
            raise SourceError(path, f"has {have} and lacks {channel} {', '.join(missing)}")
        layout.channels.setdefault(sensor, {})[channel] = [axes[axis] for axis in _AXES[channel]]
    return layout


def _column(path: Path, name: str) -> tuple[str, str, str, str] | None:
    """Return sensor, channel, axis and unit of a column by its name; None if it is not a sensor's column."""
    match = _CHANNEL.fullmatch(name)
    if match is None or (match["sensor"] or "").lower() in _OTHERS:
        return None
    channel = next(key for key in _WORDS if match[key])
    axis, unit = match["axis"].lower(), ""
    if channel == "orientation" and axis in "0123":
        axis = "wxyz"[int(axis)]
    elif channel != "orientation" and match["unit"]:
        stated = unit_name(match["unit"], channel)
        if stated is None:
            raise SourceError(
                path, f"column '{name}' has a unit that is unknown; known: {', '.join(UNITS[channel])}; rename the "
                "column, and state its unit in a file of sensors",
            )  # fmt: skip
        unit = stated
    return (match["sensor"] or "", channel, axis, unit) if axis in _AXES[channel] else None


def _named(path: Path, header: Sequence[str], columns: Columns) -> Layout:
    """Return the columns that a file of sensors declares."""
    places = {name.strip(): place for place, name in reversed(list(enumerate(header)))}

    def place(name: str, key: str) -> int:
        if name not in places:
            raise SourceError(path, f"has no column '{name}' (columns.{key}){did_you_mean(name, places)}")
        return places[name]

    layout = Layout()
    layout.time = None if columns.time is None else place(columns.time, "time")
    layout.sensor = None if columns.sensor is None else place(columns.sensor, "sensor")
    for channel, axes in _AXES.items():
        names = columns.names(channel)
        if not names:
            continue
        if len(names) == 1:  # one data set or structure that has a column for each axis
            joint = next((sep for sep in "/._" if any(name.endswith(f"{sep}{axes[0]}") for name in places)), "/")
            names = tuple(f"{names[0]}{joint}{axis}" for axis in axes)
        for sensor in _sensors(names[0], places):
            found = [place(name.replace("{sensor}", sensor), channel) for name in names]
            layout.channels.setdefault(sensor, {})[channel] = found
    return layout


def _sensors(pattern: str, names: Iterable[str]) -> list[str]:
    """Return the values of {sensor} in the names that match a pattern, in order; "" for a pattern without {sensor}."""
    if "{sensor}" not in pattern:
        return [""]
    before, _, after = pattern.partition("{sensor}")
    wanted = re.compile(re.escape(before) + "(.+?)" + re.escape(after))
    return list(dict.fromkeys(match[1] for name in names if (match := wanted.fullmatch(name))))


def _csv(path: Path, given: UserStatements) -> list[RawSensor]:
    lines = text_lines(path)
    rows, body, separator = _header_rows(path, lines, given)
    header, units = _joined(rows)
    layout = layout_of(path, header, given)
    for sensor, parts in layout.channels.items():
        for channel, places in parts.items():
            if channel != "orientation" and (unit := unit_name(units[places[0]], channel)):
                layout.units.setdefault(sensor, {})[channel] = unit
    if layout.time is not None and (unit := unit_name(units[layout.time], "time")):
        layout.time_unit = unit
    wanted = layout.columns()
    texts = [] if layout.sensor is None else [layout.sensor]
    table = number_rows(path, lines, body, separator, header, wanted, texts)
    columns = dict(zip(wanted, table.numbers.T, strict=True))
    return sensors_of(path, layout, given, columns, table.texts[0] if texts else None, table.lines)


def _header_rows(path: Path, lines: Sequence[str], given: UserStatements) -> tuple[list[list[str]], int, str]:
    """Return the cells of the rows before the numbers, the index of the first row of numbers, and the separator."""
    wanted = given.sensor_set.entries.header_rows
    rows: list[list[str]] = []
    separator = ""
    for i, line in enumerate(lines):
        if not line.strip() or (not rows and re.fullmatch(r"sep=.", line.strip(), re.IGNORECASE)):
            continue
        separator = separator or separator_of(line)
        cells = cells_of(line, separator)
        if len(rows) == wanted or (wanted is None and _numeric(cells, separator)):
            break
        rows.append(cells)
        if len(rows) > _MAX_HEADER_ROWS and wanted is None:
            raise SourceError(
                path, f"has no row of numbers in its first {len(rows)} rows; state `header_rows:` in a file of sensors "
                "if these are names of columns", line=i + 1,
            )  # fmt: skip
    else:
        raise SourceError(path, "has no rows of numbers")
    if not rows:
        raise SourceError(path, "has no header with the names of its columns, such as time_s,acc_x,acc_y,acc_z", line=1)
    return rows, i, separator


def _numeric(cells: Sequence[str], separator: str) -> bool:
    """Return True for a row in which at least half of the cells are numbers."""
    filled = [cell for cell in cells if cell]
    return 2 * sum(
        as_number(cell if separator == "," else cell.replace(",", ".")) is not None for cell in filled
    ) >= max(1, len(filled))


def _joined(rows: Sequence[Sequence[str]]) -> tuple[list[str], list[str]]:
    """Return the name of each column, which is its header rows joined by "/", and the unit of each column.

    Units are empty unless the last header row consists of units.
    """
    width = max(map(len, rows))
    padded = [[*row, *[""] * (width - len(row))] for row in rows]
    units = [""] * width
    if len(rows) > 1 and all(any(unit_name(cell, of) is not None for of in UNITS) for cell in padded[-1]):
        units = padded.pop()
    return ["/".join(cell for cell in column if cell) for column in zip(*padded, strict=True)], units


def _parquet(path: Path, given: UserStatements) -> list[RawSensor]:
    try:
        with pq.ParquetFile(path) as file:
            if file.metadata.num_rows > MAX_ROWS:
                raise SourceError(path, f"has {file.metadata.num_rows:,} rows, and {MAX_ROWS:,} are read at most")
            header = file.schema_arrow.empty_table().flatten().column_names
            layout = layout_of(path, header, given)
            places = [*layout.columns(), *([] if layout.sensor is None else [layout.sensor])]
            wanted = {header[i] for i in places} | {header[i].rpartition(".")[0] for i in places}
            tops = [name for name in file.schema_arrow.names if name in wanted]
            table = file.read(columns=tops).flatten()
            columns = {i: _numbers(path, table, header[i]) for i in layout.columns()}
            names = None
            if layout.sensor is not None:
                column = table.column(header[layout.sensor])
                names = ["" if name is None else str(name) for name in column.to_pylist()]
    except SourceError:
        raise
    except (OSError, pa.ArrowException, ValueError, TypeError, KeyError, IndexError) as fault:
        raise SourceError(path, f"cannot be read as Parquet: {str(fault)[:200]}") from None
    return sensors_of(path, layout, given, columns, names)


def _numbers(path: Path, table: pa.Table, name: str) -> F64:
    """Return a column as numbers; an empty cell becomes NaN."""
    column = table.column(name)
    kind = column.type
    if not (pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_null(kind)):
        raise SourceError(path, f"column '{name}' must hold numbers, got {kind}")
    column.validate(full=True)
    found: F64 = column.cast(pa.float64()).to_numpy()
    return found


def sensors_of(
    path: Path, layout: Layout, given: UserStatements, columns: Mapping[int, F64], names: Sequence[str] | None = None,
    lines: I64 | None = None,
) -> list[RawSensor]:  # fmt: skip
    """Return the sensors of a table.

    Parameters
    ----------
    path : Path
        The file.
    layout : Layout
        The columns that are used.
    given : UserStatements
        The user's statements about the file.
    columns : mapping of int to float64 array (rows,)
        The numbers of each column.
    names : sequence of str, optional
        The sensor of each row.
    lines : int64 array (rows,), optional
        The line of each row.

    Raises
    ------
    SourceError
        The table has both a column of sensor names and columns of several sensors, or a row without a sensor's name.
    """
    if names is not None and list(layout.channels) != [""]:
        raise SourceError(path, "has a column of sensors and also columns of several sensors; one of them is enough")
    unit = given.sensor_set.unit("time") or layout.time_unit or "s"
    times = None if layout.time is None else columns[layout.time] * UNITS["time"][unit]
    keys = list(layout.channels)
    chosen: dict[str, tuple[str, I64 | slice]] = {key or path.stem: (key, slice(None)) for key in keys}
    if names is not None:
        chosen = {name: ("", rows) for name, rows in _rows_by_name(path, names, lines).items()}
    found = []
    for name, (key, rows) in chosen.items():
        sensor = RawSensor(name, units=dict(layout.units.get(key, {})), times=None if times is None else times[rows])
        for channel, places in layout.channels[key].items():
            setattr(sensor, channel, np.stack([columns[place] for place in places], axis=1)[rows])
        sensor.lines = None if lines is None else lines[rows]
        found.append(sensor)
    return found


def _rows_by_name(path: Path, names: Sequence[str], lines: I64 | None) -> dict[str, I64]:
    """Return a dict from sensor name to row indices, in the order in which the names first occur."""
    rows: dict[str, list[int]] = {}
    if "" in names:
        row = names.index("")
        line = None if lines is None else int(lines[row])
        raise SourceError(path, f"row {row} (from 0) has no name in its column of sensors", line=line)
    for row, name in enumerate(names):
        rows.setdefault(name, []).append(row)
    if len(rows) > MAX_SENSORS:
        raise SourceError(path, f"has {len(rows)} sensors; divide it into files of at most {MAX_SENSORS}")
    return {name: np.array(places) for name, places in rows.items()}
