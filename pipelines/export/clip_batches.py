"""Compute the motions of clips and write them, take by take, in this process or in workers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from kinedex.catalog.features import FeatureSet
from kinedex.ops.arrays import F64, U64
from kinedex.ops.body.facing_direction import (
    Placement,
    mirrored_positions,
    mirrored_quaternions,
    placement_of,
    start_at_origin,
    turned_quaternions,
)
from kinedex.ops.body.resample import covered_frames, resample
from kinedex.ops.errors import KinedexError, ParameterError
from kinedex.pipelines.export.clips import Clip
from kinedex.pipelines.export.request import FILE_FORMATS, ClipOptions
from kinedex.storage.durable_files import whole_file
from kinedex.storage.formats.data_set_folder import WrittenFile, sha256_of
from kinedex.storage.formats.motion.joint_motion import JointMotion
from kinedex.storage.snapshot.frames import read_takes, words_of
from kinedex.storage.snapshot.parts import joint_positions
from kinedex.storage.store.store import Store

if TYPE_CHECKING:
    from kinedex.catalog.skeletons.mappings import Mappings
    from kinedex.storage.formats.motion.channel_cuts import SourceCut


_PAIRS = ("hip", "shoulder")

CLIPS_A_TASK = 50
"""The approximate number of clips in a task; after an interruption, each worker repeats at most one task."""


def clip_motion(frames: pa.Table, clip: Clip, how: ClipOptions, features: FeatureSet, rate_hz: float) -> JointMotion:
    """Return the motion of a clip's joints.

    Positions are interpolated between frames; words are those of the nearest frame. The words of a mirrored clip are
    those of the clip with left and right exchanged; there are none if the feature set has no pairs of features.

    Parameters
    ----------
    frames : pyarrow.Table
        All frames of the take.
    clip : Clip
        The clip.
    how : ClipOptions
        The requested processing.
    features : FeatureSet
        The features of the store.
    rate_hz : float
        Frames per second of the store.

    Raises
    ------
    KinedexError
        The body's position or facing direction is unknown in the frame that should lie at the origin.
    """
    rows = frames.slice(clip.first, clip.last - clip.first).combine_chunks()
    places: F64 = joint_positions(rows, features.joints).transpose(2, 0, 1).astype(np.float64)
    parts = rows.column("root_orientation").combine_chunks().flatten()
    rotations: F64 = np.stack([part.to_numpy(zero_copy_only=False) for part in parts], axis=1).astype(np.float64)
    words: U64 | None = words_of(rows)
    if clip.mirrored:
        places, rotations = mirrored_positions(places, features.joints), mirrored_quaternions(rotations)
        words = features.mirrored(words) if words is not None and features.mirror else None
    if how.in_place:
        start = clip_placement(places[clip.start - clip.first], features.joints, clip)
        places, rotations = start_at_origin(places, start), turned_quaternions(rotations, -start.yaw)
    if how.rate_hz is not None and how.rate_hz != rate_hz:
        nearest = np.floor(np.arange(frames_at(len(places), rate_hz, how.rate_hz)) * (rate_hz / how.rate_hz) + 0.5)
        words = None if words is None else words[np.minimum(nearest.astype(np.int64), len(words) - 1)]
        sampled = resample(places.transpose(1, 2, 0), rotations.T, rate_hz, how.rate_hz)
        places, rotations = sampled.positions.transpose(2, 0, 1), sampled.orientation.T
    stored, turned = (np.ascontiguousarray(one, np.float32) for one in (places, rotations))
    return JointMotion(clip.name, tuple(features.joints), stored, how.rate_hz or rate_hz, words, turned)


def frames_at(frames: int, before_hz: float, after_hz: float) -> int:
    """Return the number of frames after resampling to another rate (`ops.body.resample`)."""
    if before_hz == after_hz or frames < 2:
        return frames
    return int(np.floor(round((frames - 1) * after_hz / before_hz, 9))) + 1


def clip_placement(places: F64, joints: tuple[str, ...], clip: Clip) -> Placement:
    """Return the position and facing direction of a body in one frame, from its root, hips and shoulders.

    Parameters
    ----------
    places : float64 array (J, 3)
        Positions of the joints in the frame, in metres.
    joints : tuple of str
        Their names.
    clip : Clip
        The clip, for the message.

    Raises
    ------
    KinedexError
        Position or direction are unknown in this frame.
    """
    known = dict(zip(joints, places, strict=True))
    gap = np.full(3, np.nan)
    left, right = (np.stack([known.get(f"{side}{pair}", gap) for pair in _PAIRS]) for side in "lr")
    try:
        return placement_of(known.get("root", gap), left, right)
    except ParameterError:
        raise KinedexError(
            f"frame {clip.start} of '{clip.take}' has no root, or neither hips nor shoulders, and cannot be put at the "
            "origin"
        ) from None


def source_cut(
    row: Mapping[str, Any], clip: Clip, how: ClipOptions, skeleton: Path | None, mappings: Mappings | None
) -> SourceCut:
    """Return the part of a take's source that a clip covers.

    Parameters
    ----------
    row : mapping of str to object
        The row of the take.
    clip : Clip
        The clip.
    how : ClipOptions
        The requested processing.
    skeleton : Path or None
        The skeleton file of an AMC file.
    mappings : Mappings or None
        Skeleton mappings of the store; None for the shipped ones.
    """
    from kinedex.storage.formats.motion.channel_cuts import SourceCut

    first, last = source_frames(row, clip.first, clip.last)
    start, stop = source_frames(row, clip.start, clip.stop)
    return SourceCut(
        Path(row["source_root"]) / row["source"],
        skeleton,
        row.get("person") or None,
        first,
        last,
        float(row["source_rate_hz"]),
        mirror=clip.mirrored,
        rate_hz=how.rate_hz,
        in_place=how.in_place,
        inner=(max(first, start), min(last, stop)),
        checksum=row["checksum"],
        mappings=mappings,
    )


def source_frames(row: Mapping[str, Any], start: int, stop: int) -> tuple[int, int]:
    """Return the range of source frames that analysis frames [start, stop) cover; all of them for a whole take."""
    rates = float(row["source_rate_hz"]), float(row["rate_hz"])
    return covered_frames(start, stop, int(row["source_frames"]), *rates)


@dataclass(frozen=True)
class Job:
    """A clip to be written.

    Attributes
    ----------
    clip : Clip
        The clip.
    files : tuple of str
        Its files, relative to the folder of the data set.
    fingerprint : str
        Hash of everything that determines their content.
    row : dict
        The row of the take.
    channels : bool
        True to write an interval of the source's own channels, False to write the 24 joints.
    skeleton : Path or None
        The skeleton file of an AMC file.
    """

    clip: Clip
    files: tuple[str, ...]
    fingerprint: str
    row: dict[str, Any]
    channels: bool
    skeleton: Path | None


@dataclass(frozen=True)
class Done:
    """A finished job: its files, or the reason why the clip is excluded."""

    job: Job
    files: tuple[WrittenFile, ...] = ()
    fault: str = ""


@dataclass(frozen=True)
class Batch:
    """The jobs of a task: all clips of takes that are stored next to each other."""

    store: Store
    folder: Path
    how: ClipOptions
    mappings: Mappings | None
    jobs: tuple[Job, ...]

    @property
    def subject(self) -> str:
        """The names of the takes, for messages."""
        return ", ".join(dict.fromkeys(job.clip.take for job in self.jobs))


def write_batch(batch: Batch) -> list[Done]:
    """Write the clips of a batch; each take is read once.

    Raises
    ------
    KinedexError
        A file cannot be written to the disk. A clip with any other error is excluded.
    """
    done = []
    by_take: dict[int, list[Job]] = {}
    for job in batch.jobs:
        if job.channels:
            done.append(_done(batch, job, None))
        else:
            by_take.setdefault(job.row["take_id"], []).append(job)
    for take_id, frames in read_takes(batch.store.checked, batch.store.manifest, [*by_take]):
        done += [_done(batch, job, frames) for job in by_take[take_id]]
    return done


def _done(batch: Batch, job: Job, frames: pa.Table | None) -> Done:
    paths = [batch.folder / file for file in job.files]
    try:
        write_files(batch, job, paths, frames)
    except UnwritableError as fault:
        # the next file could not be written either
        raise UnwritableError(f"{fault}; mend that, then run the same command again: it goes on where it was") from None
    except KinedexError as fault:
        return Done(job, fault=str(fault))
    sums = [sha256_of(path) or "" for path in paths]
    return Done(job, tuple(WrittenFile(file, job.fingerprint, one) for file, one in zip(job.files, sums, strict=True)))


class UnwritableError(KinedexError):
    """A file cannot be written to the disk, for a reason that other files share, such as a full disk."""


def write_files(batch: Batch, job: Job, paths: Sequence[Path], frames: pa.Table | None) -> None:
    """Write the files of a clip, each completely or not at all.

    Parameters
    ----------
    batch : Batch
        The batch of the job.
    job : Job
        The clip.
    paths : sequence of Path
        Its files.
    frames : pyarrow.Table or None
        All frames of the take; not needed if channels are exported.

    Raises
    ------
    UnwritableError
        A file cannot be written.
    KinedexError
        The clip cannot be written in this format.
    """
    store, how = batch.store, batch.how
    form = FILE_FORMATS[how.form]
    try:
        if job.channels:
            form.cut_channels(paths, source_cut(job.row, job.clip, how, job.skeleton, batch.mappings))
            return
        assert frames is not None
        motion = clip_motion(frames, job.clip, how, store.feature_set, store.rate_hz)
        with whole_file(paths[0]) as unfinished:
            form.write_joints(unfinished, motion)
    except KinedexError as fault:
        if any(str(fault).startswith(f"{path}: cannot be written") for path in paths):
            raise UnwritableError(str(fault)) from None
        raise
    except OSError as fault:
        raise UnwritableError(f"{paths[0]}: cannot be written: {fault.strerror}") from None


def batches_of_jobs(
    store: Store, folder: Path, how: ClipOptions, mappings: Mappings | None, jobs: Sequence[Job]
) -> Iterator[Batch]:
    """Yield jobs in batches of takes that are stored next to each other.

    Parameters
    ----------
    store : Store
        The store.
    folder : Path
        The folder of the data set.
    how : ClipOptions
        The format and processing of the clips.
    mappings : Mappings or None
        Skeleton mappings of the store, if channels of sources are exported.
    jobs : sequence of Job
        The clips to be written.
    """
    part_of = {take: number for number, part in enumerate(store.manifest.frames) for take in part.live}
    order = sorted(jobs, key=lambda job: (part_of[job.row["take_id"]], job.row["take_id"]))
    batch: list[Job] = []
    for place, job in enumerate(order):
        batch.append(job)
        last = place + 1 == len(order) or order[place + 1].row["take_id"] != job.row["take_id"]
        if last and (len(batch) >= CLIPS_A_TASK or place + 1 == len(order)):
            yield Batch(store, folder, how, mappings, tuple(batch))
            batch = []
