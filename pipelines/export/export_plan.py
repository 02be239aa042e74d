"""Plan an export: the clips that it will write, with their data, files and estimated sizes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from kinedex.ops.arrays import F32
from kinedex.ops.distances.near_duplicates import motion_outline, near_duplicates
from kinedex.ops.errors import KinedexError
from kinedex.ops.intervals import in_seconds
from kinedex.ops.wording import counted, name_list
from kinedex.pipelines.engine.display import Progress
from kinedex.pipelines.export.clip_batches import Batch, Job, clip_placement, write_batch
from kinedex.pipelines.export.clips import (
    Clip,
    at_most_per_class,
    balanced_clips,
    clips_of,
    split_clips,
    with_mirrored_copies,
    with_names,
)
from kinedex.pipelines.export.request import ClipOptions, IntervalSource, format_named
from kinedex.pipelines.export.selected_intervals import selected_intervals
from kinedex.storage.formats.motion.packed_files import file_exists
from kinedex.storage.snapshot.frames import read_takes
from kinedex.storage.snapshot.manifest import kinedex_version
from kinedex.storage.snapshot.parts import joint_positions
from kinedex.storage.store.store import Store

if TYPE_CHECKING:
    from kinedex.catalog.skeletons.mappings import Mappings

SAMPLE = 6
"""The number of clips in a sample, for each kind of source."""

MAX_FRAMES = 20_000
"""The largest number of frames in a sample of several clips; a sample of videos has at most a hundredth of it."""


@dataclass(frozen=True)
class Plan:
    """The clips that an export will write.

    Attributes
    ----------
    jobs : tuple of Job
        The clips, by take and frames.
    remarks : tuple of str
        Remarks on excluded intervals and clips.
    mappings : Mappings or None
        Skeleton mappings of the store, if channels of sources are exported.
    """

    jobs: tuple[Job, ...]
    remarks: tuple[str, ...]
    mappings: Mappings | None


def plan_clips(store: Store, what: IntervalSource, how: ClipOptions, progress: Progress) -> Plan:
    """Return the plan of an export.

    Intervals are selected; short ones and near-duplicates are excluded; each class is limited to `how.per_class`. The
    remaining clips are split, and balanced within each split; then mirrored copies are added.

    Parameters
    ----------
    store : Store
        The store to read.
    what : IntervalSource
        The intervals to export.
    how : ClipOptions
        The format and processing of the clips.
    progress : callable
        Shows the progress of the comparison of clips.

    Raises
    ------
    KinedexError
        Nothing is selected, or sources whose channels are exported are missing.
    """
    selected = selected_intervals(store, what)
    remarks = list(selected.remarks)
    clips = clips_of(store, selected.intervals, how)
    if left := len(selected.intervals) - len(clips):
        short = (
            f"are shorter than {how.min_length:g} s" if how.min_length else "are the same as others with their margins"
        )
        remarks.append(f"{counted(left, 'interval')} left out, which {short}")
    if how.distinct is not None:
        whole = len(clips)
        clips = _distinct(store, clips, how.distinct, progress)
        remarks.append(f"{counted(whole - len(clips), 'near-duplicate')} of {counted(whole, 'clip')} left out")
    clips = balanced_clips(split_clips(store, at_most_per_class(clips, how), how), how)
    if how.mirror:
        known = {name for name in store.take_rows.column("class").to_pylist() if name}
        clips = with_mirrored_copies(clips, known | {clip.label for clip in clips if clip.label})
    jobs = jobs_of(store, with_names(clips, what.kind == "takes"), how)
    return Plan(jobs, tuple(remarks), needed_mappings(store, jobs))


def needed_mappings(store: Store, jobs: Sequence[Job]) -> Mappings | None:
    """Return the shipped and the store's skeleton mappings; None if no channels are exported."""
    if not any(job.channels for job in jobs):
        return None
    # imported here because they import numba
    from kinedex.catalog.skeletons.mappings import load_mappings, with_own
    from kinedex.pipelines.ingestion.parameters import stored_files

    joints = store.feature_set.joints
    own = stored_files(store.path, store.manifest.mappings)
    shipped = load_mappings("auto", joints)
    return with_own(shipped, own, joints) if own else shipped


def _distinct(store: Store, clips: Sequence[Clip], most: float, progress: Progress) -> list[Clip]:
    """Return clips without near-duplicates of earlier clips.

    A clip whose body has no position or direction at its start is not compared with others.
    """
    by_take: dict[int, list[int]] = {}
    for number, clip in enumerate(clips):
        by_take.setdefault(store.take_ids[clip.take], []).append(number)
    outlines: dict[int, F32] = {}
    joints = store.feature_set.joints
    with progress("clips compared", len(clips)) as bar:
        for take_id, frames in read_takes(store.checked, store.manifest, [*by_take]):
            places = joint_positions(frames, joints).transpose(2, 0, 1).astype(np.float64)
            for number in by_take[take_id]:
                clip = clips[number]
                try:
                    start = clip_placement(places[clip.start], joints, clip)
                except KinedexError:
                    continue
                outlines[number] = motion_outline(places[clip.start : clip.stop], start)
            bar.advance(len(by_take[take_id]))
    numbers = sorted(outlines)
    seconds = [in_seconds(clips[number].stop - clips[number].start, store.rate_hz) for number in numbers]
    same = near_duplicates([outlines[number] for number in numbers], seconds, most)
    left_out = {number for number, earlier in zip(numbers, same, strict=True) if earlier >= 0}
    return [clip for number, clip in enumerate(clips) if number not in left_out]


