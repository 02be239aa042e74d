"""Write the synthetic archive: ASF/AMC files of invented actors, in the folder layout of a real archive."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import asdict, dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from kinedex.ops.errors import KinedexError, ParameterError
from kinedex.ops.synth.body import Actor, actor_name, draw_actor
from kinedex.ops.synth.performance import MOTIONS, RATE_HZ, perform_clip, perform_take
from kinedex.ops.synth.solve import columns
from kinedex.pipelines.engine.display import Progress, no_progress
from kinedex.pipelines.engine.executors import cores, make_executor
from kinedex.storage.durable_files import whole_file
from kinedex.storage.formats.motion.acclaim_writer import Dialect, write_amc, write_asf

CLIP_SHARE = 0.50
"""The fraction of the archive's duration that training clips take up; long takes take up the other part."""
LONGEST_TAKE = 150.0
"""Greatest length of a long take in seconds."""
DEFAULT_SEED = 2026
VERSION = 1
"""The version of the motion that a seed produces; it is increased when the motion changes."""
RECORD = "synthetic.json"
"""The file with the settings of the archive; it is written first and completed last."""

_DIALECTS = (
    Dialect(remarks=("AST/ASF file, synthetic",)),
    Dialect(newline="\r\n", remarks=("AST/ASF file, synthetic", "---------------------------")),
    Dialect(scientific=True),
    Dialect(length=0.5, decimals=6, remarks=("#!OML:ASF D:\\mocap\\no such skeleton.ASF",)),
    Dialect(newline="\r\n", remarks=("Körper und Bewegung sind erdacht",)),
)


@dataclass(frozen=True)
class ArchiveSummary:
    """The content of a synthetic archive.

    Attributes
    ----------
    directory : str
        Folder of the archive.
    made : bool
        False if the archive already existed with the same settings.
    actors, classes : tuple of str
        Names of the actors and of the classes of motion.
    clips, takes : int
        Numbers of training clips and of long takes.
    clip_minutes, take_minutes : float
        Minutes of motion in clips and in long takes.
    frames : int
        The number of source frames, at 120 Hz.
    labels : int
        The number of labelled segments in the takes.
    bytes : int
        The size of all files in bytes.
    """

    directory: str
    made: bool
    actors: tuple[str, ...]
    classes: tuple[str, ...]
    clips: int
    takes: int
    clip_minutes: float
    take_minutes: float
    frames: int
    labels: int
    bytes: int

    def __str__(self) -> str:
        return (
            f"{len(self.actors)} actors, {len(self.classes)} classes: {self.clips} clips ({self.clip_minutes:.1f} min) "
            f"and {self.takes} takes ({self.take_minutes:.1f} min, {self.labels} labels), {self.bytes / 1e6:.0f} MB"
        )


@dataclass(frozen=True)
class _Task:
    """A file to write: a clip of a motion, or a long take if `motion` is empty."""

    actor: int
    motion: str
    number: int
    seconds: float
    width: int


@dataclass(frozen=True)
class _Written:
    take: str
    clip: bool
    frames: int
    bytes: int
    labels: tuple[tuple[str, int, int], ...]


