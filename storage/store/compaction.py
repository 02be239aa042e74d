"""Merge small parts into large ones and remove tombstones, at a cost proportional to what was added.

Every ingest writes parts as large as its batches. Tiers decide which parts are merged: a part with at least
`FANOUT` ** k live rows, but fewer than `FANOUT` ** (k + 1), is of tier k, and a tier is merged once it has `FANOUT`
parts or more. The merged part has at least `FANOUT` ** (k + 1) rows and is of a higher tier, so that a row rises by at
least one tier each time it is rewritten. A part of `target_bytes` is full and not merged again. A full frames part of
100 MB has some 500,000 rows, so that there are at most log8(500,000) < 7 tiers, for any number of ingests. Adding N
rows in small steps thus costs O(N log N) row writes in all, and adding 10 files to 10,000 takes usually merges nothing.
The lower tiers stay below `FANOUT` parts each, so a store has some 50 small parts at most. (Log-structured merge trees
work in the same way: O'Neil et al., "The log-structured merge-tree", 1996; the rule by sizes is known as size-tiered
compaction.)

A part that has tombstones for more than half of its rows is rewritten alone. This writes fewer rows than were replaced
or dropped since the part was made.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import accumulate, groupby
from pathlib import Path
from typing import Protocol, TypeVar

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from kinedex.catalog.features import FeatureSet
from kinedex.ops.errors import StoreError
from kinedex.storage.snapshot.checked_files import CheckedFiles
from kinedex.storage.snapshot.manifest import Part, ResultPart
from kinedex.storage.snapshot.parts import FramesWriter, read_errors, write_part
from kinedex.storage.snapshot.schemas import with_columns
from kinedex.storage.snapshot.snapshot import Snapshot
from kinedex.storage.store.writer import StoreWriter

TARGET_BYTES = 100_000_000
"""The size in bytes of a full frames part, which is not merged again."""

FANOUT = 8
"""The number of parts of one tier that are merged, and the ratio of the tiers' sizes."""

MIN_ROWS = 131_072
"""The smallest number of rows of a part when a merge is divided among workers, about 27 MB on disk."""

KEPT_ROWS = 262_144
"""The largest number of old rows that a merge keeps in memory, some 90 MB; one row group or take may be larger."""

AnyPart = TypeVar("AnyPart", Part, ResultPart)


class Map(Protocol):
    """A function that distributes merges over cores and yields results in order, like the `map` of an executor."""

    def __call__(self, function: Callable[[Merge], Part], items: Iterable[Merge], /) -> Iterator[Part]:
        """Apply the function to every item."""
        ...


@dataclass(frozen=True)
class Merge:
    """A task that merges the frames of takes from old frames parts into one new part.

    Attributes
    ----------
    store : Path
        The store's directory.
    feature_set : FeatureSet
        The feature set of the words.
    rate_hz : float
        Analysis frames per second.
    parts : tuple of Part
        The old parts that contain the takes.
    take_ids : tuple of int
        Ids of the takes of the new part, ascending.
    """

    store: Path
    feature_set: FeatureSet
    rate_hz: float
    parts: tuple[Part, ...]
    take_ids: tuple[int, ...]


@dataclass(frozen=True)
class Compaction:
    """The result of a compaction: the numbers of merged and of new parts, and the errors of damaged parts."""

    frames_before: int
    frames_after: int
    takes_before: int
    takes_after: int
    damaged: tuple[StoreError, ...] = ()

    @property
    def changed(self) -> bool:
        """True if any part was merged."""
        return self.frames_before + self.takes_before > 0


def compact(
    writer: StoreWriter, *, target_bytes: int = TARGET_BYTES, spread: Map = map, workers: int = 1
) -> Compaction:
    """Merge small parts of a store, rewrite parts that are mostly tombstones, and commit the result as one version.

    A damaged part of frames is left unchanged, because a rewritten part would get a valid checksum; the other parts are
    merged.

    The takes, their ids and the index stay valid. The old files are kept for readers of older versions until
    `storage.store.garbage_collection.collect_garbage` removes them. If the process is killed before the commit, the
    store is unchanged.

    Parameters
    ----------
    writer : StoreWriter
        The writer, which holds the store's lock and must have no uncommitted changes.
    target_bytes : int, optional
        Size at which a frames part is full.
    spread : Map, optional
        Runs the merges; each needs at most about half a gigabyte of memory, whatever the store's size.
    workers : int, optional
        Number of merges that `spread` runs at once; a large merge is divided among them.

    Raises
    ------
    StoreError
        A part of takes is damaged or missing, or the disk is full; nothing is changed.
    """
    store = writer.store
    groups, damaged = _sound_groups(store, target_bytes)
    merges = [_merges(store, group, target_bytes, workers) for group in groups]
    new_frames = list(spread(merge, [task for group in merges for task in group]))
    if groups:
        writer.swap_parts("frames", [part for group in groups for part in group], new_frames)
    old_takes = [part for group in merge_groups(store.manifest.takes) for part in group]
    new_takes = [_merge_takes(store, old_takes)] if old_takes else []
    if old_takes:
        writer.swap_parts("takes", old_takes, new_takes)
    writer.commit()
    return Compaction(
        frames_before=sum(len(group) for group in groups),
        frames_after=len(new_frames),
        takes_before=len(old_takes),
        takes_after=len(new_takes),
        damaged=damaged,
    )


