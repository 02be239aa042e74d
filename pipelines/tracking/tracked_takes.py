"""Takes that were tracked or stabilised: how they enter the store, beside those that were read from motion files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from kinedex.catalog.features import FeatureSet
from kinedex.ops.body.kinematic_chain import ChainBody, Poses, forward
from kinedex.ops.body.kinematics import quaternions
from kinedex.ops.errors import KinedexError
from kinedex.ops.words import NO_WORD
from kinedex.pipelines.ingestion.analysis import analyse, blind, known_features
from kinedex.pipelines.ingestion.described_takes import group_values
from kinedex.pipelines.ingestion.quality import declarable_figures, judged, stored_figures
from kinedex.storage.formats.motion.reader import Body
from kinedex.storage.snapshot.parts import FramesWriter
from kinedex.storage.snapshot.schemas import TRACK_FORMAT, TakeColumn, column_problem
from kinedex.storage.store.store import Store
from kinedex.storage.store.writer import StoreWriter

Bool = npt.NDArray[np.bool_]

TRACKED, STABILISED = "_tracked", "_stabilised"
"""The ends of the names of takes that were tracked from a recording, and of those that were stabilised."""

UNSEEN_S = 0.5
"""Frames that no camera has seen for longer than this are invalid."""

TRACK_COLUMNS = {
    "recording": TakeColumn("VARCHAR", "file", meaning="the recording that the take was tracked from"),
    "cameras": TakeColumn("VARCHAR[]", "file", meaning="the cameras of that recording"),
}
"""The declared columns of takes in a store with tracks."""


@dataclass(frozen=True)
class Provenance:
    """The origin of a track: the files that it follows from.

    Attributes
    ----------
    root : str
        The folder of the main file: the recordings file, or the motion file of a 3D track.
    source : str
        That file, relative to the folder.
    checksum : str
        A hash of the contents of all files of the recording.
    size : int
        Their size in bytes.
    mtime_ns : int
        Time of the latest change of one of them, in nanoseconds since 1970.
    recording : str, optional
        The name of the recording; None for a take that was stabilised without one.
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


@dataclass(frozen=True, eq=False)
class Track:
    """A take that was tracked or stabilised.

    Attributes
    ----------
    name : str
        Its name.
    provenance : Provenance
        Its origin.
    body : ChainBody
        The body, with its lengths.
    poses : Poses
        Its poses, at the rate of the recording.
    rate_hz : float
        Frames per second of the poses.
    valid : bool array (T,)
        False in frames in which nothing was observed for more than `UNSEEN_S`.
    recipe : str
        A hash of all that the track follows from besides its files.
    actor : str, optional
        The actor.
    warnings : tuple of str
        Reservations about it.
    """

    name: str
    provenance: Provenance
    body: ChainBody
    poses: Poses
    rate_hz: float
    valid: Bool
    recipe: str
    actor: str | None = None
    warnings: tuple[str, ...] = ()


def observed_frames(seen: Bool, rate_hz: float) -> Bool:
    """Return the frames of a track that are valid: all but those in gaps of the observation of more than 0.5 s.

    Parameters
    ----------
    seen : bool array (T,)
        The frames in which something was observed.
    rate_hz : float
        Frames per second.
    """
    valid = seen.copy()
    edges = np.flatnonzero(np.diff(np.concatenate([[True], seen, [True]])))
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        if stop - start <= UNSEEN_S * rate_hz:
            valid[start:stop] = True
    return valid


def stabilised_name(take: str) -> str:
    """Return the name of a take once it is stabilised; that of a tracked one without its end."""
    return take.removesuffix(TRACKED) + STABILISED


