"""Estimate the sizes of the files of an export from a sample of its clips."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from kinedex.ops.wording import counted
from kinedex.pipelines.export.plan import Plan
from kinedex.pipelines.export.request import How
from kinedex.pipelines.export.work import Batch, Job, write_batch
from kinedex.storage.store.store import Store

SAMPLE = 6
"""The number of clips in a sample, for each kind of source."""

MOST_FRAMES = 20_000
"""The number of frames at which a sample ends; samples of videos end at a hundredth of it."""


@dataclass(frozen=True)
class Sizes:
    """The estimated sizes of an export.

    Attributes
    ----------
    clips : list of int or None
        Bytes of the files of each clip, in the order of the plan; None if no clip of the sample can be written.
    remark : str
        A description of the sample.
    """

    clips: list[int] | None
    remark: str


def estimated_bytes(store: Store, how: How, plan: Plan) -> Sizes:
    """Estimate the bytes of the files of each clip.

    A few clips, from the shortest to the longest, are written into a temporary folder, which is removed. The sizes of
    the others are estimated by a line through the sizes of the sample over frames, by least squares.

    Parameters
    ----------
    store : Store
        The store to read.
    how : How
        The format of the clips.
    plan : Plan
        The clips.
    """
    found: dict[tuple[str, ...], int] = {}
    fits = {}
    faults: list[str] = []
    for channels in {job.channels for job in plan.jobs}:
        sample = _sample([job for job in plan.jobs if job.channels == channels], how)
        with TemporaryDirectory(prefix="kinedex-") as name:
            folder = Path(name)
            for file in {file for job in sample for file in job.files}:
                (folder / file).parent.mkdir(exist_ok=True)
            done = write_batch(Batch(store, folder, how, plan.mappings, tuple(sample)))
            faults += [one.fault for one in done if not one.files]
            sizes = {
                one.job.files: sum((folder / file.file).stat().st_size for file in one.files)
                for one in done
                if one.files
            }
        written = [job for job in sample if job.files in sizes]
        if not written:
            return Sizes(None, f"the size is unknown: no clip of the sample can be written; the first: {faults[0]}")
        fits[channels] = _line([_frames(job) for job in written], [sizes[job.files] for job in written])
        found |= sizes
    clips = [found.get(job.files, round(float(np.polyval(fits[job.channels], _frames(job))))) for job in plan.jobs]
    if len(found) == len(plan.jobs):
        return Sizes(clips, "every clip was written into a temporary folder: sizes are exact")
    remark = f"estimated from {counted(len(found), 'clip')} written into a temporary folder"
    return Sizes(clips, remark + (f"; {len(faults)} of the sample cannot be written: {faults[0]}" if faults else ""))


def _frames(job: Job) -> int:
    return job.clip.last - job.clip.first


def _sample(jobs: Sequence[Job], how: How) -> list[Job]:
    """Return a few clips, from the shortest to the longest."""
    order = sorted(jobs, key=lambda job: (_frames(job), job.files))
    most = MOST_FRAMES // 100 if how.form in ("gif", "mp4") else MOST_FRAMES
    chosen: list[Job] = []
    for place in dict.fromkeys(np.linspace(0, len(order) - 1, SAMPLE).round().astype(int).tolist()):
        if chosen and sum(map(_frames, chosen)) + _frames(order[place]) > most:
            break
        chosen.append(order[place])
    return chosen


def _line(frames: Sequence[int], sizes: Sequence[int]) -> tuple[float, float]:
    """Return slope and intercept of a line through sizes; a line through zero if all clips have the same length."""
    if len(set(frames)) == 1:
        return float(np.mean(sizes)) / max(1, frames[0]), 0.0
    slope, start = np.polyfit(frames, sizes, 1)
    return (float(slope), float(start)) if slope > 0 and start > 0 else (sum(sizes) / max(1, sum(frames)), 0.0)
