"""Export a data set into a folder, with a record of where each clip comes from; or one take to one file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kinedex.ops.errors import KinedexError
from kinedex.ops.wording import counted
from kinedex.pipelines.engine.display import Progress
from kinedex.pipelines.engine.executors import Executor
from kinedex.pipelines.export.clip_batches import Batch, Done, Job, batches_of_jobs, write_batch, write_files
from kinedex.pipelines.export.clips import Clip
from kinedex.pipelines.export.data_set_record import Facts, data_set_text, metadata_rows, metadata_text, split_facts
from kinedex.pipelines.export.export_plan import jobs_of, needed_mappings, plan_clips
from kinedex.pipelines.export.request import ClipOptions, IntervalSource, format_named
from kinedex.pipelines.export.selected_intervals import SelectedInterval
from kinedex.storage.formats.data_set_folder import DataSetFolder, WrittenFile
from kinedex.storage.store.store import Store


@dataclass(frozen=True)
class ExportedDataSet:
    """A data set that was written.

    Attributes
    ----------
    folder : Path
        Its folder.
    rows : list of dict
        The rows of `metadata.csv`.
    written, reused : int
        The numbers of clips that were written, and that existed already.
    excluded : dict of str to str
        File of a clip that could not be written → the reason.
    remarks : tuple of str
        Remarks on excluded intervals and clips.
    """

    folder: Path
    rows: list[dict[str, Any]]
    written: int
    reused: int
    excluded: dict[str, str]
    remarks: tuple[str, ...]


def export_data_set(
    store: Store, what: IntervalSource, how: ClipOptions, folder: Path, *, executor: Executor, progress: Progress
) -> ExportedDataSet:
    """Write the clips of a request to a folder, with `metadata.csv` and `dataset.json`.

    The same request writes the same bytes. Clips that exist already with the right content are not written again, so
    that an interrupted export continues where it stopped.

    Parameters
    ----------
    store : Store
        The store to read.
    what : IntervalSource
        The intervals to export.
    how : ClipOptions
        The format and processing of the clips.
    folder : Path
        The folder: new, empty, or that of an earlier export.
    executor : Executor
        Spreads the clips over workers.
    progress : callable
        Shows the progress of the export.

    Raises
    ------
    KinedexError
        Nothing is selected, no clip can be written, the folder holds other files, or it cannot be written.
    """
    plan = plan_clips(store, what, how, progress)
    with DataSetFolder(folder) as target:
        finished, rest = _finished(target, plan.jobs)
        target.begin(dict.fromkeys(job.clip.folder for job in plan.jobs))
        done = {id(one.job): one for one in finished}
        jobs = {job.files: job for job in rest}  # workers return copies of the jobs
        with progress("clips", len(rest)) as bar:
            batches = batches_of_jobs(store, folder, how, plan.mappings, rest)
            for results in executor.map(write_batch, batches):
                for one in results:
                    target.add(one.files)
                done |= {id(jobs[one.job.files]): one for one in results}
                bar.advance(len(results))
        every = [done[id(job)] for job in plan.jobs]
        written = [one for one in every if one.files]
        excluded = {one.job.files[0]: one.fault for one in every if not one.files}
        if not written:
            raise KinedexError(f"none of {counted(len(every), 'clip')} can be written; the first: {every[0].fault}")
        facts = Facts(store, what, how, excluded, plan.remarks)
        rows = metadata_rows(facts, written)
        files = [file.file for one in written for file in one.files]
        target.finish(files, data_set_text(facts, rows, written), metadata_text(rows))
    return ExportedDataSet(folder, rows, len(written) - len(finished), len(finished), excluded, plan.remarks)


def _finished(target: DataSetFolder, jobs: Sequence[Job]) -> tuple[list[Done], list[Job]]:
    """Return the results of jobs whose files exist already, and the remaining jobs."""
    finished, rest = [], []
    for job in jobs:
        sums = target.checksums([(file, job.fingerprint) for file in job.files])
        if sums is None:
            rest.append(job)
        else:
            files = zip(job.files, sums, strict=True)
            finished.append(Done(job, tuple(WrittenFile(file, job.fingerprint, checksum) for file, checksum in files)))
    return finished, rest


def summary_lines(done: ExportedDataSet, how: ClipOptions) -> list[str]:
    """Return a summary of an export as lines for people."""
    seconds = sum(row["seconds"] for row in done.rows)
    reused = f" ({done.reused:,} of them were there already)" if done.reused else ""
    lines = [f"{counted(len(done.rows), 'clip')}, {seconds / 60:.1f} minutes, in {done.folder}{reused}"]
    if how.split is not None:
        wanted = dict(zip(how.folders, (share / sum(how.shares) for share in how.shares), strict=True))
        reached = split_facts(done.rows, how)
        lines += [
            f"{name}: {counted(facts['clips'], 'clip')}, {facts['share']:.1%} of the time (asked: {wanted[name]:.0%})"
            for name, facts in reached.items()
        ]
    lines += done.remarks
    if done.excluded:
        first = next(iter(done.excluded.values()))
        failed = counted(len(done.excluded), "clip")
        lines.append(f"{failed} could not be written and stand in dataset.json (excluded); the first: {first}")
    return lines


def export_take(store: Store, take: str, how: ClipOptions, path: Path) -> list[Path]:
    """Write a whole take to a file, completely or not at all.

    Parameters
    ----------
    store : Store
        The store that has the take.
    take : str
        The take's name.
    how : ClipOptions
        The format, and whether the motion is resampled or moved to the origin.
    path : Path
        The file to write; an existing one is replaced. Formats of several files write the others beside it.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    KinedexError
        There is no such take, it cannot be written in this format, an option applies to data sets only, or the file
        cannot be written.
    """
    asked = {
        "mirror": how.mirror, "split": how.split, "balance": how.balance, "per-class": how.per_class,
        "distinct": how.distinct, "margin": how.margin, "context": how.context, "min-length": how.min_length,
    }  # fmt: skip
    if given := [name for name, value in asked.items() if value]:
        raise KinedexError(f"--{given[0]} makes a data set: give its folder, as in -o clips/")
    frames = store.take_frames[store.take_id(take)]
    clip = Clip(SelectedInterval(take, 0, frames), 0, frames, 0, frames, None, name=take)
    (job,) = jobs_of(store, [clip], how)
    endings = format_named(how.form).endings[: len(job.files)]
    paths = [path, *(path.with_suffix(f".{ending}") for ending in endings[1:])]
    batch = Batch(store, path.parent, how, needed_mappings(store, (job,)), (job,))
    write_files(batch, job, paths, None if job.channels else store.frames(take))
    return paths
