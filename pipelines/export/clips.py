"""Make the clips of a data set: intervals with margins and context, mirrored copies, splits, and file names."""

from __future__ import annotations

import hashlib
import json
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from kinedex.catalog.mirrored_classes import mirrored_class
from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.evaluation.group_split import split_groups
from kinedex.ops.intervals import in_seconds, nearest_frame, shown_seconds
from kinedex.ops.wording import counted
from kinedex.pipelines.export.request import ClipOptions
from kinedex.pipelines.export.selected_intervals import SelectedInterval
from kinedex.storage.formats.data_set_folder import CLIPS
from kinedex.storage.formats.labels.formats import file_names
from kinedex.storage.store.store import Store


@dataclass(frozen=True)
class Clip:
    """A clip of a data set.

    Attributes
    ----------
    interval : SelectedInterval
        The selected interval.
    start, stop : int
        The frames of the clip: the interval with its margins, in analysis frames of the take.
    first, last : int
        The frames [first, last) in the file: those from `start` to `stop`, with the context before and after.
    label : str or None
        The class; for a mirrored clip, the class of the mirrored motion.
    mirrored : bool
        True for a copy with left and right exchanged.
    folder : str
        The folder of the file in the data set, which is that of its split.
    name : str
        Name of the file without its extension.
    """

    interval: SelectedInterval
    start: int
    stop: int
    first: int
    last: int
    label: str | None
    mirrored: bool = False
    folder: str = CLIPS
    name: str = ""

    @property
    def take(self) -> str:
        """Name of the take."""
        return self.interval.take


def clips_of(store: Store, intervals: Sequence[SelectedInterval], how: ClipOptions) -> list[Clip]:
    """Return the clips of intervals, without those that are shorter than requested.

    Margins and context end at the ends of the take. Intervals of one class that are equal after margins are added
    become one clip.

    Parameters
    ----------
    store : Store
        The store of the takes.
    intervals : sequence of SelectedInterval
        The intervals, by take and start.
    how : ClipOptions
        The margins, the context and the smallest length.

    Raises
    ------
    KinedexError
        No interval is long enough.
    """
    rate, lengths = store.rate_hz, store.take_frames
    margin, context = nearest_frame(how.margin, rate), nearest_frame(how.context, rate)
    clips: dict[tuple[str, int, int, str | None], Clip] = {}
    for one in intervals:
        if in_seconds(one.stop - one.start, rate) < how.min_length - 1e-9:
            continue
        length = lengths[store.take_ids[one.take]]
        start, stop = max(0, one.start - margin), min(length, one.stop + margin)
        clip = Clip(one, start, stop, max(0, start - context), min(length, stop + context), one.label)
        clips.setdefault((one.take, start, stop, one.label), clip)
    if not clips:
        longest = shown_seconds(max(one.stop - one.start for one in intervals), rate)
        raise KinedexError(
            f"nothing to export: none of {counted(len(intervals), 'interval')} lasts {how.min_length:g} s; the longest "
            f"lasts {longest} s"
        )
    return list(clips.values())


def with_mirrored_copies(clips: Sequence[Clip], known: Iterable[str] = ()) -> list[Clip]:
    """Return clips, each followed by its mirrored copy.

    Parameters
    ----------
    clips : sequence of Clip
        The clips.
    known : iterable of str
        The existing classes (`mirrored_class`).
    """
    classes = frozenset(known)
    images = {label: mirrored_class(label, classes) for label in {clip.label for clip in clips} if label is not None}
    return [
        one
        for clip in clips
        for one in (clip, replace(clip, mirrored=True, label=None if clip.label is None else images[clip.label]))
    ]


def with_names(clips: Sequence[Clip], whole: bool) -> list[Clip]:
    """Return clips with unique names of files that are valid on every operating system.

    A clip of a whole take is named after the take, any other clip after its take, frames and class. The names of
    mirrored clips end in "_mirrored".

    Parameters
    ----------
    clips : sequence of Clip
        The clips.
    whole : bool
        True if the clips are whole takes.
    """
    raw: list[str] = []
    used: set[str] = set()
    for clip in clips:
        one = clip.interval
        name = one.take if whole else f"{one.take}_{clip.start:05d}-{clip.stop:05d}"
        name += f"_{clip.label}" if clip.label and not whole else ""
        name += "_mirrored" if clip.mirrored else ""
        while name in used:
            name += "+"
        used.add(name)
        raw.append(name)
    return [replace(clip, name=name) for clip, name in zip(clips, file_names(raw), strict=True)]