def _sound_groups(store: Snapshot, target_bytes: int) -> tuple[list[list[Part]], tuple[StoreError, ...]]:
    """Return the groups of undamaged parts of frames to merge, and the errors of damaged parts among them."""
    left = list(store.manifest.frames)
    damaged: list[StoreError] = []
    while True:
        groups = merge_groups(left, target_bytes)
        before = len(damaged)
        for part in (part for group in groups for part in group):
            try:
                store.checked.part(part)
            except StoreError as fault:
                damaged.append(fault)
                left.remove(part)
        if len(damaged) == before:
            return groups, tuple(damaged)


def merge_groups(parts: Iterable[AnyPart], full_bytes: float = float("inf")) -> list[list[AnyPart]]:
    """Return groups of parts to merge: `FANOUT` or more of one tier, and single parts that are mostly tombstones.

    Parameters
    ----------
    parts : iterable of Part or ResultPart
        All parts of one kind.
    full_bytes : float, optional
        Size of the live rows, estimated from their number, from which on a part is not merged.
    """
    tiers: dict[int, list[AnyPart]] = {}
    alone = []
    for part in parts:
        if part.bytes * _live_share(part) >= full_bytes:
            if part.dropped_rows > part.live_rows:
                alone.append([part])
        else:
            tiers.setdefault(_tier(part.live_rows), []).append(part)
    groups = []
    for tier in sorted(tiers):
        if len(tiers[tier]) >= FANOUT:
            groups.append(tiers[tier])
        else:
            alone += [[part] for part in tiers[tier] if part.dropped_rows > part.live_rows]
    return groups + alone


