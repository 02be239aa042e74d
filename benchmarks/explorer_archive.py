"""The archives of the explorer's benchmarks, made once in build/: 100 hours in 2,400 takes, words and labels included.

To synthesise so much from nothing takes hours. Here the takes of the small synthetic archive (`benchmarks.archive`) are
cut at the boundaries of their labels, and pieces of these are put together anew. Each piece is changed first: mirrored
or not, slower or faster, turned and moved to where the piece before it ends, on a body of another size, with smooth
deviations of about a centimetre in every joint. The features are then computed from the positions as an ingest
computes them; no word is copied. So the frames differ from each other as those of people do who repeat an exercise,
while the kinds of motion are the few of the small archive: counts of hits are higher than in an archive of 100 hours
of anything.

Another archive has 100,000 takes, for tables: each is half a second of a clip of the small archive, as it is there.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from benchmarks.archive import BUILD, archive
from benchmarks.archive import store as small_store
from benchmarks.harness import sized
from kinedex.catalog.features import FeatureSet
from kinedex.ops.body import features
from kinedex.ops.body.facing_direction import mirrored_positions, mirrored_quaternions
from kinedex.pipelines.engine.executors import cores, make_executor
from kinedex.storage.formats.labels.formats import read_labels
from kinedex.storage.index.builder import build_index
from kinedex.storage.snapshot.manifest import Part
from kinedex.storage.snapshot.parts import FramesWriter, joint_positions
from kinedex.storage.snapshot.schemas import result_schema
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.writer import StoreWriter
from tests.storage.made_up import take_row, takes_table

HOURS, TAKES, CLIPS = sized((100.0, 2400, 600), (0.5, 24, 6))
"""The size of the archive; of its takes so many are clips of one motion, with its class."""

RATE_HZ = 30.0
ACTORS = 40
TAKES_A_TASK = 60

MANY_TAKES, MANY_ACTORS = sized((100_000, 200), (1_000, 20))
MANY_FRAMES = (12, 24)
"""The shortest and the longest take of the archive of many takes, in frames."""

MANY_IN_A_PART = 5_000

FADE = 15
"""Frames in which the pose at the beginning of a piece is reached from the end of the one before."""

DEVIATION_M, KNOT = 0.008, 12
"""The standard deviation of joints from the piece, and the frames between two independent values of it."""

F64 = npt.NDArray[np.float64]
Label = tuple[str, int, int]


@dataclass(frozen=True)
class Piece:
    """Frames of the small archive.

    Attributes
    ----------
    positions : float64 array (T, J, 3)
        Metres, Y up.
    orientation : float64 array (T, 4)
        Of the root.
    labels : tuple of (str, int, int)
        Classes with half-open ranges of frames.
    label : str, optional
        The class of a clip.
    """

    positions: F64
    orientation: F64
    labels: tuple[Label, ...]
    label: str | None = None


@dataclass(frozen=True)
class _Made:
    """The rows of some takes, their labels, and the part of their frames."""

    rows: list[dict[str, Any]]
    labels: list[dict[str, Any]]
    part: Part


def hundred_hours(hours: float = HOURS, takes: int = TAKES, clips: int = CLIPS) -> Store:
    """Return the store of the benchmark with its index; make it where it is missing.

    Parameters
    ----------
    hours : float
        The length of all takes together.
    takes, clips : int
        The number of takes, and of those among them that are clips.
    """
    path = BUILD / f"explorer-{hours:g}h"
    if not (path / "manifest").is_dir() or not open_store(path, at="newest").take_rows.num_rows:
        _make(path, small_store(), hours, takes, clips)
    opened = open_store(path, at="newest")
    build_index(opened)
    return opened


def _make(path: Path, source: Store, hours: float, takes: int, clips: int) -> None:
    names = [_name(number, clips) for number in range(takes)]
    seconds = hours * 3600 / max(1, takes - clips)
    with StoreWriter.open(path, source.feature_set, RATE_HZ) as writer:
        ids = writer.assign_take_ids(names)
        numbers = sorted(range(takes), key=lambda number: ids[names[number]])
        tasks = [numbers[first : first + TAKES_A_TASK] for first in range(0, takes, TAKES_A_TASK)]
        executor = make_executor("processes", min(2, cores()))
        truth: list[dict[str, Any]] = []
        try:
            for made in executor.map(partial(_write, path, source.path, ids, clips, seconds), tasks):
                writer.add_takes(takes_table(made.rows), made.part)
                truth += made.labels
        finally:
            executor.close()
        table = pa.Table.from_pylist(truth, schema=result_schema("ground_truth"))
        writer.put_results("ground_truth", table, stage="benchmark/evaluate", run="benchmark")
        writer.commit()


def many_takes() -> Store:
    """Return the store of 100,000 takes with its index; make it where it is missing."""
    path = BUILD / f"explorer-{MANY_TAKES}-takes"
    if not (path / "manifest").is_dir() or not open_store(path, at="newest").take_rows.num_rows:
        _cut_many(path, small_store())
    opened = open_store(path, at="newest")
    build_index(opened)
    return opened


def _cut_many(path: Path, source: Store) -> None:
    feature_set, rng = source.feature_set, np.random.default_rng(2026)
    clips = [piece for piece in pieces_of(source.path) if piece.label is not None]
    names = [f"EXP_actor{number % MANY_ACTORS:03d}_take_{number:06d}" for number in range(MANY_TAKES)]
    with StoreWriter.open(path, feature_set, RATE_HZ) as writer:
        ids = sorted(writer.assign_take_ids(names).items(), key=lambda one: one[1])
        for first in range(0, MANY_TAKES, MANY_IN_A_PART):
            rows = []
            with FramesWriter(path, feature_set, RATE_HZ) as frames:
                for name, take_id in ids[first : first + MANY_IN_A_PART]:
                    clip = clips[int(rng.integers(len(clips)))]
                    count = min(len(clip.positions), int(rng.integers(MANY_FRAMES[0], MANY_FRAMES[1] + 1)))
                    start = int(rng.integers(len(clip.positions) - count + 1))
                    actor = name.split("_")[1]
                    positions = clip.positions[start : start + count], clip.orientation[start : start + count]
                    rows.append(_add(frames, feature_set, take_id, name, actor, clip.label, *positions))
                part = frames.close()
            writer.add_takes(takes_table(rows), part)
        writer.commit()


def _add(
    writer: FramesWriter, feature_set: FeatureSet, take_id: int, name: str, actor: str, label: str | None,
    places: F64, rotations: F64,
) -> dict[str, Any]:  # fmt: skip
    """Write the frames of a take, and return its row."""
    positions, orientation = np.ascontiguousarray(places.transpose(1, 2, 0)), np.ascontiguousarray(rotations.T)
    words = features.words(positions, orientation, RATE_HZ, feature_set.rules)
    writer.add(take_id, positions, orientation, words)
    return _row(take_id, name, len(words), actor, label, hashlib.sha256(words.tobytes()).hexdigest())


def _name(number: int, clips: int) -> str:
    """Return the name of a take: clips come first, as in the small archive."""
    actor = f"actor{number % ACTORS:02d}"
    return f"EXP_{actor}_clip_{number:04d}" if number < clips else f"EXP_{actor}_take_{number:04d}"


def _write(path: Path, source: Path, ids: dict[str, int], clips: int, seconds: float, numbers: Sequence[int]) -> _Made:
    """Make some takes, and write a part of frames."""
    rows, labels = [], []
    feature_set = open_store(source).feature_set
    with FramesWriter(path, feature_set, RATE_HZ) as writer:
        for number in numbers:
            name, rng = _name(number, clips), np.random.default_rng([2026, number])
            pieces = pieces_of(source)
            if number < clips:
                examples = [piece for piece in pieces if piece.label is not None]
                chosen = iter([examples[int(rng.integers(len(examples)))]])
            else:
                chosen = _drawn(pieces, rng)
            about = 0.7 + 0.6 * float(rng.random())
            take = perform(chosen, feature_set.joints, int(seconds * RATE_HZ * about), number % ACTORS, rng)
            label, actor = take.label if number < clips else None, f"actor{number % ACTORS:02d}"
            motion = take.positions, take.orientation
            rows.append(_add(writer, feature_set, ids[name], name, actor, label, *motion))
            if number >= clips:
                labels += [_truth(ids[name], name, *one) for one in take.labels]
        part = writer.close()
    return _Made(rows, labels, part)


def _drawn(pieces: Sequence[Piece], rng: np.random.Generator) -> Iterator[Piece]:
    while True:
        yield pieces[int(rng.integers(len(pieces)))]


@lru_cache(maxsize=2)
def pieces_of(source: Path) -> tuple[Piece, ...]:
    """Return the clips of the small archive, and its long takes cut between their labels."""
    known = open_store(source)
    truth: dict[str, list[Label]] = {}
    for one in read_labels(archive() / "takes" / "ground_truth.csv").segments:
        truth.setdefault(one.take, []).append((one.label, round(one.start / 4), round(one.stop / 4)))
    found = []
    for row in known.takes().sort("take_id").iter_rows(named=True):
        table = known.frames(row["name"])
        positions = joint_positions(table, known.feature_set.joints).transpose(2, 0, 1).astype(np.float64)
        rotations = np.stack(
            [one.to_numpy() for one in table.column("root_orientation").combine_chunks().flatten()], axis=1
        )
        if row["class"] is not None:
            label = row["class"]
            found.append(Piece(positions, rotations.astype(np.float64), ((label, 0, len(positions)),), label))
            continue
        labels = sorted(truth.get(row["name"], []), key=lambda one: one[1])
        cuts = [0, *(one[1] for one in labels[1:]), len(positions)]
        for start, stop in pairwise(cuts):
            own = tuple(
                (name, max(a, start) - start, min(b, stop) - start) for name, a, b in labels if start <= a < stop
            )
            found.append(Piece(positions[start:stop], rotations[start:stop].astype(np.float64), own))
    return tuple(piece for piece in found if len(piece.positions) > FADE)


def perform(pieces: Iterator[Piece], joints: Sequence[str], frames: int, actor: int, rng: np.random.Generator) -> Piece:
    """Put pieces together, one after the other, until a take has so many frames or no piece is left.

    Parameters
    ----------
    pieces : iterator of Piece
        The pieces, which are changed as the module's docstring states.
    joints : sequence of str
        The names of the joints.
    frames : int
        The wanted length, at an end of a piece.
    actor : int
        The number of the actor, of whom the size depends.
    rng : numpy.random.Generator
        The source of all that is drawn.
    """
    size = 0.88 + 0.24 * actor / ACTORS
    found: list[Piece] = []
    count = 0
    for piece in pieces:
        one = _changed(piece, joints, size, rng)
        if found:
            one = _joined(found[-1], one, joints)
        found.append(one)
        count += len(one.positions)
        if count >= frames:
            break
    starts = np.cumsum([0, *(len(one.positions) for one in found)])
    labels = tuple(
        (name, int(a + start), int(b + start))
        for one, start in zip(found, starts[:-1].tolist(), strict=True)
        for name, a, b in one.labels
    )
    positions, rotations = (
        np.concatenate(each) for each in ([one.positions for one in found], [one.orientation for one in found])
    )
    return Piece(positions, rotations, labels, found[0].label)


def _changed(piece: Piece, joints: Sequence[str], size: float, rng: np.random.Generator) -> Piece:
    """Return a piece mirrored or not, in another tempo, with smooth deviations, on a body of some size."""
    positions, rotations, labels, label = piece.positions, piece.orientation, piece.labels, piece.label
    if rng.random() < 0.5:
        positions, rotations = mirrored_positions(positions, joints), mirrored_quaternions(rotations)
        labels = tuple((other_side(name), a, b) for name, a, b in labels)
        label = None if label is None else other_side(label)
    tempo = float(np.exp(rng.uniform(-0.25, 0.25)))
    count = max(FADE + 1, round(len(positions) * tempo))
    at = np.linspace(0, len(positions) - 1, count)
    low = np.minimum(at.astype(np.int64), len(positions) - 2)
    share = at - low
    positions = positions[low] + (positions[low + 1] - positions[low]) * share[:, None, None]
    rotations = rotations[low] + (rotations[low + 1] - rotations[low]) * share[:, None]
    rotations /= np.linalg.norm(rotations, axis=1, keepdims=True)
    knots = rng.normal(0.0, DEVIATION_M, (count // KNOT + 2, len(joints), 3))
    at = np.arange(count) / KNOT
    low = at.astype(np.int64)
    share = ((1 - np.cos(np.pi * (at - low))) / 2)[:, None, None]
    positions = size * (positions + knots[low] * (1 - share) + knots[low + 1] * share)
    longer = count / len(piece.positions)
    labels = tuple((name, round(a * longer), min(count, round(b * longer))) for name, a, b in labels)
    return Piece(positions, rotations, labels, label)


def other_side(name: str) -> str:
    """Return the name of a class in the mirror."""
    for one, other in (("Left", "Right"), ("Right", "Left"), ("Lstart", "Rstart"), ("Rstart", "Lstart")):
        if one in name:
            return name.replace(one, other)
    return name


def _joined(before: Piece, piece: Piece, joints: Sequence[str]) -> Piece:
    """Turn and move a piece to where the one before it ends, and let its first frames begin with that pose."""
    last = before.positions[-1]
    angle = _heading(last, joints) - _heading(piece.positions[0], joints)
    cos, sin = np.cos(angle), np.sin(angle)
    root = list(joints).index("root")
    flat = np.array([1.0, 0.0, 1.0])
    turned = (piece.positions - flat * piece.positions[0, root]) @ np.array([[cos, 0, -sin], [0, 1, 0], [sin, 0, cos]])
    positions = turned + flat * last[root]
    w, x, y, z = piece.orientation.T
    c, s = np.cos(angle / 2), np.sin(angle / 2)
    rotations = np.stack([c * w - s * y, c * x + s * z, c * y + s * w, c * z - s * x], axis=1)
    share = (1 + np.cos(np.pi * np.arange(1, FADE + 1) / (FADE + 1))) / 2
    positions[:FADE] += share[:, None, None] * (last - positions[0])
    return Piece(positions, rotations, piece.labels, piece.label)


def _heading(positions: F64, joints: Sequence[str]) -> float:
    """Return the angle about Y of the line through the hips."""
    across = positions[list(joints).index("lhip")] - positions[list(joints).index("rhip")]
    return float(np.arctan2(-across[2], across[0]))


def _row(take_id: int, name: str, frames: int, actor: str, label: str | None, checksum: str) -> dict[str, Any]:
    return take_row(
        take_id, name, frames, source=f"{actor}/{name}.amc", checksum=checksum, source_rate_hz=RATE_HZ,
        source_frames=frames, actor=actor, clip=None if label is None else name[-4:], groups="{}", **{"class": label},
    )  # fmt: skip


def _truth(take_id: int, take: str, label: str, start: int, stop: int) -> dict[str, Any]:
    schema = result_schema("ground_truth")
    known = {
        "run": "benchmark", "take_id": take_id, "take": take, "class": label, "start": start, "stop": stop,
        "start_seconds": start / RATE_HZ, "stop_seconds": stop / RATE_HZ, "source_start": start, "source_stop": stop,
        "origin": "benchmark",
    }  # fmt: skip
    return {name: value for name, value in known.items() if name in schema.names}