def split_clips(store: Store, clips: Sequence[Clip], how: ClipOptions) -> list[Clip]:
    """Assign each clip to the folder of a split; clips of takes with the same value of a column share a split.

    Takes without a value count as one group.

    Parameters
    ----------
    store : Store
        The store of the takes.
    clips : sequence of Clip
        The clips.
    how : ClipOptions
        The column, the shares and the seed.

    Raises
    ------
    KinedexError
        Takes have no such column, or it has fewer values than there are splits.
    """
    if how.split is None:
        return list(clips)
    names = store.take_rows.column_names
    if how.split not in names:
        raise KinedexError(f"--split: takes have no column '{how.split}'{did_you_mean(how.split, names)}")
    columns = (store.take_rows.column(name).to_pylist() for name in ("name", how.split))
    group_of = {take: _group(value) for take, value in zip(*columns, strict=True)}
    sizes: dict[str, float] = defaultdict(float)
    for clip in clips:
        sizes[group_of[clip.take]] += in_seconds(clip.stop - clip.start, store.rate_hz)
    folders = how.folders
    if len(sizes) < len(folders):
        shown = ", ".join(sorted(sizes))
        way_out = "choose another column" + (", or two splits with --shares 0.8,0.2" if len(sizes) == 2 else "")
        raise KinedexError(
            f"--split {how.split}: {counted(len(clips), 'clip')} have {counted(len(sizes), 'value')} of it ({shown}), "
            f"and {len(folders)} splits need as many; {way_out}"
        )
    groups = sorted(sizes, key=lambda group: _draw(how.seed, group))
    splits = split_groups([sizes[group] for group in groups], how.shares)
    folder_of = {group: folders[split] for group, split in zip(groups, splits.tolist(), strict=True)}
    return [replace(clip, folder=folder_of[group_of[clip.take]]) for clip in clips]


def _group(value: object) -> str:
    return "no value" if value is None else f"'{value}'"


def _draw(seed: int, *content: object) -> str:
    """Return a pseudo-random sort key that depends only on the seed and the content."""
    return hashlib.sha256(json.dumps([seed, *content], default=str).encode()).hexdigest()


def at_most_per_class(clips: Sequence[Clip], how: ClipOptions) -> list[Clip]:
    """Return at most `how.per_class` clips of each class, selected pseudo-randomly by content and seed; None: all."""
    return list(clips) if how.per_class is None else _drawn(clips, how.per_class, how.seed)


def balanced_clips(clips: Sequence[Clip], how: ClipOptions) -> list[Clip]:
    """Return for each split as many clips of every class as its rarest class has; without `balance`, all clips.

    Content and seed decide which clips are kept.

    Raises
    ------
    KinedexError
        No clip has a class, so that they cannot be balanced.
    """
    if not how.balance:
        return list(clips)
    if not any(clip.label for clip in clips):
        raise KinedexError("--balance: no clip has a class; leave --balance out, or cut out annotations or labels")
    kept: list[Clip] = []
    for folder in how.folders:
        inside = [clip for clip in clips if clip.folder == folder]
        least = min(Counter(clip.label for clip in inside).values(), default=0)
        kept += _drawn(inside, least, how.seed)
    return sorted(kept, key=lambda clip: clip.interval.place)


def _drawn(clips: Sequence[Clip], most: int, seed: int) -> list[Clip]:
    """Return at most `most` clips of each class, in the given order."""
    order = sorted(clips, key=lambda clip: _draw(seed, clip.take, clip.start, clip.stop, clip.label))
    taken: Counter[str | None] = Counter()
    kept = set()
    for clip in order:
        taken[clip.label] += 1
        if taken[clip.label] <= most:
            kept.add(clip)
    return [clip for clip in clips if clip in kept]