def write_archive(
    directory: str | Path,
    minutes: float = 30.0,
    actors: int = 5,
    seed: int = DEFAULT_SEED,
    progress: Progress = no_progress,
    jobs: int | None = None,
    clip_minutes: float | None = None,
) -> ArchiveSummary:
    """Write a synthetic archive: training clips, long takes, and the ground truth of the takes.

    By default, clips take up half of the duration, with the same number of clips for each motion and actor as far as
    possible, and takes of at most two and a half minutes the other half. The same settings give the same bytes for any
    number of jobs. A complete archive is not changed.

    Parameters
    ----------
    directory : str or Path
        A new or empty folder, or the folder of an earlier call with the same settings.
    minutes : float
        Minutes of all files together; the result differs by at most about ten per cent.
    actors : int
        Number of actors, 1 to 600.
    seed : int
        Seed of all random numbers.
    progress : callable
        Function of a description and the number of files that returns a progress bar.
    jobs : int or None
        Number of worker processes; one per core for None.
    clip_minutes : float or None
        Minutes of the clips; half of `minutes` for None.

    Returns
    -------
    ArchiveSummary
        The content of the archive.

    Raises
    ------
    ParameterError
        If a setting is out of range.
    KinedexError
        If the folder contains other files.
    """
    if not minutes > 0:
        raise ParameterError("minutes", "above 0", minutes)
    if not 1 <= actors <= 600:
        raise ParameterError("actors", "from 1 to 600", actors)
    if seed < 0:
        raise ParameterError("seed", "at least 0", seed)
    if clip_minutes is not None and not 0 <= clip_minutes < minutes:
        raise ParameterError("clip_minutes", "from 0 to less than minutes", clip_minutes)
    folder = Path(directory)
    settings: dict[str, object] = {"version": VERSION, "minutes": minutes, "actors": actors, "seed": seed}
    if clip_minutes is not None:
        settings["clip_minutes"] = clip_minutes
    existing = _existing(folder, settings)
    if existing is not None:
        return existing
    _write_record(folder, {"settings": settings, "summary": None})
    bytes_written = _write_skeletons(folder, actors, seed)
    tasks = _plan(minutes, actors, seed, CLIP_SHARE * minutes if clip_minutes is None else clip_minutes)
    executor = make_executor("processes", min(jobs or cores(), max(1, len(tasks) // 8)))
    written: list[_Written] = []
    try:
        with progress("writing files", len(tasks)) as bar:
            for result in executor.map(partial(_perform, str(folder), seed), tasks):
                written.append(result)
                bar.advance()
    finally:
        executor.close()
    bytes_written += _write_ground_truth(folder / "takes" / "ground_truth.csv", written)
    summary = _summary(folder, actors, written, bytes_written)
    _write_record(folder, {"settings": settings, "summary": asdict(summary)})
    return summary


def _existing(folder: Path, settings: dict[str, object]) -> ArchiveSummary | None:
    """Return the summary of a complete archive with these settings; None if an archive can be written."""
    if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        return None
    way_out = "name another folder, or remove this one"
    try:
        record = json.loads((folder / RECORD).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        raise KinedexError(f"{folder} is neither empty nor a synthetic archive: {way_out}") from None
    if record.get("settings") != settings:
        raise KinedexError(
            f"{folder} holds a synthetic archive with other settings ({record.get('settings')}): {way_out}"
        )
    if record.get("summary") is None:
        return None
    known: dict[str, Any] = record["summary"]
    return ArchiveSummary(
        **known
        | {
            "directory": str(folder),
            "made": False,
            "actors": tuple(known["actors"]),
            "classes": tuple(known["classes"]),
        }
    )


def _write_record(folder: Path, record: dict[str, object]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    with whole_file(folder / RECORD) as unfinished:
        unfinished.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


def _write_skeletons(folder: Path, actors: int, seed: int) -> int:
    total = 0
    for part in ("clips", "takes"):
        (folder / part).mkdir(exist_ok=True)
        for number in range(actors):
            actor = _cast(number, seed)
            path = folder / part / f"SYN_{actor.name}.asf"
            write_asf(path, actor.body, actor.name, _dialect(number))
            total += path.stat().st_size
    for motion in MOTIONS:
        (folder / "clips" / motion.name).mkdir(exist_ok=True)
    return total


def _plan(minutes: float, actors: int, seed: int, clip_minutes: float) -> list[_Task]:
    """Plan clips and takes: clips of all motions and actors fill `clip_minutes`, long takes the remaining time."""
    clips: list[_Task] = []
    left = clip_minutes * 60.0
    number = 0
    while left > 0:
        for turn in range(actors):
            for at, motion in enumerate(MOTIONS):
                who = (at + turn) % actors
                seconds = motion.seconds / _cast(who, seed).tempo
                if left > 0.5 * seconds:
                    clips.append(_Task(who, motion.name, number, seconds, 3))
                left -= seconds
        number += 1
    time = (minutes - clip_minutes) * 60.0 / actors
    each = max(1, -(-int(time) // int(LONGEST_TAKE)))
    width = max(2, len(str(each)))
    takes = [_Task(who, "", n, time / each, width) for n in range(each) for who in range(actors)]
    return takes + clips


@lru_cache(maxsize=64)
def _cast(number: int, seed: int) -> Actor:
    return draw_actor(number, seed)


def _dialect(number: int) -> Dialect:
    return _DIALECTS[number % len(_DIALECTS)]


def _perform(folder: str, seed: int, task: _Task) -> _Written:
    actor = _cast(task.actor, seed)
    name = f"SYN_{actor.name}_{task.motion or 'take'}"
    if task.motion:
        name += f"_{task.number + 1:03d}_120"
        path = Path(folder) / "clips" / task.motion / f"{name}.amc"
        performance = perform_clip(actor, task.motion, task.number, seed)
    else:
        name += f"{task.number + 1:0{task.width}d}"
        path = Path(folder) / "takes" / f"{name}.amc"
        performance = perform_take(actor, task.seconds, task.number, seed)
    size = write_amc(path, columns(actor.body), performance.angles, _dialect(task.actor))
    labels = tuple((label.label, label.start, label.stop) for label in performance.labels)
    return _Written(name, bool(task.motion), len(performance.angles), size, labels)


def _write_ground_truth(path: Path, written: list[_Written]) -> int:
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["take", "class", "start", "stop"])
    for one in sorted((one for one in written if not one.clip), key=lambda one: one.take):
        table.writerows((one.take, *row) for row in one.labels)
    data = text.getvalue().encode()
    path.write_bytes(data)
    return len(data)


def _summary(folder: Path, actors: int, written: list[_Written], size: int) -> ArchiveSummary:
    clips = [one for one in written if one.clip]
    takes = [one for one in written if not one.clip]
    minute = 60.0 * RATE_HZ
    return ArchiveSummary(
        directory=str(folder),
        made=True,
        actors=tuple(actor_name(number) for number in range(actors)),
        classes=tuple(dict.fromkeys(motion.label for motion in MOTIONS)),
        clips=len(clips),
        takes=len(takes),
        clip_minutes=sum(one.frames for one in clips) / minute,
        take_minutes=sum(one.frames for one in takes) / minute,
        frames=sum(one.frames for one in written),
        labels=sum(len(one.labels) for one in takes),
        bytes=size + sum(one.bytes for one in written),
    )
