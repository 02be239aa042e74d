"""Read OpenSim motions (.mot, .sto): the coordinates of a model, whose joints are defined in its .osim file."""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from kinedex.ops.body import multibody
from kinedex.ops.errors import SourceError, did_you_mean
from kinedex.storage.formats.csv_tables import csv_cells
from kinedex.storage.formats.motion.body_models import model_digest
from kinedex.storage.formats.motion.osim import LARGEST, Model, read_osim
from kinedex.storage.formats.motion.points import Points, PointsReader
from kinedex.storage.formats.motion.position_tables import Section, first_lines
from kinedex.storage.formats.motion.reader import FASTEST_HZ, SLOWEST_HZ, MotionFile, ReadSettings
from kinedex.storage.formats.motion.skeleton_files import name_parts
from kinedex.storage.formats.source_files import beginning

F64 = npt.NDArray[np.float64]

_HEADER_LINES = 200
_BLOCK_FRAMES = 4096  # frames whose bodies are computed at once
_END = "endheader"
_FORCES = re.compile(r"(force|torque|moment|grf|emg|activation|fiber_length)|_?[vpm][xyz]$", re.IGNORECASE)
_VALUE = re.compile(r"(?:.*/)?([^/]+)/value$")

JOINT_OF_BODY = {
    "femur": "hip", "tibia": "knee", "talus": "ankle", "calcn": "heel", "toes": "mtp", "humerus": "shoulder",
    "ulna": "elbow", "hand": "wrist", "head": "head",
}  # fmt: skip
"""A dict from body of OpenSim's human models to the joint at its origin; other bodies are named by their joint."""


@dataclass(frozen=True)
class _Layout:
    """The header of a motion: its columns, their line, their separator, and the unit of angles."""

    columns: tuple[str, ...]
    line: int
    separator: str
    degrees: bool
    warnings: tuple[str, ...]

    def coordinates(self) -> dict[str, int]:
        """Return a dict from coordinate to column; OpenSim 4 writes them with the joint's path and /value."""
        whole = {name: i for i, name in enumerate(self.columns) if "/" not in name}
        return whole | {found[1]: i for i, name in enumerate(self.columns) if (found := _VALUE.fullmatch(name))}


class OpenSimReader(PointsReader):
    """Reads motions with the model beside them, or the one that `body_model` names."""

    title: ClassVar[str] = "OpenSim motion"
    endings: ClassVar[tuple[str, ...]] = (".mot", ".sto")
    beside: ClassVar[tuple[str, ...]] = (".osim",)
    up: ClassVar[str | None] = "y"

    def sniff(self, path: Path) -> bool:
        """Return whether a file has OpenSim's header, and columns that may be coordinates, not only forces."""
        head = beginning(path, 1 << 16)
        lines = head.splitlines()
        at = next((i for i, line in enumerate(lines) if line.strip(", \t").lower() == _END), None)
        if at is None or at + 1 >= len(lines) or re.search(r"(?m)^DataType\s*=\s*(?!double\b)", head):
            return False
        cells = re.split(r"[\t, ]+", lines[at + 1].strip())
        return cells[0].lower() == "time" and not all(_FORCES.search(cell) for cell in cells[1:] if cell)

    def relevant_settings(self, settings: ReadSettings) -> object:
        """Return the rates, the longest gap, and the model of the settings with size and time of its file."""
        return super().relevant_settings(settings), model_digest(_given(settings))

    def size(self, file: MotionFile) -> tuple[int, int, int]:
        """Return the number of rows, the number of points of a large model, and the memory in bytes for reading."""
        layout = _layout(file.path)
        table = Section(file.path, layout.separator, layout.line)
        return table.rows, 200, table.bytes + 40 * table.rows * len(layout.columns) + 1600 * _BLOCK_FRAMES * 100

    def points(self, file: MotionFile, settings: ReadSettings) -> Points:
        """Compute the centres of the joints, and the markers of the model, from the coordinates.

        Raises
        ------
        SourceError
            There is no model, it lacks the coordinates, or a file is damaged.
        """
        path, layout = file.path, _layout(file.path)
        if all(_FORCES.search(name) for name in layout.columns[1:]):
            raise SourceError(path, "holds forces or activations, no coordinates: it makes no motion", line=layout.line)
        model_path, model = model_of(path, layout, settings)
        warnings = [f"joints are placed by the model {model_path.name}", *layout.warnings]
        values, rate_hz = _values(path, layout, model, warnings)
        names, positions = _posed(path, model, values)
        return Points(str(path), names, positions, rate_hz, unit_m=1.0, warnings=warnings)


