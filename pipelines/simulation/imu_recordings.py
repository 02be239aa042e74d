"""Simulate recordings of inertial sensors on the limbs of takes, as a data set with windows and segments."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from kinedex import __version__
from kinedex.catalog.imu_grades import load_grade
from kinedex.catalog.limbs import chosen_limbs
from kinedex.ops.arrays import F64
from kinedex.ops.errors import KinedexError, ParameterError
from kinedex.ops.inertial.limb_motion import LimbMotion
from kinedex.ops.simulation.imu_sensors import (
    MIN_SECONDS,
    SampledPiece,
    TakeSensors,
    WearOptions,
    sample_piece,
    take_pieces,
    worn_sensors,
)
from kinedex.ops.wording import counted
from kinedex.pipelines.engine.display import Progress
from kinedex.pipelines.inertial.limb_motion import stored_limbs
from kinedex.pipelines.inertial.source_limbs import limb_tasks, read_limbs, with_stored_body
from kinedex.pipelines.simulation.recording_folder import chosen_takes, new_folder, recording_names, require_new
from kinedex.storage.formats.csv_tables import csv_line
from kinedex.storage.formats.imu.simulated_files import CLOCKLESS, WRITERS, readme
from kinedex.storage.store.store import Store

MIN_SHARE = 0.5
"""The fraction of a window above which the class that covers most of it becomes its class."""

RECORDINGS = "recordings"
"""The folder of a data set that contains a folder for each take."""

README, DATASET, SENSORS = "README.md", "dataset.yaml", "sensors.yaml"
SEGMENTS, WINDOWS, TRUTH = "segments.csv", "windows.csv", "truth/sensors.csv"
"""The other files of a data set."""


@dataclass(frozen=True)
class ClassTime:
    """An interval of a take with a class.

    Attributes
    ----------
    origin : str
        label (of a person), annotation (of a method) or take (the class of a take that is one clip).
    name : str
        The class.
    start_s, stop_s : float
        Times in the take, in seconds.
    """

    origin: str
    name: str
    start_s: float
    stop_s: float


@dataclass(frozen=True)
class Windowing:
    """Length and step of windows in seconds."""

    seconds: float = 2.0
    step_s: float = 1.0

    def __post_init__(self) -> None:
        if not 0.0 < self.seconds <= 3600.0:
            raise ParameterError("window", "a positive number of seconds", self.seconds)
        if not 0.0 < self.step_s <= 3600.0:
            raise ParameterError("step", "a positive number of seconds", self.step_s)


def take_segments(store: Store) -> dict[str, list[ClassTime]]:
    """Return the segments of all takes, by the take's name.

    Labels of people take precedence over annotations if a take has both; a take with neither has the class of its file,
    if there is one.
    """
    found: dict[str, list[ClassTime]] = {}
    rows = store.sql(
        'SELECT take, "class", start_seconds AS a, stop_seconds AS b FROM labels '
        "WHERE verdict = 'positive' AND limb IS NULL ORDER BY take, start, stop, \"class\""
    ).to_pylist()
    for row in rows:
        found.setdefault(row["take"], []).append(ClassTime("label", row["class"], row["a"], row["b"]))
    labelled = set(found)
    for row in store.sql(
        'SELECT take, "class", start_seconds AS a, stop_seconds AS b FROM annotations '
        'ORDER BY take, start, stop, "class", subclass'
    ).to_pylist():
        if row["take"] not in labelled:
            found.setdefault(row["take"], []).append(ClassTime("annotation", row["class"], row["a"], row["b"]))
    for row in store.take_rows.select(["name", "class", "seconds"]).to_pylist():
        if row["name"] not in found and row["class"] is not None:
            found[row["name"]] = [ClassTime("take", row["class"], 0.0, row["seconds"])]
    return found


def segment_rows(segments: Sequence[ClassTime], take_times: F64) -> list[tuple[str, str, int, int]]:
    """Return origin, class and samples [start, stop) of the segments that contain samples."""
    rows = []
    for one in segments:
        start, stop = np.searchsorted(take_times, [one.start_s - 1e-9, one.stop_s - 1e-9]).tolist()
        if stop > start:
            rows.append((one.origin, one.name, start, stop))
    return rows


def window_rows(
    rows: Sequence[tuple[str, str, int, int]], samples: int, rate_hz: float, windowing: Windowing
) -> list[tuple[int, int, str, float]]:
    """Return windows [start, stop) in samples, with the class that covers most of each window, and its share.

    The class is empty if none covers more than half of a window.
    """
    width, step = max(1, round(windowing.seconds * rate_hz)), max(1, round(windowing.step_s * rate_hz))
    classes = sorted({name for _, name, _, _ in rows})
    covered = np.zeros((len(classes), samples + 1), np.int64)
    for _, name, start, stop in rows:
        covered[classes.index(name), start:stop] = 1
    sums = np.concatenate([np.zeros((len(classes), 1), np.int64), np.cumsum(covered[:, :samples], axis=1)], axis=1)
    found = []
    for start in range(0, samples - width + 1, step):
        shares = (sums[:, start + width] - sums[:, start]) / width
        best = int(np.argmax(shares)) if len(classes) else -1
        clear = best >= 0 and shares[best] > MIN_SHARE
        found.append((start, start + width, classes[best] if clear else "", float(shares[best]) if best >= 0 else 0.0))
    return found


@dataclass(frozen=True)
class ImuRequest:
    """A request to simulate inertial sensors.

    Attributes
    ----------
    limbs : tuple of str
        Limbs or groups of limbs that wear a sensor; empty for all known limbs.
    grade : str
        Name of a grade, or the path of a file.
    wearing : WearOptions
        Seed, rate, lever arm, magnetic field and sensor grade.
    form : str
        The format: parquet, npz or xsens-txt.
    windowing : Windowing
        Length and step of windows.
    """

    limbs: tuple[str, ...] = ()
    grade: str = "good"
    wearing: WearOptions = field(default_factory=WearOptions)
    form: str = "parquet"
    windowing: Windowing = field(default_factory=Windowing)

    def __post_init__(self) -> None:
        chosen_limbs(self.limbs)
        if self.form not in WRITERS:
            raise ParameterError("format", f"one of {', '.join(WRITERS)}", self.form)

    @property
    def least_seconds(self) -> float:
        """The smallest length of a piece in seconds: that of a window or of 3 samples, but from 0.5 to 2 s."""
        return min(MIN_SECONDS, max(0.5, self.windowing.seconds, 3.0 / self.wearing.rate_hz))


@dataclass(frozen=True, eq=False)
class TakeToSimulate:
    """A take with its limbs, actor and segments.

    Attributes
    ----------
    take : str
        Its name.
    actor : str or None
        Its actor.
    limbs : dict of str to LimbMotion
        Its limbs.
    source_hz : float
        Frames per second of its source.
    segments : tuple of ClassTime
        Its annotated segments.
    """

    take: str
    actor: str | None
    limbs: dict[str, LimbMotion]
    source_hz: float
    segments: tuple[ClassTime, ...] = ()


@dataclass
class SimulatedSensors:
    """The recordings that were made.

    Attributes
    ----------
    recordings : dict of str to list of str
        Take → its files, relative to the folder.
    seconds : float
        The duration of all pieces in seconds.
    samples : int
        The number of samples of all sensors.
    clipped : int
        The number of samples beyond the range of a sensor.
    least_seconds : float
        The smallest length of a piece in seconds.
    short, lost_frames : int
        The numbers of pieces excluded because they are shorter, and of source frames outside of all pieces.
    without : dict of str to list of str
        Limb and reason → the takes in which it has no sensor.
    left_out : list of str
        The takes without any piece.
    slower : list of str
        The takes whose source has a lower rate than the sensors, so that motion is interpolated.
    windows : int
        The number of windows in all pieces.
    classes : dict of str to int
        Class → number of windows.
    """

    recordings: dict[str, list[str]] = field(default_factory=dict)
    seconds: float = 0.0
    samples: int = 0
    clipped: int = 0
    least_seconds: float = MIN_SECONDS
    short: int = 0
    lost_frames: int = 0
    without: dict[str, list[str]] = field(default_factory=dict)
    left_out: list[str] = field(default_factory=list)
    slower: list[str] = field(default_factory=list)
    windows: int = 0
    classes: dict[str, int] = field(default_factory=dict)

    def remarks(self) -> list[str]:
        """Return sentences on what was excluded or interpolated."""
        found = [f"{what} in {_few(takes)}" for what, takes in self.without.items()]
        if self.short:
            verb = "was" if self.short == 1 else "were"
            pieces = counted(self.short, "piece")
            found.append(f"{pieces} shorter than {self.least_seconds:g} s between jumps and gaps {verb} left out")
        if self.left_out:
            found.append(f"no piece of {self.least_seconds:g} s: {_few(self.left_out)}")
        if self.slower:
            found.append(f"interpolated, for the source is slower than the sensors: {_few(self.slower)}")
        if self.clipped:
            found.append(f"{self.clipped:,} of {self.samples:,} samples are beyond the range of a sensor, and flagged")
        labelled = sum(self.classes.values())
        if labelled:
            classes = counted(len(self.classes), "class", "classes")
            found.append(f"{counted(self.windows, 'window')}, {labelled:,} with a class ({classes})")
        elif self.recordings:
            found.append(
                f"{counted(self.windows, 'window')}, none with a class: the takes have neither labels nor "
                "annotations nor a class of their own; `kinedex labels import` brings labels in, and "
                "`kinedex run annotate` finds classes"
            )
        return found


def _few(names: list[str], most: int = 3) -> str:
    return ", ".join(names[:most]) + (f" and {len(names) - most} more takes" if len(names) > most else "")


def write_data_set(
    folder: Path, names: list[str], takes: Iterable[TakeToSimulate], request: ImuRequest, progress: Progress
) -> SimulatedSensors:
    """Write a data set of simulated sensors into an empty folder; the result is reproducible to the byte.

    Parameters
    ----------
    folder : Path
        An empty folder.
    names : list of str
        The names of the takes, in their order.
    takes : iterable of TakeToSimulate
        The takes in the order of `names`; takes without limbs may be missing.
    request : ImuRequest
        The sensors.
    progress : callable
        Shows progress.

    Raises
    ------
    KinedexError
        No take has a piece for which sensors can be simulated.
    """
    return _DataSet(folder, dict(zip(names, recording_names(names), strict=True)), request).write(takes, progress)


class _DataSet:
    """A data set that is being written."""

    def __init__(self, folder: Path, homes: Mapping[str, str], request: ImuRequest) -> None:
        self.folder, self.homes, self.request = folder, homes, request
        self.wearing = replace(request.wearing, grade=load_grade(request.grade))
        self.made = SimulatedSensors(least_seconds=request.least_seconds)
        self.entries: dict[str, Any] = {}
        self.segments: list[list[object]] = []
        self.windows: list[list[object]] = []
        self.truth: list[list[object]] = []
        self.limbs: dict[str, None] = {}

    def write(self, takes: Iterable[TakeToSimulate], progress: Progress) -> SimulatedSensors:
        """Write the simulated recordings of all takes and the tables of the data set, and return a summary."""
        (self.folder / RECORDINGS).mkdir()
        with progress("sensors", len(self.homes)) as bar:
            for take in takes:
                self._take(take)
                bar.advance(1)
        if not self.made.recordings:
            reasons = "; ".join(self.made.remarks()) or "no limb is known"
            raise KinedexError(f"sensors can be simulated for no take: {reasons}")
        _table(self.folder / SEGMENTS, ["file", "take", "origin", "class", "start", "stop"], self.segments)
        _table(self.folder / WINDOWS, ["file", "take", "start", "stop", "class", "share", "actor"], self.windows)
        (self.folder / "truth").mkdir()
        columns = [f"{name}_{axis}" for name in ("q_global", "q_mount") for axis in "wxyz"]
        _table(self.folder / TRUTH, ["file", "take", "sensor", "offset_s", "ppm", *columns], self.truth)
        (self.folder / SENSORS).write_bytes(self._sensors().encode())
        (self.folder / DATASET).write_bytes(self._description().encode())
        (self.folder / README).write_bytes(readme(self.request.form).encode())
        return self.made

    def _take(self, take: TakeToSimulate) -> None:
        made = self.made
        wanted, named = chosen_limbs(self.request.limbs), bool(self.request.limbs)
        found = take_pieces(take.limbs, wanted, named, self.request.least_seconds)
        for limb, reason in found.without.items():
            made.without.setdefault(f"{limb} has no sensor ({reason})", []).append(take.take)
        made.short += found.short
        made.lost_frames += found.lost_frames
        if not found.pieces:
            made.left_out.append(take.take)
            return
        if take.source_hz < self.wearing.rate_hz * (1 - 1e-6):
            made.slower.append(take.take)
        worn = worn_sensors(self.wearing, take.take, take.actor, found.pieces[0].limbs)
        self.limbs.update(dict.fromkeys(found.pieces[0].limbs))
        home = self.folder / RECORDINGS / self.homes[take.take]
        home.mkdir()
        files = []
        for number, piece in enumerate(found.pieces):
            sampled = sample_piece(piece, number, take.take, worn, self.wearing)
            name = "imu" if len(found.pieces) == 1 else f"imu-{number + 1}"
            paths = WRITERS[self.request.form](home / name, sampled, self.wearing.rate_hz, self.wearing.field_ut)
            own = [path.relative_to(self.folder).as_posix() for path in paths]
            files += own
            self._tables(take, sampled, own, worn)
        made.recordings[take.take] = files
        self.entries[take.take] = {"actor": take.actor, "source_hz": take.source_hz, "files": files}

    def _tables(self, take: TakeToSimulate, sampled: SampledPiece, files: list[str], worn: TakeSensors) -> None:
        """Add the rows of a piece to the tables of segments, windows and truth."""
        made, count = self.made, len(sampled.times)
        made.seconds += count / self.wearing.rate_hz
        made.samples += count * len(sampled.readings)
        made.clipped += sum(int(read.clipped.sum()) for read in sampled.readings.values())
        rows = segment_rows(take.segments, sampled.take_times)
        self.segments += [[files[0], take.take, *row] for row in rows]
        windows = window_rows(rows, count, self.wearing.rate_hz, self.request.windowing)
        self.windows += [[files[0], take.take, *row[:3], f"{row[3]:.4f}", take.actor or ""] for row in windows]
        made.windows += len(windows)
        for name in sorted({row[2] for row in windows} - {""}):
            made.classes[name] = made.classes.get(name, 0) + sum(row[2] == name for row in windows)
        begin = float(sampled.times[0]) if self.request.form in CLOCKLESS else 0.0
        for i, limb in enumerate(sampled.readings):
            file = files[i] if len(files) == len(sampled.readings) > 1 else files[0]
            quaternions = [f"{value:.12g}" for value in (*worn.q_global, *worn.mounts[limb])]
            offset = worn.clock.offset_s - begin
            self.truth.append([file, take.take, limb, f"{offset:.9f}", f"{worn.clock.ppm:.6f}", *quaternions])

    def _sensors(self) -> str:
        """Return a description of the sensors as YAML; it states units, which data of fast limbs do not reveal."""
        content = {"sensors": {limb: limb for limb in self.limbs}, "units": self._units(), "frame": "NWU"}
        head = "# The sensors of this data set.\n"
        if self.request.form != "npz":
            head = "# The sensors of this data set: `--set sensors=` this file, `--set recordings=` `recordings`.\n"
        return head + yaml.safe_dump(content, sort_keys=False)

    def _units(self) -> dict[str, str]:
        return {"acc": "m/s2", "gyr": "rad/s", "mag": "1" if self.request.form in CLOCKLESS else "uT"}

    def _description(self) -> str:
        wearing = self.wearing
        content = {
            "kinedex": __version__,
            "form": self.request.form,
            "limbs": list(self.limbs),
            "units": self._units(),
            "seed": wearing.seed,
            "grade": Path(self.request.grade).stem,
            "rate_hz": wearing.rate_hz,
            "stand_s": wearing.stand_s,
            "mount": wearing.mount,
            "lever_m": list(wearing.lever_m),
            "field": {
                "strength_ut": wearing.field_ut,
                "inclination_deg": wearing.inclination_deg,
                "declination_deg": wearing.declination_deg,
            },
            "window_s": self.request.windowing.seconds,
            "step_s": self.request.windowing.step_s,
            "windows": self.made.windows,
            "windows_of_classes": dict(sorted(self.made.classes.items())),
            "takes": self.entries,
        }
        head = (
            "# Inertial sensors that kinedex has simulated; README.md describes the files.\n"
            "# Orientations in them are the sensors' true ones.\n"
        )
        return head + yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=200)


def _table(path: Path, header: list[str], rows: list[list[object]]) -> None:
    """Write a CSV file in which no cell can be taken for a formula by a spreadsheet."""
    path.write_bytes("".join([csv_line(header), *map(csv_line, rows)]).encode())


def simulate_imu(
    store: Store, takes: Sequence[str], where: str | None, request: ImuRequest, folder: Path, progress: Progress
) -> SimulatedSensors:
    """Write a data set of simulated sensors on takes, whose source files are read again.

    Parameters
    ----------
    store : Store
        The store.
    takes : sequence of str
        Names of takes.
    where : str or None
        SQL filter over the columns of takes, which selects further ones.
    request : ImuRequest
        The sensors.
    folder : Path
        A folder that does not exist, or is empty.
    progress : callable
        Shows progress.

    Raises
    ------
    KinedexError
        The folder contains files, there is no such take, or a source no longer exists or was changed.
    """
    require_new(folder)
    names = chosen_takes(store, takes, where)
    tasks = limb_tasks(store, names, chosen_limbs(request.limbs))
    actors, segments = actors_of(store), take_segments(store)

    def found() -> Iterator[TakeToSimulate]:
        for task in tasks:
            read = read_limbs(with_stored_body(task, store))
            yield TakeToSimulate(
                task.take, actors.get(task.take), read.limbs, read.rate_hz, tuple(segments.get(task.take, ()))
            )

    with new_folder(folder) as unfinished:
        return write_data_set(unfinished, names, found(), request, progress)


def simulate_stored(
    store: Store, stage: str, names: Sequence[str], request: ImuRequest, folder: Path, progress: Progress
) -> SimulatedSensors:
    """Write a data set of simulated sensors into an empty folder, from the limbs that a stage has stored.

    Parameters
    ----------
    store : Store
        The store.
    stage : str
        The stage that has stored the limbs, "<pipeline>/<stage>".
    names : sequence of str
        Names of the takes.
    request : ImuRequest
        The sensors.
    folder : Path
        An empty folder.
    progress : callable
        Shows progress.
    """
    actors, segments = actors_of(store), take_segments(store)
    takes: Iterable[TakeToSimulate] = (
        TakeToSimulate(one.take, actors.get(one.take), one.limbs, one.rate_hz, tuple(segments.get(one.take, ())))
        for one in stored_limbs(store, stage, names)
    )
    return write_data_set(folder, list(names), takes, request, progress)


def actors_of(store: Store) -> dict[str, str | None]:
    """Return the actor of each take, by the take's name."""
    return {row["name"]: row["actor"] for row in store.take_rows.select(["name", "actor"]).to_pylist()}
