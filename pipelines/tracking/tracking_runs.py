"""Observe, track and stabilise several recordings; commit each result when done, skip unchanged recordings."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pyarrow as pa

from kinedex.catalog.camera_recordings import load_recordings
from kinedex.catalog.classes import load_classes
from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.priors.archive_poses import PriorMotion
from kinedex.ops.priors.stabilisation import LOGICAL
from kinedex.ops.tracking.band import solve_band
from kinedex.ops.wording import counted
from kinedex.pipelines.engine.code_digest import code_digest
from kinedex.pipelines.engine.digests import hash_of
from kinedex.pipelines.engine.display import Display
from kinedex.pipelines.engine.executors import Executor
from kinedex.pipelines.engine.run_id import new_run_id
from kinedex.pipelines.engine.stage import load_stage
from kinedex.pipelines.templates.stored_templates import stored_templates
from kinedex.pipelines.templates.template_learning import SubclassTemplate, TrainingClips, learn_templates
from kinedex.pipelines.templates.training import TemplateParameters, training_material
from kinedex.pipelines.tracking.archive_motions import PosesOfArchive, archive_motions, archive_poses, poses_table
from kinedex.pipelines.tracking.observed_recordings import (
    RECORDING_KINDS,
    read_named,
    recording_fingerprint,
    remarks_of,
    stored_rows,
)
from kinedex.pipelines.tracking.parameters import ObserveParameters, StabiliseParameters, TrackParameters
from kinedex.pipelines.tracking.recording_runs import (
    RecordingOutcome,
    RunContext,
    earlier_rows,
    is_compiled,
    put_for_takes,
    rebuild_index,
    run_tasks,
    take_ids_of,
)
from kinedex.pipelines.tracking.tracked_takes import TRACKED, stabilised_name
from kinedex.pipelines.tracking.tracking_tasks import (
    StabiliseTask,
    TrackTask,
    archive_body,
    stabilise_take,
    track_recording,
    tracked_row,
)
from kinedex.storage.lock import NO_WAIT, Wait
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.writer import StoreWriter

NO_LOCOMOTION = (
    "no class has `locomotion: true`, so the prior of a foot that moves to the front is absent; a class file gives it: "
    "--classes FILE, `classes:` of a pipeline"
)

STAGE = "stabilise/stabilise"
"""The stage of the results; it is the stage of the shipped pipeline, so that pipeline and command share results."""


def observe(writer: StoreWriter, params: ObserveParameters, place: RunContext) -> RecordingOutcome:
    """Read new and changed recordings, commit each, and return the outcome.

    Raises
    ------
    KinedexError
        The recordings file, or a file of a recording, is invalid; recordings before it remain in the store.
    """
    file = load_recordings(params.recordings)
    names = params.only or list(file.recordings)
    for name in names:
        file.entry(name)
    before = place.reusable(writer.store, "recordings", "recording")
    done = RecordingOutcome(names)
    for name in names:
        if before.get(name) == recording_fingerprint(file, name, place.code):
            done.unchanged.append(name)
            continue
        read = read_named(file, name, place.code)
        for kind in RECORDING_KINDS:
            put_for_takes(
                writer, kind, [read.table(kind, place.run)], stage=place.stage, run=place.run, column="recording",
                gone=[name],
            )  # fmt: skip
        writer.commit()
        if read.recording is None:
            place.message(f"{name}: the take '{read.given.track}' as a 3D track")
            continue
        found = read.recording
        keypoints = f"{len(found.keypoints)} keypoints" if found.keypoints else "silhouettes"
        place.message(
            f"{name}: {counted(len(found.cameras), 'camera')}, {counted(found.frames, 'frame')} at {found.rate_hz:g} "
            f"Hz, {keypoints}"
        )
        for remark in remarks_of(found):
            place.message(f"{name}: {remark}")
    return done


def track(
    writer: StoreWriter, params: TrackParameters, names: Sequence[str], observed: str, place: RunContext
) -> RecordingOutcome:
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
    place : RunContext
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
    """Return checksum and recipe of the takes that a recording names; if these change, it is tracked again."""
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
    place: RunContext,
) -> RecordingOutcome:
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
    place : RunContext
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
    writer: StoreWriter, params: StabiliseParameters, archive: Archive, place: RunContext, logical: bool
) -> tuple[list[PriorMotion], list[str]]:
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
        place.message(remark)
    return archive_motions(archive.templates, poses, store.feature_set, classes, params.delta), remarks


def _motion_parts(motion: PriorMotion) -> Iterable[object]:
    yield from (motion.name, motion.marks, motion.template.mask, motion.template.value)
    if motion.poses is not None:
        yield from (motion.poses.means, motion.poses.spreads, motion.poses.tilts)


def are_kernels_compiled() -> bool:
    """Return whether the kernels of the tracker are compiled on disk; True if numba is disabled."""
    return is_compiled(solve_band)


@dataclass(frozen=True)
class Explanation:
    """The priors of one stabilised take.

    Attributes
    ----------
    take : str
        The take that was stabilised.
    stabilised : str
        The resulting take.
    priors : pyarrow.Table
        Its rows of `priors`.
    row : dict
        Its row of `tracks`.
    moved_mm : float
        The mean distance by which joints were moved, in millimetres.
    """

    take: str
    stabilised: str
    priors: pa.Table
    row: dict[str, Any]
    moved_mm: float


def stabilise_stored(
    path: Path,
    takes: Sequence[str],
    params: StabiliseParameters,
    tracker: TrackParameters,
    executor: Executor,
    terminal: Display,
    wait: Wait = NO_WAIT,
    anew: bool = False,
) -> RecordingOutcome:
    """Stabilise takes of a store, and commit each.

    Parameters
    ----------
    path : Path
        The store.
    takes : sequence of str
        The takes.
    params : StabiliseParameters
        The priors.
    tracker : TrackParameters
        The tracker.
    executor : Executor
        Spreads takes over workers.
    terminal : Display
        Shows messages and progress.
    wait : Wait, optional
        The time to wait for another writer.
    anew : bool, optional
        True to stabilise takes that are up to date as well.

    Raises
    ------
    KinedexError
        A take is not in the store, or the store has no templates and nothing to learn them from.
    """
    opened = open_store(path, at="newest")
    require_takes(opened, takes)
    code = code_digest(type(load_stage("stabilise")))  # the same digest as in the pipeline
    place = RunContext(STAGE, new_run_id(), executor, terminal.message, terminal.progress, code, anew)
    with StoreWriter.open(path, opened.feature_set, opened.rate_hz, wait) as writer:
        archive = store_archive(writer.store, params, executor)
        done = stabilise(writer, params, tracker, list(dict.fromkeys(takes)), archive, place)
    rebuild_index(path, wait)
    return done


def store_archive(store: Store, params: StabiliseParameters, executor: Executor) -> Archive:
    """Return the templates of a store, or those learned from its takes with a class, with their example clips."""
    stored = stored_templates(store) if store.manifest.results.get("templates") else []
    found = [one.one for one in stored if one.one.kind == params.templates]
    try:
        clips = training_material(store, TemplateParameters.model_validate({})).clips
    except KinedexError:
        if not found:
            raise KinedexError(
                f"{store.path} has neither templates nor takes whose class is known, so that nothing provides priors; "
                "ingest example clips with a pattern that names their class, as in: kinedex ingest "
                f"{shlex.quote(str(store.path))} CLIPS --set \"ingest.patterns=['(?P<class>[^/]+)/']\". Without an "
                "archive, `kinedex track` smooths a take and fills its gaps: a recordings file with `track: TAKE`"
            ) from None
        clips = []
    if found:
        return Archive(found, _learned_from(found, clips))
    learned = learn_templates(clips, [params.templates], len(store.feature_set.features), executor)
    return Archive(sorted((one for group in learned for one in group), key=lambda one: one.subclass), clips)


def _learned_from(templates: Sequence[SubclassTemplate], clips: Sequence[TrainingClips]) -> list[TrainingClips]:
    """Return the clips that templates were learned from; all clips of a class whose template names none."""
    names = {one.subclass: {*one.clips} for one in templates}
    chosen = []
    for one in clips:
        own = [at for at, name in enumerate(one.names) if name in names.get(one.subclass, ())]
        if own and len(own) < len(one.names):
            parts = {key: tuple(getattr(one, key)[at] for at in own) for key in ("names", "words", "takes")}
            one = replace(one, names=parts["names"], words=parts["words"], takes=parts["takes"])
        chosen.append(one)
    return chosen


def explanations(store: Store, takes: Sequence[str]) -> list[Explanation]:
    """Return the priors of stabilised takes, given the names before stabilisation."""
    found = []
    for take in takes:
        name = stabilised_name(take)
        rows = {kind: store.rows_of(kind, STAGE, "take", [name]) for kind in ("tracks", "priors", "track_frames")}
        moved = [sum(one) / len(one) for one in rows["track_frames"].column("moved_mm").to_pylist() if one]
        priors = rows["priors"].drop_columns(["run", "take_id", "take"])
        row = rows["tracks"].to_pylist()[0]
        found.append(Explanation(take, name, priors, row, sum(moved) / len(moved) if moved else 0.0))
    return found