def part_count(count: int, workers: int, *, fits: int, worth: int) -> int:
    """Return the number of new parts of a merge, one that keeps all workers busy if there are enough rows.

    Parameters
    ----------
    count : int
        Number of full-size parts that the merge would make.
    workers : int
        Number of merges that run at once.
    fits : int
        Number of full parts for which there are enough rows.
    worth : int
        Number of parts of a higher tier, with at least `MIN_ROWS` rows each, for which there are enough rows. A merge
        makes at most half of `FANOUT` parts that are not full, since more would soon be merged again.
    """
    if count < workers:
        return max(count, min(workers, worth, FANOUT // 2))
    even = -(-count // workers) * workers
    return even if even <= fits else count


def merge(task: Merge) -> Part:
    """Write one new frames part; the function can run in any process, and calling it again is harmless.

    The old parts are read one row group at a time. A part that does not match its checksum is refused, because its
    rows would get a valid checksum in the new part.
    """
    homes = {take: place for place, part in enumerate(task.parts) for take in part.live}
    files = CheckedFiles(task.store).parts(task.parts)
    row_ranges = [_row_ranges(file, part) for file, part in zip(files, task.parts, strict=True)]
    groups = _RowGroups(files)
    with FramesWriter(task.store, task.feature_set, task.rate_hz) as writer:
        for place, takes in groupby(task.take_ids, key=homes.__getitem__):
            ids = list(takes)
            # takes that are adjacent in an old part are copied together
            for start, stop, members in _joined(ids, row_ranges[place]):
                writer.add_pieces(members, groups.rows(place, start, stop))
        return writer.close()


def _tier(rows: int) -> int:
    tier = 0
    while rows >= FANOUT ** (tier + 1):
        tier += 1
    return tier


def _live_share(part: Part | ResultPart) -> float:
    return part.live_rows / part.rows if part.rows else 1.0


def _merges(store: Snapshot, group: list[Part], target_bytes: int, workers: int) -> list[Merge]:
    """Distribute the live takes of a group over new parts, each of the target size if there are enough rows."""
    takes = sorted(take for part in group for take in part.live)
    if not takes:
        return []
    frames = store.take_frames
    live_bytes = sum(part.bytes * _live_share(part) for part in group)
    rows = sum(frames[take] for take in takes)
    # a tenth more than the target, since merged parts compress slightly better
    count = max(1, int(live_bytes / (1.1 * target_bytes)))
    if len(group) > 1:
        climbs = FANOUT ** (_tier(group[0].live_rows) + 1)
        count = part_count(count, workers, fits=int(live_bytes / target_bytes), worth=rows // max(climbs, MIN_ROWS))
    share = rows / count
    merges = []
    ends = accumulate(frames[take] for take in takes)
    for _, chosen in groupby(
        zip(takes, ends, strict=True), key=lambda item: min(count - 1, int((item[1] - 1) / share)) if share else 0
    ):
        ids = tuple(take for take, _ in chosen)
        parts = tuple(part for part in group if not set(ids).isdisjoint(part.live))
        merges.append(Merge(store.path, store.feature_set, store.rate_hz, parts, ids))
    return merges


def _row_ranges(file: Path, part: Part) -> dict[int, tuple[int, int]]:
    """Return a dict from take id to row range (start, stop) in a part, for its live takes."""
    with read_errors(file):
        ids = pq.read_table(file, columns=["take_id"]).column("take_id").to_numpy()
    live = np.array(part.live, np.int64)
    starts, stops = np.searchsorted(ids, live, "left"), np.searchsorted(ids, live, "right")
    return dict(zip(part.live, zip(starts.tolist(), stops.tolist(), strict=True), strict=True))


def _joined(ids: list[int], row_ranges: Mapping[int, tuple[int, int]]) -> Iterator[tuple[int, int, list[int]]]:
    """Yield the ranges of rows of the takes, with the takes in each; adjacent ranges are joined."""
    start, stop = row_ranges[ids[0]]
    members: list[int] = []
    for take in ids:
        first, last = row_ranges[take]
        if first != stop and members:
            yield start, stop, members
            start, members = first, []
        elif not members:
            start = first
        stop = last
        members.append(take)
    yield start, stop, members


class _RowGroups:
    """A reader of row ranges from Parquet files that caches the last row groups."""

    def __init__(self, files: list[Path]) -> None:
        self._files = files
        self._ends: dict[int, list[int]] = {}
        self._kept: OrderedDict[tuple[int, int], pa.Table] = OrderedDict()

    def rows(self, file: int, start: int, stop: int) -> Iterator[pa.Table]:
        """Yield the rows [start, stop) of a file, in pieces."""
        if file not in self._ends:
            self._ends[file] = self._row_group_ends(file)
        ends = self._ends[file]
        while start < stop:
            group = bisect_right(ends, start)
            first = ends[group - 1] if group else 0
            end = min(stop, ends[group])
            table = self._group(file, group)
            # copied, because a slice would keep the whole row group in memory until the slice is written
            whole = end - start == table.num_rows
            yield table if whole else table.take(np.arange(start - first, end - first))
            start = end

    def _row_group_ends(self, file: int) -> list[int]:
        metadata = pq.read_metadata(self._files[file])
        return list(accumulate(metadata.row_group(group).num_rows for group in range(metadata.num_row_groups)))

    def _group(self, file: int, group: int) -> pa.Table:
        key = (file, group)
        if key not in self._kept:
            with read_errors(self._files[file]), pq.ParquetFile(self._files[file]) as opened:
                table = opened.read_row_group(group)
            rows = table.num_rows + sum(kept.num_rows for kept in self._kept.values())
            while self._kept and rows > KEPT_ROWS:
                rows -= self._kept.popitem(last=False)[1].num_rows
            self._kept[key] = table
        self._kept.move_to_end(key)
        return self._kept[key]


def _merge_takes(store: Snapshot, parts: list[Part]) -> Part:
    """Write the live rows of takes parts as one part. They are collected in memory, with some hundred bytes per row."""
    tables = []
    for part in parts:
        file = store.checked.part(part)
        with read_errors(file):
            table = with_columns(pq.read_table(file), store.manifest.takes_schema)
        gone = set(part.dropped)
        tables.append(table.filter(pa.array([t not in gone for t in table.column("take_id").to_pylist()], pa.bool_())))
    rows = pa.concat_tables(tables).sort_by("take_id")
    return write_part(store.path, "takes", rows, rows.column("take_id").to_pylist())
