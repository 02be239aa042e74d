"""Store takes that are made from recordings, beside those that were read from motion files."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import pyarrow as pa

from kinedex.catalog.features import FeatureSet
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.ingestion.analysis import (
    analyse,
    body_row,
    declarable_figures,
    stored_figures,
)
from kinedex.pipelines.ingestion.described_takes import group_values
from kinedex.storage.formats.motion.reader import Body
from kinedex.storage.snapshot.parts import FramesWriter
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
        """A hash of everything except its files that determines the take."""

    @property
    def actor(self) -> str | None:
        """The actor, if known."""

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
