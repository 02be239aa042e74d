"""Store takes that are made from recordings, and read the truth that such takes are compared with."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pyarrow as pa
from pydantic import Field

from kinedex.catalog.features import FeatureSet
from kinedex.catalog.skeletons.mappings import load_mappings
from kinedex.ops.arrays import F64
from kinedex.ops.body.resample import resample
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.engine.digests import Reading, hash_of
from kinedex.pipelines.engine.file_parameters import StageParameters
from kinedex.pipelines.ingestion.analysis import analyse, body_row
from kinedex.pipelines.ingestion.metadata import group_values
from kinedex.storage.formats.motion.reader import Body, ReadSettings
from kinedex.storage.formats.motion.reader_table import motion_endings, read_body
from kinedex.storage.snapshot.measured_columns import declarable_figures, stored_figures
from kinedex.storage.snapshot.parts import FramesWriter, joint_positions
from kinedex.storage.snapshot.schemas import RECORDED_FORMATS, TakeColumn, column_problem
from kinedex.storage.store.store import Store
from kinedex.storage.store.writer import StoreWriter

RECORDED_COLUMNS = {
    "recording": TakeColumn("VARCHAR", "file", meaning="the recording that the take was made of"),
    "cameras": TakeColumn("VARCHAR[]", "file", meaning="the cameras of that recording"),
}
"""The columns of takes that a store declares for takes made from recordings."""


@dataclass(frozen=True)
class Provenance:
    """The origin of a take made from a recording: its files.

    Attributes
    ----------
    root : str
        The folder of the main file: the recordings file, or the motion file of a 3D track.
    source : str
        The main file, relative to the folder.
    checksum : str
        A hash of the contents of all files of the recording.
    size : int
        Their size in bytes.
    mtime_ns : int
        Time of the latest change of any of these files, in nanoseconds since 1970.
    recording : str, optional
        The name of the recording; None for a stabilised take without a recording.
    cameras : tuple of str
        The names of its cameras.
    """

    root: str
    source: str
    checksum: str
    size: int
    mtime_ns: int
    recording: str | None = None
    cameras: tuple[str, ...] = ()


def stamp_of(settings: object, files: Iterable[tuple[str, Path]]) -> str:
    """Return a hash of the settings of a recording, and of its files by kind, path, size and time."""
    hasher = hashlib.sha256(repr(settings).encode())
    for kind, path in files:
        try:
            found = path.stat()
        except OSError as fault:
            raise KinedexError(f"{path}: cannot be read: {fault.strerror}") from None
        hasher.update(repr((kind, str(path), found.st_size, found.st_mtime_ns)).encode())
    return hasher.hexdigest()[:32]


class RecordedTake(Protocol):
    """A take made from a recording, before it is stored: its name, origin and joints."""

    @property
    def name(self) -> str:
        """The name of the take."""

    @property
    def format(self) -> str:
        """The format of the take, one of `RECORDED_FORMATS`."""

    @property
    def provenance(self) -> Provenance:
        """The origin of the take."""

    @property
    def recipe(self) -> str:
        """A hash of everything that determines the take, except its files."""

    @property
    def actor(self) -> str | None:
        """The actor; None if unknown."""

    def joints(self, features: FeatureSet) -> Body:
        """Return the joints of the take as those of a motion file, in the order of a feature set."""


def put_takes(writer: StoreWriter, takes: Sequence[RecordedTake]) -> dict[str, int]:
    """Add takes made from recordings to a store, each replacing an earlier one with its name; nothing is committed.

    Parameters
    ----------
    writer : StoreWriter
        The writer of the store.
    takes : sequence of RecordedTake
        The takes, with distinct names.

    Returns
    -------
    dict of str to int
        The id of each take by its name.

    Raises
    ------
    KinedexError
        A take of a motion file has the same name, or a column of the user has a name in `RECORDED_COLUMNS`.
    """
    if not takes:
        return {}
    refuse_names(writer.store, [take.name for take in takes])
    declare_recorded_columns(writer)
    ids = writer.assign_take_ids(take.name for take in takes)
    features, rate_hz = writer.manifest.feature_set, writer.manifest.rate_hz
    figures = stored_figures(writer.columns)
    rows = []
    with FramesWriter(writer.path, features, rate_hz) as frames:
        for take in sorted(takes, key=lambda take: ids[take.name]):
            body = take.joints(features)
            analysed = analyse(body, features, rate_hz)
            frames.add(ids[take.name], *analysed)
            rows.append(_row(take, ids[take.name], body_row(body, analysed[2], features, rate_hz, figures)))
        part = frames.close()
    writer.add_takes(pa.Table.from_pylist(rows, schema=writer.takes_schema), part)
    return ids


def refuse_names(store: Store, names: Sequence[str]) -> None:
    """Raise a KinedexError if a take of a motion file has one of the names."""
    rows = store.take_rows.select(["name", "format", "source_root", "source"]).to_pylist()
    for row in rows:
        if row["name"] in names and row["format"] not in RECORDED_FORMATS:
            raise KinedexError(
                f"the store has a take '{row['name']}' already, from {row['source_root']}/{row['source']}, and that "
                "of a recording would have this name; name the recording otherwise, or remove the take: "
                f"kinedex takes remove {store.path} {row['name']}"
            )


def declare_recorded_columns(writer: StoreWriter) -> None:
    """Declare the columns of takes made from recordings; raise a KinedexError if the user has such a column."""
    for name, column in RECORDED_COLUMNS.items():
        if (problem := column_problem(name, column, writer.columns)) is not None:
            raise KinedexError(
                f"{writer.path}: takes of recordings need the column '{name}', and {problem}; ingest the motion files "
                "into a new store with another name of that column"
            )
    writer.declare_columns(RECORDED_COLUMNS)
    writer.declare_columns(declarable_figures(writer.columns)[0])


def _row(take: RecordedTake, take_id: int, judged: dict[str, Any]) -> dict[str, Any]:
    origin = take.provenance
    return (
        judged
        | group_values({} if take.actor is None else {"actor": take.actor})
        | {
            "take_id": take_id,
            "name": take.name,
            "source": origin.source,
            "source_root": origin.root,
            "checksum": origin.checksum,
            "source_bytes": origin.size,
            "source_mtime_ns": origin.mtime_ns,
            "format": take.format,
            "skeleton_source": None,
            "recipe": take.recipe,
            "recording": origin.recording,
            "cameras": list(origin.cameras),
        }
    )


class TruthParameters(StageParameters):
    """The parameters of the stages that compare takes of recordings with the truth."""

    truth: str | None = Field(
        None,
        description="a take, or a motion file, that all takes are compared with; that of the recording unless given",
    )


def every_take(store: Store) -> Reading:
    """Return a digest of all takes of a store, any of which can be the truth."""
    rows = store.take_rows.to_pylist()
    return Reading(hash_of(sorted((row["name"], row["checksum"], row["recipe"]) for row in rows)), "")


@dataclass(frozen=True, eq=False)
class TruePositions:
    """The true positions of joints over time.

    Attributes
    ----------
    name : str
        The name of the take or file.
    joints : float64 array (J, 3, T)
        Positions of joints in metres; NaN if unknown.
    rate_hz : float
        Frames per second.
    failures : tuple of (int, int)
        Half-open ranges of its frames in which the observations are known to fail.
    """

    name: str
    joints: F64
    rate_hz: float
    failures: tuple[tuple[int, int], ...] = ()


def take_positions(store: Store, take: str, joints: tuple[str, ...]) -> F64:
    """Return joint positions (J, 3, T) of a take of the store in metres; NaN if unknown."""
    positions = joint_positions(store.frames(take), store.feature_set.joints).astype(np.float64)
    at = {name: positions[j] for j, name in enumerate(store.feature_set.joints)}
    nowhere = np.full(positions.shape[1:], np.nan)
    return np.stack([at.get(name, nowhere) for name in joints])


def read_truth(
    store: Store, truth: str, folder: Path, joints: tuple[str, ...], rate_hz: float | None = None
) -> TruePositions:
    """Return the truth of a recording.

    Parameters
    ----------
    store : Store
        The store.
    truth : str
        A take of the store, or a motion file of any format, with joints as positions or angles.
    folder : Path
        The folder that relative paths start from.
    joints : tuple of str
        The joints, in the order of the result; estimated ones count as unknown.
    rate_hz : float, optional
        Frames per second of a file that does not state them.

    Raises
    ------
    KinedexError
        `truth` is neither a take nor a motion file.
    """
    if truth in store.take_ids:
        return TruePositions(truth, take_positions(store, truth, joints), store.rate_hz)
    file = folder / Path(truth).expanduser()
    if not file.is_file() or file.suffix.lower() not in motion_endings():
        raise KinedexError(
            f"truth '{truth}' is neither a take of the store nor a motion file ({file}); give one of them, or null"
        )
    body = read_body(file, None, load_mappings("auto", joints), joints, ReadSettings(rate_hz=rate_hz))
    known = np.array([joint not in body.estimated for joint in joints])
    return TruePositions(str(truth), np.where(known[:, None, None], body.positions, np.nan), body.rate_hz)


def at_rate(positions: F64, source_rate_hz: float, rate_hz: float) -> F64:
    """Return positions (J, 3, T) resampled to another rate."""
    if source_rate_hz == rate_hz:
        return positions
    rotations = np.tile(np.array([[1.0], [0.0], [0.0], [0.0]]), positions.shape[2])
    return resample(positions, rotations, source_rate_hz, rate_hz).positions