def _given(settings: ReadSettings) -> str | None:
    """Return the model of the settings if it is an OpenSim model, not a body model of AMASS; else None."""
    given = settings.body_model
    return given if given is not None and given.lower().endswith(".osim") else None


def model_of(path: Path, layout: _Layout, settings: ReadSettings) -> tuple[Path, Model]:
    """Return a motion's model, and its path: that of the settings, else the .osim file beside it.

    A name that has another number than the motion's, after the same words, is that of somebody else's model: it does
    not count. Of several files, the one that shares most words and numbers at the beginning of its name with the
    motion's counts, if it has coordinates of the motion; of files that share equally many, the one with the most
    coordinates of the motion.

    Raises
    ------
    SourceError
        There is no model, all are named after others, several go with the motion equally well, or a model is damaged.
    """
    given = _given(settings)
    if given is not None:
        return (chosen := Path(given).expanduser()), read_osim(chosen)
    beside = sorted(other for other in path.parent.iterdir() if other.suffix.lower() == ".osim" and other.is_file())
    found = [other for other in beside if not _is_of_another(path, other)]
    if beside and not found:
        raise SourceError(
            path, f"the models beside it are of others, by the numbers in their names: "
            f"{', '.join(other.name for other in beside)}; if one is its own, give it by `body_model`, or --body-model",
        )  # fmt: skip
    shared = [_shared_parts(path, other) for other in found]
    best = [other for other, length in zip(found, shared, strict=True) if length == max(shared)]
    if best:
        there = layout.coordinates().keys()
        models = {other: read_osim(other) for other in best}
        if len(found) > len(best) and not any(_held(model, there) for model in models.values()):
            models = {other: read_osim(other) for other in found}
        counts = {other: _held(model, there) for other, model in models.items()}
        most = [other for other, count in counts.items() if count == max(counts.values())]
        if len(most) == 1:
            return most[0], models[most[0]]
        names = ", ".join(other.name for other in most)
        raise SourceError(
            path, f"several models lie beside it, and neither its name nor its coordinates, of which each has "
            f"{counts[most[0]]}, tell which is its own: {names}; give one by `body_model`, or --body-model",
        )  # fmt: skip
    raise SourceError(
        path,
        f"holds the coordinates of an OpenSim model ({', '.join(layout.columns[1:4])}, …), which alone has the joints: "
        "put its .osim file beside it, or give it by `body_model`, or --body-model",
    )


def _shared_parts(motion: Path, model: Path) -> int:
    """Return the number of words and numbers with which the names of a motion and of a model both begin."""
    pairs = zip(name_parts(motion.stem), name_parts(model.stem), strict=False)
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], pairs))


def _is_of_another(motion: Path, model: Path) -> bool:
    """Return whether the names of a motion and of a model differ first by a number: subject02 is not subject01."""
    parts, shared = (name_parts(motion.stem), name_parts(model.stem)), _shared_parts(motion, model)
    return all(len(those) > shared and those[shared].isdigit() for those in parts)


def _held(model: Model, there: Collection[str]) -> int:
    """Return the number of a model's coordinates that a motion holds."""
    return sum(coordinate.name in there for coordinate in model.coordinates)


def _layout(path: Path) -> _Layout:
    lines = first_lines(path, _HEADER_LINES)
    at = next((i for i, line in enumerate(lines) if line.strip(", \t").lower() == _END), None)
    if at is None or at + 1 >= len(lines):
        raise SourceError(path, f"expected the header of an OpenSim motion, which ends with '{_END}'", line=1)
    separator = "," if "," in lines[at + 1] and "\t" not in lines[at + 1] else "\t"
    found = csv_cells(lines[at + 1], separator) if separator in lines[at + 1] else lines[at + 1].split()
    columns = [cell.strip() for cell in found]
    while columns and not columns[-1]:
        columns.pop()
    if not columns or columns[0].lower() != "time" or len(columns) < 2:
        raise SourceError(path, "expected a line with 'time' and the names of coordinates", line=at + 2)
    twice = next((name for i, name in enumerate(columns) if name in columns[:i]), None)
    if twice is not None:
        raise SourceError(path, f"two columns are named '{twice}'", line=at + 2)
    stated = re.search(r"(?im)^\s*indegrees\s*=\s*(yes|no|true|false|1|0)\b", "\n".join(lines[:at]))
    warnings = () if stated else ("its header does not state inDegrees; its angles are taken for degrees",)
    degrees = stated is None or stated[1].lower() in ("yes", "true", "1")
    return _Layout(tuple(columns), at + 2, separator, degrees, warnings)


