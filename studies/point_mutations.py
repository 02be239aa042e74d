"""Mutations of recordings of points, and writers of the formats that hold points, for `studies.mutations`."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.ops.errors import KinedexError
from kinedex.storage.formats.motion.c3d import parse_c3d
from kinedex.storage.formats.motion.points import Points
from kinedex.storage.formats.motion.positions import parse_trc
from tests.c3d_files import write_c3d
from tests.point_files import motive_csv, nexus_csv

FRAMES = 120
"""Frames of a recording, spread evenly over its motion."""

COMPUTED = re.compile(
    r".*(CentreOfMass|Angles|Moment|Force|Power)|[LR]?(PEL|TRX|HED|FE|TI|FO|TO|HU|RA|HN|CL|UP)[OALP]$"
)
"""The names that Plug-in Gait gives to results, with which no marker is exchanged."""

UNITS_M = {"mm": 0.001, "cm": 0.01, "dm": 0.1, "m": 1.0, "in": 0.0254, "ft": 0.3048}


@dataclass(frozen=True)
class Recording:
    """The points of a recording, as they are to be written.

    Attributes
    ----------
    name : str
        Its file.
    labels : tuple of str
        The N labels.
    positions : float64 array (N, 3, T)
        In metres, in the axes of the file.
    rate_hz : float
        Frames per second.
    up : str
        The vertical axis, "y" or "z".
    unit : str
        The unit in which numbers are written.
    stated_unit : str
        The unit that the header states; empty to state none.
    stated_hz : float, optional
        The rate that the header states, if it is another.
    """

    name: str
    labels: tuple[str, ...]
    positions: F64
    rate_hz: float
    up: str
    unit: str = "mm"
    stated_unit: str = "mm"
    stated_hz: float | None = None

    @property
    def numbers(self) -> F64:
        """The positions in the unit of the file."""
        return self.positions / UNITS_M[self.unit]


@dataclass(frozen=True)
class Mutation:
    """A recording in which one thing is changed.

    Attributes
    ----------
    name : str
        The mutation.
    what : str
        What it changed here.
    recording : Recording
        The changed recording.
    knowable : bool
        False if the file alone cannot show the change.
    """

    name: str
    what: str
    recording: Recording
    knowable: bool = True


def _c3d(path: Path, made: Recording) -> None:
    axis = made.up.upper()
    write_c3d(
        path, made.numbers, made.labels, rate=made.stated_hz or made.rate_hz, unit=made.stated_unit,
        X_SCREEN=["+X"], Y_SCREEN=[f"+{axis}"],
    )  # fmt: skip


def _trc(path: Path, made: Recording) -> None:
    frames, count, rate = made.positions.shape[2], len(made.labels), made.stated_hz or made.rate_hz
    lines = ["PathFileType\t4\t(X/Y/Z)\ttake.trc"]
    lines += ["DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames"]
    lines += [f"{rate:g}\t{rate:g}\t{frames}\t{count}\t{made.stated_unit}\t{rate:g}\t1\t{frames}"]
    lines += ["Frame#\tTime\t" + "\t\t\t".join(made.labels) + "\t\t"]
    lines += ["\t\t" + "\t".join(f"X{i}\tY{i}\tZ{i}" for i in range(1, count + 1)), ""]
    for t, row in enumerate(np.moveaxis(made.numbers, 2, 0)):
        cells = ["" if np.isnan(x) else f"{x:.6g}" for x in row.ravel()]
        lines.append(f"{t + 1}\t{t / rate:.5f}\t" + "\t".join(cells))
    path.write_text("\n".join(lines) + "\n")


_MOTIVE = {"mm": "Millimeters", "cm": "Centimeters", "m": "Meters", "": ""}


def _motive(path: Path, made: Recording) -> None:
    unit = _MOTIVE.get(made.stated_unit, made.stated_unit)
    rows = np.moveaxis(made.numbers, 2, 0)
    path.write_text(
        motive_csv(rows, made.labels, kind="Marker", rate=made.stated_hz or made.rate_hz, unit=unit), newline=""
    )


def _nexus(path: Path, made: Recording) -> None:
    rows = np.moveaxis(made.numbers, 2, 0)
    text = nexus_csv(rows, made.labels, rate=made.stated_hz or made.rate_hz, unit=made.stated_unit or "mm")
    path.write_text(text, newline="")


@dataclass(frozen=True)
class Form:
    """A format: the ending of its files, and the writer of a recording."""

    ending: str
    write: Callable[[Path, Recording], None]


FORMS = {
    "C3D": Form(".c3d", _c3d), "TRC": Form(".trc", _trc), "Motive CSV": Form(".csv", _motive),
    "Nexus CSV": Form(".csv", _nexus),
}  # fmt: skip

_ON_THE_FLOOR = ("03_rolling.c3d",)
"""Recordings of people who lie, whose posture does not show which axis is vertical."""

_NAMED = ("c3d/HDM_bd_05-01_01_120.c3d", "c3d/BTS.c3d", "c3d/Qualisys.c3d", "c3d/03_rolling.c3d",
          "wild/pyCGM/59993_Frame_Static.c3d", "wild/pyCGM/RoboStatic.c3d", "wild/pyCGM/Sample_Static.c3d",
          "wild/Pose2Sim_Blender/Pose2Sim_markers.trc", "wild/Pose2Sim_Blender/Moco_markers.trc",
          "cameras/balancing/S00_P00_T01_BalancingTrial/pose-3d/S00_P00_T01_BalancingTrial_0-100.trc")  # fmt: skip
"""Recordings that are read rightly."""


def recordings(data: Path, apart: bool = False) -> list[Recording]:
    """Read recordings of a folder of real data, and cut each to a few frames.

    Parameters
    ----------
    data : Path
        The folder.
    apart : bool, optional
        False for those that are named here, True for all others that are read as C3D or TRC files.
    """
    named = {data / name for name in _NAMED}
    if not apart:
        found = [_recording(path.name, _points(path)) for path in (data / name for name in _NAMED) if path.is_file()]
        if not found:
            raise KinedexError(f"{data} has none of {', '.join(_NAMED)}")
        return found
    found = []
    for path in sorted({*data.rglob("*.c3d"), *data.rglob("*.trc")} - named):
        with suppress(KinedexError):
            found.append(_recording(path.name, _points(path)))
    return found


def _points(path: Path) -> Points:
    return parse_c3d(path) if path.suffix == ".c3d" else parse_trc(path)


def _recording(name: str, points: Points) -> Recording:
    positions = points.positions * (points.unit_m or 0.001)
    up = getattr(points, "up", None) or "y"
    whole = np.flatnonzero(np.isfinite(positions).any(axis=(0, 1)))
    start = whole[0] + max(0, (len(whole) - FRAMES) // 2)
    cut = positions[:, :, start : start + FRAMES]
    kept = [i for i in range(len(cut)) if np.isfinite(cut[i]).any()]
    labels = tuple(points.names[i].rpartition(":")[2] for i in kept)
    if len(set(labels)) < len(labels):
        labels = tuple(points.names[i] for i in kept)
    return Recording(name, labels, cut[kept], points.rate_hz or points.clock_hz or 100.0, up)


def _hidden(made: Recording, i: int, frames: slice) -> Recording:
    positions = made.positions.copy()
    positions[i, :, frames] = np.nan
    return replace(made, positions=positions)


def _without(made: Recording, i: int) -> Recording:
    labels = tuple(label for j, label in enumerate(made.labels) if j != i)
    return replace(made, labels=labels, positions=np.delete(made.positions, i, axis=0))


def _renamed(made: Recording, names: dict[int, str]) -> Recording:
    return replace(made, labels=tuple(names.get(j, label) for j, label in enumerate(made.labels)))


def _mirror(label: str) -> str | None:
    """Return the label of the other side, for labels whose side is their first or last letter."""
    swap = {"L": "R", "R": "L", "l": "r", "r": "l"}
    if label[:1] in swap:
        return swap[label[0]] + label[1:]
    return label[:-1] + swap[label[-1]] if label[-1:] in swap else None


def point_mutations(made: Recording, form: str, random: np.random.Generator) -> Iterator[Mutation]:
    """Yield mutations of a recording, each of them a whole recording."""
    for i, label in enumerate(made.labels):
        yield Mutation("label hidden in all frames", label, _hidden(made, i, slice(None)))
        yield Mutation("label hidden in the first half", label, _hidden(made, i, slice(0, FRAMES // 2)))
        yield Mutation("label hidden in one frame of five", label, _hidden(made, i, slice(0, None, 5)))
        yield Mutation("label removed", label, _without(made, i))
        yield Mutation("label renamed to nonsense", label, _renamed(made, {i: f"XQ{i}Z"}))
        yield Mutation("label duplicated", label, _added(made, [label], made.positions[[i]]))
    yield from _exchanges(made)
    yield from _labels(made, random)
    yield from _scenes(made, form)


def _added(made: Recording, labels: Sequence[str], positions: F64) -> Recording:
    return replace(made, labels=(*made.labels, *labels), positions=np.concatenate([made.positions, positions]))


def _exchanges(made: Recording) -> Iterator[Mutation]:
    at = {label: i for i, label in enumerate(made.labels)}
    sides: dict[int, str] = {}
    for label, i in at.items():
        other = _mirror(label)
        if other in at and label < other:
            sides |= {i: other, at[other]: label}
            yield Mutation("left and right exchanged", label, _renamed(made, {i: other, at[other]: label}))
    if sides:
        yield Mutation("all sides exchanged", "", _renamed(made, sides), knowable=False)
    middle = np.nanmean(made.positions, axis=2)
    markers = [i for i, label in enumerate(made.labels) if not COMPUTED.match(label)]
    for i, label in ((i, made.labels[i]) for i in markers):
        away = np.linalg.norm(middle - middle[i], axis=1)
        j = min((j for j in markers if j != i), key=lambda j: away[j])
        yield Mutation(
            "neighbours exchanged", f"{label} {made.labels[j]}", _renamed(made, {i: made.labels[j], j: label})
        )


def _labels(made: Recording, random: np.random.Generator) -> Iterator[Mutation]:
    count, frames = len(made.labels), made.positions.shape[2]
    away = made.positions + np.array([0.9, 0.0, 0.0])[None, :, None]
    both = replace(made, labels=tuple(f"Ann:{label}" for label in made.labels))
    yield Mutation(
        "second subject beside", "half a body", _added(both, [f"Bob:{label}" for label in made.labels[:6]], away[:6])
    )
    for prefix in ("Ann:", "take_01_", "X"):
        names = dict(enumerate(f"{prefix}{label}" for label in made.labels))
        yield Mutation("prefix or suffix", prefix, _renamed(made, names))
    names = dict(enumerate(f"{label}_m" for label in made.labels))
    yield Mutation("prefix or suffix", "_m", _renamed(made, names))
    order = random.permutation(count)
    shuffled = replace(made, labels=tuple(made.labels[i] for i in order), positions=made.positions[order])
    yield Mutation("order shuffled", "", shuffled)
    for label in ("*{}", "U_{}", "C_{}"):
        ghosts = np.repeat(random.uniform(-1, 1, (3, 3, 1)) + np.nanmean(made.positions), frames, axis=2)
        ghosts[np.repeat(random.random((3, 1, frames)) < 0.5, 3, axis=1)] = np.nan
        yield Mutation("unlabelled points added", label, _added(made, [label.format(10 + k) for k in range(3)], ghosts))


def _scenes(made: Recording, form: str) -> Iterator[Mutation]:
    for unit in UNITS_M:
        yield Mutation("unit right", unit, replace(made, unit=unit, stated_unit=unit))
        if form in ("C3D", "TRC", "Motive CSV"):
            yield Mutation("unit absent", unit, replace(made, unit=unit, stated_unit=""))
        for lie in ("mm", "cm", "m"):
            if lie != unit:
                yield Mutation("unit lying", f"{unit} as {lie}", replace(made, unit=unit, stated_unit=lie))
    turned = made.positions[:, [0, 2, 1]] * np.array([1.0, -1.0, 1.0] if made.up == "y" else [1.0, 1.0, -1.0])[:, None]
    other = "z" if made.up == "y" else "y"
    yield Mutation("axis up, stated", other, replace(made, positions=turned, up=other))
    yield Mutation("axis up, lying", other, replace(made, positions=turned), knowable=made.name not in _ON_THE_FLOOR)
    yield Mutation("handedness", "x mirrored", replace(made, positions=made.positions * [[-1.0], [1.0], [1.0]]))
    back = np.array([-1.0, -1.0, 1.0] if made.up == "z" else [-1.0, 1.0, -1.0])[:, None]
    yield Mutation("turned by 180 degrees", "", replace(made, positions=made.positions * back))
    for factor in (2.0, 4.0, 0.5):
        lying = replace(made, stated_hz=factor * made.rate_hz)
        yield Mutation("rate lying", f"{factor:g}", lying, knowable=False)
    for axis in range(3):
        shift = 100.0 * np.eye(3)[axis][:, None]
        yield Mutation("origin 100 m away", "xyz"[axis], replace(made, positions=made.positions + shift))
    for factor in (0.45, 2.2):
        yield Mutation("scene scaled", f"{factor:g}", replace(made, positions=factor * made.positions))
