"""Observe, track and stabilise several recordings; commit each result when done, skip unchanged recordings."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from kinedex.catalog.classes import load_classes
from kinedex.catalog.recordings import load_recordings
from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.priors.motion import Motion
from kinedex.ops.priors.stabilise import LOGICAL
from kinedex.ops.tracking.band import solve_band
from kinedex.ops.wording import counted
from kinedex.pipelines.engine.digests import hash_of
from kinedex.pipelines.recordings.runs import Outcome, Place, is_compiled, run_tasks, take_ids_of
from kinedex.pipelines.recordings.stored_results import earlier_rows, put_beside
from kinedex.pipelines.templates.learning import SubclassTemplate, TrainingClips
from kinedex.pipelines.tracking.archive_motions import PosesOfArchive, archive_motions, archive_poses, poses_table
from kinedex.pipelines.tracking.bodies import archive_body
from kinedex.pipelines.tracking.parameters import ObserveParameters, StabiliseParameters, TrackParameters
from kinedex.pipelines.tracking.recordings import (
    RECORDING_KINDS,
    read_named,
    recording_fingerprint,
    remarks_of,
    stored_rows,
)
from kinedex.pipelines.tracking.tracked_takes import (
    TRACKED,
    stabilised_name,
)
from kinedex.pipelines.tracking.work import (
    StabiliseTask,
    TrackTask,
    stabilise_take,
    track_recording,
    tracked_row,
)
from kinedex.storage.store.store import Store
from kinedex.storage.store.writer import StoreWriter

NO_LOCOMOTION = (
    "no class has `locomotion: true`, so the prior of a foot that moves to the front is absent; a class file gives it: "
    "--classes FILE, `classes:` of a pipeline"
)


def observe(writer: StoreWriter, params: ObserveParameters, place: Place) -> Outcome:
    """Read new and changed recordings, commit each, and return the outcome.

    Raises
    ------
    KinedexError
        The recordings file, or a file of a recording, is invalid; recordings before it remain in the store.
    """
    file = load_recordings(params.recordings)
    names = params.only or list(file.recordings)
    for name in names:
        file.recording(name)
    before = place.reusable(writer.store, "recordings", "recording")
    done = Outcome(names)
    for name in names:
        if before.get(name) == recording_fingerprint(file, name, place.code):
            done.unchanged.append(name)
            continue
        read = read_named(file, name, place.code)
        for kind in RECORDING_KINDS:
            put_beside(
                writer, kind, [read.table(kind, place.run)], stage=place.stage, run=place.run, column="recording",
                gone=[name],
            )  # fmt: skip
        writer.commit()
        if read.recording is None:
            place.say(f"{name}: the take '{read.given.track}' as a 3D track")
            continue
        found = read.recording
        keypoints = f"{len(found.keypoints)} keypoints" if found.keypoints else "silhouettes"
        place.say(
            f"{name}: {counted(len(found.cameras), 'camera')}, {counted(found.frames, 'frame')} at {found.rate_hz:g} "
            f"Hz, {keypoints}"
        )
        for remark in remarks_of(found):
            place.say(f"{name}: {remark}")
    return done


def track(writer: StoreWriter, params: TrackParameters, names: Sequence[str], observed: str, place: Place) -> Outcome:
    """Track recordings that a stage has observed, commit each as a take, and return the outcome.

    Parameters
    ----------
    writer : StoreWriter
        The writer of the store.
    params : TrackParameters
        The tracker.
    names : sequence of str
        The recordings.
    observed : str
        The stage that has read them, "<pipeline>/<stage>".
    place : Place
        The stage and run of the results.
    """
    store = writer.store
    rows = stored_rows(store, observed)
    ids = take_ids_of(writer, [f"{name}{TRACKED}" for name in names])
    mean = archive_body(store)
    tasks = [
        TrackTask(
            writer.store, observed, name, f"{name}{TRACKED}", ids[f"{name}{TRACKED}"], params, mean,
            hash_of(
                place.code, params.model_dump(), rows[name]["fingerprint"], _named(store, rows[name]), mean.offsets
            ),
            place.run,
        )
        for name in names
    ]  # fmt: skip
    return run_tasks(writer, place, "tracks", track_recording, tasks, are_kernels_compiled)


def _named(store: Store, row: dict[str, object]) -> list[object]:
    """Return checksum and recipe of the takes that a recording names, so that it is tracked again when they change."""
    rows = {one["name"]: (one["checksum"], one["recipe"]) for one in store.take_rows.to_pylist()}
    return [rows.get(str(row[key])) for key in ("body", "track")]


@dataclass(frozen=True, eq=False)
class Archive:
    """The data of an archive from which priors are made.

    Attributes
    ----------
    templates : sequence of SubclassTemplate
        Its templates.
    clips : sequence of TrainingClips
        Their example clips.
    """

    templates: Sequence[SubclassTemplate]
    clips: Sequence[TrainingClips]


def stabilise(
    writer: StoreWriter,
    params: StabiliseParameters,
    tracker: TrackParameters,
    takes: Sequence[str],
    archive: Archive,
    place: Place,
) -> Outcome:
    """Stabilise takes by priors of an archive, commit each, and return the outcome.

    Parameters
    ----------
    writer : StoreWriter
        The writer of the store.
    params : StabiliseParameters
        The priors.
    tracker : TrackParameters
        The tracker of takes that come from recordings.
    takes : sequence of str
        The takes.
    archive : Archive
        The archive.
    place : Place
        The stage and run of the results.

    Raises
    ------
    KinedexError
        A take is not in the store, is a stabilised one, or would replace a stabilised one of another take.
    """
    store = writer.store
    require_takes(store, takes)
    _refuse_stabilised(store, takes)
    settings = {take: params.settings(_is_silhouettes_only(store, take), store.rate_hz) for take in takes}
    motions, remarks = _motions(writer, params, archive, place, any(LOGICAL in one.kinds for one in settings.values()))
    mean, ids = archive_body(store), take_ids_of(writer, map(stabilised_name, takes))
    lent = hash_of(*(part for motion in motions for part in _motion_parts(motion)))
    chosen = (params.model_dump(exclude={"takes"}), tracker.model_dump())
    rows = {row["name"]: row for row in store.take_rows.to_pylist()}
    tasks = []
    for take in takes:
        tracked, name = tracked_row(store, take), stabilised_name(take)
        follows = (rows[take]["checksum"], rows[take]["recipe"], tracked and tracked["fingerprint"])
        tasks.append(
            StabiliseTask(
                writer.store, take, name, ids[name], tracker, params.sigma_m, params.body, mean,
                settings[take], motions,
                hash_of(place.code, chosen, lent, follows, mean.offsets), place.run,
            )
        )  # fmt: skip
    done = run_tasks(writer, place, "tracks", stabilise_take, tasks, are_kernels_compiled)
    done.remarks += remarks
    return done


def require_takes(store: Store, takes: Iterable[str]) -> None:
    """Raise a KinedexError, which suggests the nearest name, if the store lacks one of the takes."""
    for take in takes:
        if take not in store.take_ids:
            raise KinedexError(f"{store.path}: no take '{take}'{did_you_mean(take, store.take_ids)}")


def _refuse_stabilised(store: Store, takes: Iterable[str]) -> None:
    """Raise a KinedexError if a take is already stabilised, or its new name belongs to the result of another take."""
    origins: dict[str, str] = {}
    for rows in store.result_pieces("tracks", store.manifest.results.get("tracks", ())):
        for row in rows.to_pylist():
            if row["track_of"] is not None and store.take_ids.get(row["take"]) == row["take_id"]:
                origins[row["take"]] = row["track_of"]
    for take in takes:
        if take in origins:
            raise KinedexError(
                f"take '{take}' is stabilised already; stabilise '{origins[take]}' again, with other settings"
            )
        name = stabilised_name(take)
        other = origins.setdefault(name, take)
        if other != take:
            raise KinedexError(
                f"take '{take}' would become '{name}', and so does '{other}'; stabilise one of them, or remove the "
                f"result of the other first: kinedex takes remove {store.path} {name}"
            )


def _is_silhouettes_only(store: Store, take: str) -> bool:
    tracked = tracked_row(store, take)
    row = None if tracked is None else stored_rows(store).get(tracked["recording"])
    return row is not None and bool(row["silhouettes"]) and not row["keypoints"]


def _motions(
    writer: StoreWriter, params: StabiliseParameters, archive: Archive, place: Place, logical: bool
) -> tuple[list[Motion], list[str]]:
    """Return the motions of an archive, with poses if requested; newly fitted poses are stored."""
    store = writer.store
    poses: PosesOfArchive | None = None
    remarks: list[str] = []
    if params.priors is None or "archive" in params.priors:
        poses = archive_poses(
            store, archive.clips, archive.templates, place.executor, place.code,
            [] if place.anew else earlier_rows(store, "archive_poses", place.stage),
        )  # fmt: skip
        table = poses_table(poses.classes.values(), place.run)
        writer.put_results("archive_poses", table, stage=place.stage, run=place.run)
        remarks = poses.remarks
    classes = load_classes(params.classes, [one.subclass for one in archive.templates])
    if logical and not any(one.locomotion for one in classes.classes):
        remarks = [*remarks, NO_LOCOMOTION]
    for remark in remarks:
        place.say(remark)
    return archive_motions(archive.templates, poses, store.feature_set, classes, params.delta), remarks


def _motion_parts(motion: Motion) -> Iterable[object]:
    yield from (motion.name, motion.marks, motion.template.mask, motion.template.value)
    if motion.poses is not None:
        yield from (motion.poses.means, motion.poses.spreads, motion.poses.tilts)


def are_kernels_compiled() -> bool:
    """Return whether the kernels of the tracker are compiled on disk; True if numba is disabled."""
    return is_compiled(solve_band)
