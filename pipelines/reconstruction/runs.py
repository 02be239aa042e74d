"""Reconstruct several depth recordings; each take is committed when done, unchanged recordings are skipped."""

from __future__ import annotations

from collections.abc import Sequence

from kinedex.catalog.depth_recordings import load_depth_recordings
from kinedex.ops.depth.lookup import near_maps
from kinedex.pipelines.engine.digests import hash_of
from kinedex.pipelines.reconstruction.parameters import ReconstructParameters
from kinedex.pipelines.reconstruction.pose_database import PoseDatabase
from kinedex.pipelines.reconstruction.reconstructed_takes import RECONSTRUCTED
from kinedex.pipelines.reconstruction.work import (
    ReconstructTask,
    files_stamp,
    reconstruct_recording,
    stored_database,
)
from kinedex.pipelines.recordings.runs import Outcome, Place, is_compiled, run_tasks, take_ids_of
from kinedex.storage.store.store import Store
from kinedex.storage.store.writer import StoreWriter


def chosen_recordings(params: ReconstructParameters) -> list[str]:
    """Return the names of the recordings that the parameters select.

    Raises
    ------
    ConfigError
        The file is invalid, or has no recording with a given name.
    """
    file = load_depth_recordings(params.recordings)
    for name in params.only:
        file.entry(name)
    return list(dict.fromkeys(params.only)) or list(file.recordings)


def named_bodies(params: ReconstructParameters) -> dict[str, str]:
    """Return the body of each selected recording: a take, or `estimate`."""
    file = load_depth_recordings(params.recordings)
    return {name: file.entry(name).body or params.body for name in chosen_recordings(params)}


def reconstruct(writer: StoreWriter, params: ReconstructParameters, database: str, place: Place) -> Outcome:
    """Reconstruct depth recordings, commit each as a take, and return the outcome.

    Parameters
    ----------
    writer : StoreWriter
        The writer of the store.
    params : ReconstructParameters
        The recordings and the tracker.
    database : str
        The stage that has the pose database, "<pipeline>/<stage>".
    place : Place
        The stage and run of the results.

    Raises
    ------
    KinedexError
        A recording, or a file that it names, is invalid; recordings before it remain in the store.
    """
    file, names = load_depth_recordings(params.recordings), chosen_recordings(params)
    store, bodies = writer.store, named_bodies(params)
    takes = {name: f"{name}{RECONSTRUCTED}" for name in names}
    ids = take_ids_of(writer, takes.values())
    poses = _digest(stored_database(store, database))
    chosen = params.model_dump(exclude={"recordings", "only", "body"})
    tasks = [
        ReconstructTask(
            writer.store, database, name, takes[name], ids[takes[name]], params,
            hash_of(place.code, chosen, poses, files_stamp(file, name), take_digest(store, [bodies[name]])), place.run,
        )
        for name in names
    ]  # fmt: skip
    return run_tasks(writer, place, "reconstructions", reconstruct_recording, tasks, lambda: is_compiled(near_maps))


def take_digest(store: Store, takes: Sequence[str]) -> str:
    """Return a hash of the takes that provide bones: of their names, files and recipes."""
    rows = {row["name"]: (row["checksum"], row["recipe"]) for row in store.take_rows.to_pylist()}
    return hash_of(*((name, rows.get(name)) for name in sorted(set(takes))))


def _digest(database: PoseDatabase) -> str:
    return hash_of(database.directions, database.origins, database.mean_bones)
