"""Choose among clips: assign splits, balance classes, and limit the clips of a class."""

from __future__ import annotations

import hashlib
import json
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import replace

from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.evaluation.group_split import split_groups
from kinedex.ops.intervals import in_seconds
from kinedex.ops.wording import counted
from kinedex.pipelines.export.clips import Clip
from kinedex.pipelines.export.request import How
from kinedex.storage.store.store import Store


def split_clips(store: Store, clips: Sequence[Clip], how: How) -> list[Clip]:
    """Assign each clip to the folder of a split; clips of takes with the same value of a column share a split.

    Takes without a value count as one group.

    Parameters
    ----------
    store : Store
        The store of the takes.
    clips : sequence of Clip
        The clips.
    how : How
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


def at_most_per_class(clips: Sequence[Clip], how: How) -> list[Clip]:
    """Return at most `how.per_class` clips of each class, selected pseudo-randomly by content and seed."""
    return list(clips) if how.per_class is None else _drawn(clips, how.per_class, how.seed)


def balanced_clips(clips: Sequence[Clip], how: How) -> list[Clip]:
    """Return equally many clips of each class in each split, as many as the rarest class has, by content and seed.

    Raises
    ------
    KinedexError
        No clip has a class.
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