def put_tracks(writer: StoreWriter, tracks: Sequence[Track]) -> dict[str, int]:
    """Add tracks to a store as takes, each whole in place of an earlier one; nothing is committed.

    Parameters
    ----------
    writer : StoreWriter
        The writer of the store.
    tracks : sequence of Track
        The tracks, whose names differ.

    Returns
    -------
    dict of str to int
        The id of each track by its name.

    Raises
    ------
    KinedexError
        A take of a motion file has the name of a track, or a column of the user's that of `TRACK_COLUMNS`.
    """
    if not tracks:
        return {}
    refuse_names(writer.store, [track.name for track in tracks])
    declare_track_columns(writer)
    ids = writer.assign_take_ids(track.name for track in tracks)
    features, rate_hz = writer.manifest.feature_set, writer.manifest.rate_hz
    figures = stored_figures(writer.columns)
    rows = []
    with FramesWriter(writer.path, features, rate_hz) as frames:
        for track in sorted(tracks, key=lambda track: ids[track.name]):
            body = track_body(track, features)
            analysed = analyse(body, features, rate_hz)
            frames.add(ids[track.name], *analysed)
            rows.append(_row(track, ids[track.name], body, analysed[2], features, rate_hz, figures))
        part = frames.close()
    writer.add_takes(pa.Table.from_pylist(rows, schema=writer.takes_schema), part)
    return ids


def refuse_names(store: Store, names: Sequence[str]) -> None:
    """Raise a KinedexError if a take of a motion file has one of the names."""
    rows = store.take_rows.select(["name", "format", "source_root", "source"]).to_pylist()
    for row in rows:
        if row["name"] in names and row["format"] != TRACK_FORMAT:
            raise KinedexError(
                f"the store has a take '{row['name']}' already, from {row['source_root']}/{row['source']}, and a track "
                "would have this name; name the recording otherwise, or remove the take: "
                f"kinedex takes remove {store.path} {row['name']}"
            )


def declare_track_columns(writer: StoreWriter) -> None:
    """Declare the columns of tracks; a KinedexError reports that a column of the user's has such a name."""
    for name, column in TRACK_COLUMNS.items():
        if (problem := column_problem(name, column, writer.columns)) is not None:
            raise KinedexError(
                f"{writer.path}: tracks need the column '{name}' of takes, and {problem}; ingest the motion files into "
                "a new store with another name of that column"
            )
    writer.declare_columns(TRACK_COLUMNS)
    writer.declare_columns(declarable_figures(writer.columns)[0])


def track_body(track: Track, features: FeatureSet) -> Body:
    """Return the joints of a track as those of a motion file, in the order of a feature set."""
    chain = track.body.chain
    positions, turned = forward(track.body, track.poses)
    at = {name: positions[j] for j, name in enumerate(chain.joints)}
    unknown = tuple(joint for joint in features.joints if joint not in at)
    nowhere = np.full((3, positions.shape[2]), np.nan)
    return Body(
        positions=np.stack([at.get(joint, nowhere) for joint in features.joints]),
        orientation=quaternions(turned[:, 0].reshape(-1, 9).T),
        rate_hz=track.rate_hz,
        unit="metre",
        skeleton=chain.name,
        unknown=unknown,
        warnings=track.warnings,
        valid=None if track.valid.all() else track.valid,
    )


def _row(
    track: Track,
    take_id: int,
    body: Body,
    words: npt.NDArray[np.uint64],
    features: FeatureSet,
    rate_hz: float,
    figures: frozenset[str],
) -> dict[str, Any]:
    known, origin = known_features(features, body), track.provenance
    columns, doubts = judged(body, features.joints, figures)
    return (
        columns
        | group_values({} if track.actor is None else {"actor": track.actor})
        | {
            "take_id": take_id,
            "name": track.name,
            "source": origin.source,
            "source_root": origin.root,
            "checksum": origin.checksum,
            "source_bytes": origin.size,
            "source_mtime_ns": origin.mtime_ns,
            "format": TRACK_FORMAT,
            "skeleton": body.skeleton,
            "skeleton_source": None,
            "recipe": track.recipe,
            "unit": body.unit,
            "source_rate_hz": body.rate_hz,
            "source_frames": body.frames,
            "rate_hz": rate_hz,
            "frames": len(words),
            "seconds": body.frames / body.rate_hz,
            "invalid_frames": int(np.count_nonzero(words == NO_WORD)),
            "warnings": [*body.warnings, *blind(features, body), *doubts],
            "recording": origin.recording,
            "cameras": list(origin.cameras),
            "known": None if known == features.every_bit else known,
        }
    )