def jobs_of(store: Store, clips: Sequence[Clip], how: ClipOptions) -> tuple[Job, ...]:
    """Return the jobs that write clips.

    Parameters
    ----------
    store : Store
        The store to read.
    clips : sequence of Clip
        The clips, with the names of their files.
    how : ClipOptions
        The format and processing of the clips.

    Raises
    ------
    KinedexError
        Some takes cannot be written in this format, or their sources are missing; the message lists all of them.
    """
    form = format_named(how.form)
    rows = {row["name"]: row for row in store.take_rows.to_pylist()}
    takes = list(dict.fromkeys(clip.take for clip in clips))
    cut = {take for take in takes if not how.joints and form.channels and rows[take]["format"] in form.sources}
    others = [take for take in takes if take not in cut]
    if others and form.joints is None:
        kinds = " and ".join(form.sources)
        found = (
            "not of the 24 joints"
            if how.joints
            else f"{counted(len(others), 'take')} come of others: {name_list(others)}"
        )
        raise KinedexError(
            f"the form '{how.form}' is cut out of {kinds} files; {found}. Choose another --format, such as npz"
        )
    skeletons = _skeletons(store, rows, cut)
    _require_sources(rows, cut, skeletons)
    jobs = []
    for clip in clips:
        row, channels = rows[clip.take], clip.take in cut
        endings = form.endings if channels else form.endings[:1]
        files = tuple(f"{clip.folder}/{clip.name}.{ending}" for ending in endings)
        skeleton = skeletons.get(clip.take)
        jobs.append(Job(clip, files, _fingerprint(store, clip, how, row, channels), row, channels, skeleton))
    return tuple(jobs)


def _skeletons(store: Store, rows: dict[str, dict[str, Any]], cut: set[str]) -> dict[str, Path]:
    """Return the skeleton file of each take that has one."""
    known = {row["source"]: row["source_root"] for row in store.result("skeleton_files").to_pylist()}
    found = {}
    for take in cut:
        if name := rows[take]["skeleton_source"]:
            beside = Path(rows[take]["source_root"]) / name
            found[take] = beside if file_exists(beside) or name not in known else Path(known[name]) / name
    return found


def _require_sources(rows: dict[str, dict[str, Any]], cut: set[str], skeletons: dict[str, Path]) -> None:
    missing = sorted(
        {
            str(file)
            for take in cut
            for file in (Path(rows[take]["source_root"]) / rows[take]["source"], skeletons.get(take))
            if file is not None and not file_exists(file)
        }
    )
    if missing:
        raise KinedexError(
            f"{counted(len(missing), 'source file is', 'source files are')} not there, of which clips are to be cut; "
            "bring them back, or export the 24 joints, which the store itself holds: --joints, or another --format\n  "
            + "\n  ".join(missing)
        )


def _fingerprint(store: Store, clip: Clip, how: ClipOptions, row: dict[str, Any], channels: bool) -> str:
    """Return a hash of everything that determines the content of a clip's files."""
    content = [
        kinedex_version(), how.form, channels, store.feature_set.digest, store.rate_hz, row["checksum"], row["recipe"],
        row.get("person"), clip.name, clip.start, clip.stop, clip.first, clip.last,
        clip.mirrored, how.rate_hz, how.in_place,
    ]  # fmt: skip
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()


@dataclass(frozen=True)
class Sizes:
    """The estimated sizes of an export.

    Attributes
    ----------
    clips : list of int or None
        Bytes of the files of each clip, in the order of the plan; None if no clip can be written in a sample, of which
        there is one for clips of channels and one for clips of joints.
    remark : str
        A description of the sample.
    """

    clips: list[int] | None
    remark: str


def estimated_bytes(store: Store, how: ClipOptions, plan: Plan) -> Sizes:
    """Estimate the bytes of the files of each clip.

    A few clips, from the shortest to the longest, are written into a temporary folder, which is removed. The sizes of
    the others are estimated by a line through the sizes of the sample over frames, by least squares.

    Parameters
    ----------
    store : Store
        The store to read.
    how : ClipOptions
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


def _sample(jobs: Sequence[Job], how: ClipOptions) -> list[Job]:
    """Return a few clips, from the shortest to the longest."""
    order = sorted(jobs, key=lambda job: (_frames(job), job.files))
    most = MAX_FRAMES // 100 if how.form in ("gif", "mp4") else MAX_FRAMES
    chosen: list[Job] = []
    for place in dict.fromkeys(np.linspace(0, len(order) - 1, SAMPLE).round().astype(int).tolist()):
        if chosen and sum(map(_frames, chosen)) + _frames(order[place]) > most:
            break
        chosen.append(order[place])
    return chosen


def _line(frames: Sequence[int], sizes: Sequence[int]) -> tuple[float, float]:
    """Return slope and intercept of the line that fits sizes in bytes over frames, by least squares.

    The line passes through zero if all clips have the same length, or if its slope or intercept were not positive.
    """
    if len(set(frames)) == 1:
        return float(np.mean(sizes)) / max(1, frames[0]), 0.0
    slope, start = np.polyfit(frames, sizes, 1)
    return (float(slope), float(start)) if slope > 0 and start > 0 else (sum(sizes) / max(1, sum(frames)), 0.0)
