"""Read the limbs of stored takes from their source files, at the rate of these files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from kinedex.catalog.skeletons.mappings import Mappings
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.engine.digests import hash_of
from kinedex.pipelines.inertial.limb_motion import TakeLimbs, take_limbs
from kinedex.pipelines.ingestion.take_sources import Sources, ingest_settings, known_stages
from kinedex.storage.formats.motion.body_limbs import BodyLimbs, read_body_limbs
from kinedex.storage.formats.motion.reader import Body, MotionFile, ReadSettings
from kinedex.storage.snapshot.parts import joint_positions
from kinedex.storage.snapshot.schemas import RECORDED_FORMATS
from kinedex.storage.store.store import Store


@dataclass(frozen=True, eq=False)
class LimbTask:
    """A take whose limbs are to be read, as a task for a worker.

    Attributes
    ----------
    take_id : int
        Its id.
    take : str
        Its name.
    joints : tuple of str
        The named joints of the store.
    limbs : tuple of str
        The names of the limbs to read.
    file : MotionFile or None
        Its source file; None for a take made from a recording, whose joints are read from the store.
    mappings : Mappings or None
        The skeleton mappings that it was read with.
    settings : ReadSettings or None
        The settings that it was read with.
    body : Body or None
        The joints of a take made from a recording.
    """

    take_id: int
    take: str
    joints: tuple[str, ...]
    limbs: tuple[str, ...]
    file: MotionFile | None = None
    mappings: Mappings | None = None
    settings: ReadSettings | None = None
    body: Body | None = None


def sources_of(store: Store) -> Sources:
    """Return the sources of the takes of a store, with the settings that they were read with."""
    return Sources(store, ingest_settings(store.manifest, known_stages(store.path)))


def limb_tasks(store: Store, takes: Sequence[str], limbs: tuple[str, ...]) -> list[LimbTask]:
    """Return the tasks that read the limbs of takes, in the order of the takes.

    Parameters
    ----------
    store : Store
        The store.
    takes : sequence of str
        Names of takes.
    limbs : tuple of str
        The names of the limbs to read.

    Raises
    ------
    KinedexError
        The source of a take no longer exists or was changed; the message names it and the remedy.
    """
    wanted = set(takes)
    rows = {row["name"]: row for row in store.take_rows.to_pylist() if row["name"] in wanted}
    joints = store.feature_set.joints
    tasks = {
        name: LimbTask(row["take_id"], name, joints, limbs)
        for name, row in rows.items()
        if row["format"] in RECORDED_FORMATS
    }
    found = sources_of(store).find([row["take_id"] for name, row in rows.items() if name not in tasks])
    if found.lost:
        lost = found.lost[0]
        more = f" (and {len(found.lost) - 1} more takes)" if len(found.lost) > 1 else ""
        raise KinedexError(
            f"take '{lost.name}'{more}: its source {lost.why}, and limbs are read from sources; put the file back, "
            f"or ingest it as it is now with `kinedex ingest {store.path} {Path(rows[lost.name]['source_root'])}`, or "
            "leave the take out with `where`"
        )
    for batch in found.batches:
        for one in batch.tasks:
            skeleton = one.skeleton.absolute if one.skeleton is not None else None
            file = MotionFile(one.motion.absolute, skeleton, person=one.person or "")
            tasks[one.name] = LimbTask(one.take_id, one.name, joints, limbs, file, batch.mappings, batch.given)
    return [tasks[name] for name in takes]


def with_stored_body(task: LimbTask, store: Store) -> LimbTask:
    """Return the task with joints from the store if its take was made from a recording; else return it unchanged."""
    if task.file is not None:
        return task
    table = store.frames(task.take).combine_chunks()
    positions = np.ascontiguousarray(joint_positions(table, task.joints), np.float64)
    frames = positions.shape[2]
    unknown = tuple(joint for joint, place in zip(task.joints, positions, strict=True) if np.isnan(place).all())
    body = Body(positions, np.full((4, frames), np.nan), store.rate_hz, "1 m", "", unknown, ())
    return replace(task, body=body)


def read_limbs(task: LimbTask) -> TakeLimbs:
    """Read the limbs of a take.

    Raises
    ------
    SourceError
        The source cannot be read.
    """
    if task.file is None:
        assert task.body is not None
        segments = BodyLimbs(task.body)
    else:
        assert task.mappings is not None
        assert task.settings is not None
        segments = read_body_limbs(task.file, task.mappings, task.joints, task.settings, task.limbs)
    return take_limbs(segments, task.joints, task.limbs)


def reading_digest(store: Store, takes: Sequence[str]) -> str:
    """Return a hash of everything in a store that determines the limbs of takes: sources and skeleton mappings."""
    wanted = set(takes)
    rows = [row for row in store.take_rows.to_pylist() if row["name"] in wanted]
    return hash_of(
        [(row["name"], row["checksum"], row["recipe"], row["frames"]) for row in rows],
        store.rate_hz,
        [_stated_limbs(mappings) for mappings in sources_of(store).mappings],
    )


def limb_fingerprints(store: Store, takes: Sequence[str], *more: object) -> dict[int, str]:
    """Return a hash of everything that determines the limbs of each take, by take_id, in the order of names."""
    wanted = set(takes)
    # another source folder with the same mappings does not change the hashes of existing takes
    stated = {repr(_stated_limbs(mappings)) for mappings in sources_of(store).mappings}
    shared = hash_of([list(store.feature_set.joints), store.rate_hz, *more], sorted(stated))
    return {
        row["take_id"]: hash_of(shared, row["take_id"], row["name"], row["checksum"], row["recipe"], row["frames"])
        for row in store.take_rows.to_pylist()
        if row["name"] in wanted
    }


def _stated_limbs(mappings: Mappings) -> list[object]:
    every = [one for group in (mappings.own, mappings.of_format) for some in group.values() for one in some]
    return [
        [one.name, limb, source.node, list(source.markers), list(source.axis)]
        for one in every
        for limb, source in one.limbs.items()
    ]
