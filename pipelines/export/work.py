"""Write clips, take by take, in this process or in workers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow as pa

from kinedex.ops.errors import KinedexError
from kinedex.pipelines.export.clips import Clip
from kinedex.pipelines.export.folder import Written, sha256_of
from kinedex.pipelines.export.forms import FORMS
from kinedex.pipelines.export.motions import clip_motion, source_cut
from kinedex.pipelines.export.request import How
from kinedex.storage.disk import whole_file
from kinedex.storage.snapshot.frames import read_takes
from kinedex.storage.store.store import Store

if TYPE_CHECKING:
    from kinedex.catalog.skeletons.mappings import Mappings


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
    files: tuple[Written, ...] = ()
    fault: str = ""


@dataclass(frozen=True)
class Batch:
    """The jobs of a task: all clips of takes that are stored next to each other."""

    store: Store
    folder: Path
    how: How
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
        # nor could the next file be written
        raise UnwritableError(f"{fault}; mend that, then run the same command again: it goes on where it was") from None
    except KinedexError as fault:
        return Done(job, fault=str(fault))
    sums = [sha256_of(path) or "" for path in paths]
    return Done(job, tuple(Written(file, job.fingerprint, one) for file, one in zip(job.files, sums, strict=True)))


class UnwritableError(KinedexError):
    """The disk refuses to write a file, whatever its content."""


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
    form = FORMS[how.form]
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
    store: Store, folder: Path, how: How, mappings: Mappings | None, jobs: Sequence[Job]
) -> Iterator[Batch]:
    """Yield jobs in batches of takes that are stored next to each other.

    Parameters
    ----------
    store : Store
        The store.
    folder : Path
        The folder of the data set.
    how : How
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


CLIPS_A_TASK = 50
"""The approximate number of clips of a task; after a kill, each worker writes at most as many again."""