def _values(path: Path, layout: _Layout, model: Model, warnings: list[str]) -> tuple[F64, float]:
    """Return the coordinates (Q, T) of a model in radians and metres, at a constant rate, and that rate."""
    there = layout.coordinates()
    names = [coordinate.name for coordinate in model.coordinates]
    known = [name for name in names if name in there]
    if not known:
        near = did_you_mean(layout.columns[1], names)
        raise SourceError(
            path, f"has none of the coordinates of the model '{model.name}'{near}; it holds those of another model, or "
            "forces, which make no motion", line=layout.line,
        )  # fmt: skip
    columns = [0, *(there[name] for name in known)]
    numbers = Section(path, layout.separator, layout.line).points(layout.columns, (0, 0, 0), columns)[1]
    times, rate_hz = numbers[0], 0.0
    for place, found in zip(columns, numbers, strict=True):
        bad = ~(np.abs(found) <= LARGEST)
        if bad.any():  # a joint without an angle has no position
            raise SourceError(
                path, f"column '{layout.columns[place]}' has no number within {LARGEST:g} in frame "
                f"{int(np.argmax(bad))}", line=layout.line,
            )  # fmt: skip
    if len(times) > 1 and (np.diff(times) > 0).all():
        rate_hz = (len(times) - 1) / float(times[-1] - times[0])
    if not SLOWEST_HZ <= rate_hz <= FASTEST_HZ:
        raise SourceError(
            path, f"expected at least two frames whose times ascend, at {SLOWEST_HZ:g} to {FASTEST_HZ:g} Hz",
            line=layout.line + 1,
        )  # fmt: skip
    even = np.linspace(times[0], times[-1], len(times))
    uneven = float(np.abs(times - even).max()) * rate_hz > 0.1
    if uneven:
        warnings.append(f"its times are not even; it is read between them, at {rate_hz:.6g} Hz")
    values = np.empty((len(names), len(times)))
    for i, coordinate in enumerate(model.coordinates):
        values[i] = coordinate.default
        if coordinate.name in there:
            column = numbers[1 + known.index(coordinate.name)]
            column = np.interp(even, times, column) if uneven else column
            values[i] = np.deg2rad(column) if layout.degrees and coordinate.turns else column
    for i, coupling in model.couplings.items():
        if names[i] not in there:
            values[i] = coupling.function(values[list(coupling.of)])
    lacking = [name for i, name in enumerate(names) if name not in there and i not in model.couplings]
    if lacking:
        more = f" and {len(lacking) - 6} more" if len(lacking) > 6 else ""
        warnings.append(f"coordinates that it lacks stay as in the model: {', '.join(lacking[:6])}{more}")
    return values, rate_hz


def _posed(path: Path, model: Model, values: F64) -> tuple[tuple[str, ...], F64]:
    """Return names and positions (N, 3, T) of the centres of the joints and of the markers."""
    centres = {_name(model, i): (i, joint.in_child.origin) for i, joint in enumerate(model.joints) if joint.parent >= 0}
    stations = centres | {name: at for name, at in model.markers.items() if name not in centres}
    positions = np.empty((len(stations), 3, values.shape[1]))
    for start in range(0, values.shape[1], _BLOCK_FRAMES):
        part = slice(start, start + _BLOCK_FRAMES)
        with np.errstate(over="ignore", invalid="ignore"):  # implausible numbers are refused later, by their positions
            rotations, origins = multibody.forward(model.joints, values[:, part])
            for station, (body, place) in enumerate(stations.values()):
                positions[station, :, part] = (origins[body] + rotations[body] @ place).T
    far = ~(np.abs(positions) <= LARGEST).all(axis=(1, 2))
    if far.any():
        raise SourceError(
            path, f"places '{list(stations)[int(np.argmax(far))]}' of the model '{model.name}' too far away"
        )
    return tuple(stations), positions


def _name(model: Model, joint: int) -> str:
    """Return the name of a joint's centre: the usual one of its body (hip_r of femur_r), or the joint's own."""
    body = model.bodies[joint]
    stem, mark, side = body.rpartition("_")
    stem, side = (stem, f"_{side}") if mark and side.lower() in ("r", "l") else (body, "")
    return JOINT_OF_BODY[stem.lower()] + side.lower() if stem.lower() in JOINT_OF_BODY else model.names[joint]
