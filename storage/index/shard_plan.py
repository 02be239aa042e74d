"""Plan an index build: which shards are kept, which lose takes, and which are rebuilt.

Frames parts are combined into shards of `SHARD_FRAMES` frames. Takes that are added later form a new shard, and small
shards are merged by tiers (size classes), like small parts (`storage.store.compaction`): a tier with `FANOUT` shards or
more becomes one shard of a higher tier, so that each frame is indexed a few times at most, and few shards are small.
Dropped takes are deleted from their shard; a shard that has lost more than half of its frames is rebuilt. The cost of a
build is thus proportional to the change, not to the size of the archive.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain

from kinedex.storage.index.generations import Shard, ShardPart
from kinedex.storage.snapshot.manifest import Part, ranges

SHARD_FRAMES = 1_048_576
"""The number of frames of a full shard, 9.7 hours at 30 Hz. Making one takes some 100 MB of memory.
The runs of a word are spread over all shards; an archive of 400 hours has some forty.
"""

FANOUT = 8
"""The number of shards of one tier that are merged, and the ratio of the tiers' sizes."""

SMALLEST = 4096
"""The number of frames below which a shard is of the lowest tier."""


@dataclass(frozen=True)
class ShardPlan:
    """The steps from the shards of one generation to the shards of the next.

    Attributes
    ----------
    kept : tuple of Shard
        Shards that are kept, in their state after the build.
    dropped : dict of int to tuple of int
        Number of a kept shard → the ids of the takes that it loses.
    removed : tuple of int
        Numbers of the shards that are removed.
    fresh : tuple of tuple of Part
        The parts from which each new shard is made.
    """

    kept: tuple[Shard, ...]
    dropped: dict[int, tuple[int, ...]]
    removed: tuple[int, ...]
    fresh: tuple[tuple[Part, ...], ...]


@dataclass(frozen=True)
class _Group:
    parts: tuple[Part, ...]
    frames: int
    shard: Shard | None = None


def plan_shards(parts: Iterable[Part], before: Sequence[Shard], shard_frames: int = SHARD_FRAMES) -> ShardPlan:
    """Decide which shards are kept, lose takes, are removed, or are made.

    Parameters
    ----------
    parts : iterable of Part
        Frames parts of the version to index.
    before : sequence of Shard
        Shards of the previous generation; empty for a complete build.
    shard_frames : int, optional
        Number of frames at which a shard is full and no longer merged.
    """
    loose = {part.sha256: part for part in parts if part.live}
    groups: list[_Group] = []
    dropped: dict[int, tuple[int, ...]] = {}
    for shard in before:
        stays = _remaining_parts(shard, loose)
        if 2 * sum(part.live_rows for part in stays) < shard.built_frames or not stays:
            continue
        for part in stays:
            del loose[part.sha256]
        if gone := _lost_takes(shard, stays):
            dropped[shard.number] = gone
        groups.append(_Group(stays, sum(part.live_rows for part in stays), shard))
    groups = _merged(groups + _packed(loose.values(), shard_frames), shard_frames)
    kept = tuple(
        replace(group.shard, parts=shard_parts(group.parts), frames=sum(part.live_rows for part in group.parts))
        for group in groups
        if group.shard is not None
    )
    numbers = {shard.number for shard in kept}
    return ShardPlan(
        kept,
        {number: takes for number, takes in dropped.items() if number in numbers},
        tuple(shard.number for shard in before if shard.number not in numbers),
        tuple(group.parts for group in groups if group.shard is None),
    )


def shard_parts(parts: Iterable[Part]) -> tuple[ShardPart, ...]:
    """Return the records of the parts from which a shard is made."""
    return tuple(ShardPart(part.sha256, _ranges(part)) for part in parts)


def ids(part: ShardPart) -> Iterable[int]:
    """Return the ids of the takes of a part that are in a shard."""
    return chain.from_iterable(range(first, stop) for first, stop in part.takes)


def _remaining_parts(shard: Shard, live: dict[str, Part]) -> tuple[Part, ...]:
    """Return the parts of a shard that still exist, except parts with live takes that the shard does not have."""
    found = []
    for member in shard.parts:
        part = live.get(member.sha256)
        if part is not None and (_ranges(part) == member.takes or set(part.live) <= set(ids(member))):
            found.append(part)
    return tuple(found)


def _lost_takes(shard: Shard, stays: tuple[Part, ...]) -> tuple[int, ...]:
    left = {part.sha256: part for part in stays}
    gone: set[int] = set()
    for member in shard.parts:
        part = left.get(member.sha256)
        if part is None:
            gone.update(ids(member))
        elif _ranges(part) != member.takes:
            gone.update(set(ids(member)).difference(part.live))
    return tuple(sorted(gone))


def _ranges(part: Part) -> tuple[tuple[int, int], ...]:
    return tuple((first, stop) for first, stop in ranges(part.live))


def _packed(parts: Iterable[Part], shard_frames: int) -> list[_Group]:
    """Combine parts, in order of their takes, until a shard is full; no part is divided."""
    groups: list[_Group] = []
    waiting: list[Part] = []
    frames = 0
    for part in sorted(parts, key=lambda part: part.live[0]):
        waiting.append(part)
        frames += part.live_rows
        if frames >= shard_frames:
            groups.append(_Group(tuple(waiting), frames))
            waiting, frames = [], 0
    return [*groups, _Group(tuple(waiting), frames)] if waiting else groups


def _merged(groups: list[_Group], shard_frames: int) -> list[_Group]:
    """Merge full tiers, the lowest first, until no tier is full."""
    while True:
        tiers: dict[int, list[_Group]] = {}
        for group in groups:
            if group.frames < shard_frames:
                tiers.setdefault(_tier(group.frames), []).append(group)
        full = [tiers[tier] for tier in sorted(tiers) if len(tiers[tier]) >= FANOUT]
        if not full:
            return groups
        members = {id(group) for group in full[0]}
        together = chain.from_iterable(group.parts for group in full[0])
        groups = [group for group in groups if id(group) not in members] + _packed(together, shard_frames)


def _tier(frames: int) -> int:
    tier = 0
    while frames >= SMALLEST * FANOUT**tier:
        tier += 1
    return tier
