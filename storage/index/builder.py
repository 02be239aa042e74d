"""Building the index aside and publishing it: a copy of the generation before, made anew where parts have changed."""

from __future__ import annotations

import hashlib
import os
import shutil
import time
import uuid
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import compress
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from kinedex.ops.errors import StoreError
from kinedex.ops.search.bit_slices import slice_words
from kinedex.storage.index import tables
from kinedex.storage.index.generations import (
    BUILDING,
    FILE,
    INDEX_VERSION,
    KEPT,
    SAYS,
    Generation,
    Shard,
    current,
    file_digest,
    generations,
    is_of,
    is_whole,
    new_generation,
    read_generation,
    slices_name,
)
from kinedex.storage.index.plan import SHARD_FRAMES, Plan, plan, shard_parts
from kinedex.storage.index.slices import write_slices
from kinedex.storage.sql import duck
from kinedex.storage.store.disk import sync_folder, writing
from kinedex.storage.store.frames import read_words
from kinedex.storage.store.lock import Lock
from kinedex.storage.store.manifest import Part, now

if TYPE_CHECKING:
    from kinedex.storage.store.store import Store

MOST_WASTE = 2.0
"""A file that has grown to more than this many times the size that it would have anew is written anew."""

SPARE_BYTES = 4_000_000
"""Bytes that a small file may waste all the same."""

_AHEAD = 4
"""Most shards that are made while one is being stored, whatever the number of cores: each is some 100 MB."""

Item = TypeVar("Item")
Result = TypeVar("Result")


def build(
    store: Store, threads: int | None = None, memory_mb: int | None = None, shard_frames: int = SHARD_FRAMES
) -> Path:
    """Build and publish the index of a store's live takes, unless it stands already; the newest `KEPT` stay.

    What the generation before has of the same takes is copied, not made again.

    Parameters
    ----------
    store: the version to index.
    threads: how many to use, for making shards and for storing them; None takes one for every core.
    memory_mb: what DuckDB may use; None leaves it to DuckDB.
    shard_frames: frames from which a shard is full.

    Returns
    -------
    The generation's folder. Readers that have an older generation open keep it.

    Raises
    ------
    StoreError: another process builds an index of this store, a part cannot be read, or there is no space for the
        index; the generation before stays.
    """
    folder = store.path / "index"
    with writing(folder):
        folder.mkdir(exist_ok=True)
    with Lock(folder / "lock", "this build"):
        standing = current(store.path, store.manifest)
        if standing is not None and _stands(store, standing):
            return standing
        for leftover in folder.glob(f"{BUILDING}*"):
            shutil.rmtree(leftover)
        building = folder / f"{BUILDING}{uuid.uuid4().hex}"
        generation = new_generation(store.path, store.manifest.version)
        try:
            with writing(building):
                building.mkdir()
                _build(store, building, threads, memory_mb, shard_frames)
                os.rename(building, generation)
                sync_folder(folder)
        finally:
            shutil.rmtree(building, ignore_errors=True)
        for number, old in enumerate(generations(store.path)):
            # of the same version: damaged, of another version of the index, or with other macros
            if number >= KEPT or (old != generation and is_of(old, store.manifest.version)):
                removed = folder / f"{BUILDING}{uuid.uuid4().hex}"
                os.rename(old, removed)
                shutil.rmtree(removed)
        return generation


def _stands(store: Store, generation: Path) -> bool:
    says = read_generation(generation)
    return (
        says is not None and says.surface == tables.surface(store.feature_set, store.rate_hz) and is_whole(generation)
    )


@dataclass(frozen=True)
class _Start:
    """What a build begins with: the shards of an earlier generation that was copied, or none in an empty file.

    generation: its folder. shards: those that can be kept. lost: those whose bit slices are damaged.
    """

    generation: Path | None = None
    shards: tuple[Shard, ...] = ()
    lost: tuple[Shard, ...] = ()
    surface: str = ""
    whole_bytes_per_frame: float | None = None


def _build(store: Store, folder: Path, threads: int | None, memory_mb: int | None, shard_frames: int) -> None:
    began = time.perf_counter()
    file = folder / FILE
    start = _copied(store, file)
    surface = tables.surface(store.feature_set, store.rate_hz)
    work = plan(store.manifest.frames, start.shards, shard_frames)
    connection = duck.connect(threads, memory_mb)
    try:
        # this storage version is read by DuckDB 1.5 as well as by 2.x
        version = "" if start.generation else "(STORAGE_VERSION 'v1.5.0')"
        connection.execute(f"ATTACH {duck.quote(str(file))} AS building {version}")
        connection.execute("USE building")
        connection.execute("BEGIN")
        if not start.generation:
            tables.create(connection, store.feature_set)
        elif start.surface != surface:
            tables.clear(connection)
        _delete(connection, store, work, start)
        _link(work.kept, start.generation, folder)
        fresh = _insert(connection, store, work, start, folder, threads)
        tables.describe(connection, store, anew=start.surface != surface)
        rows = tables.count(connection)
        valid = tables.valid_frames(connection, store.feature_set)
        connection.execute("COMMIT")
        connection.execute("USE memory")
        connection.execute("DETACH building")
    except duck.Error as fault:
        raise StoreError(
            f"{file}: the index cannot be built: {duck.first_line(fault)}; where space on disk or memory is short, "
            "make room (`kinedex gc` removes what only old versions need) or set `memory_mb` of the stage `index`"
        ) from None
    finally:
        connection.close()
    with open(file, "rb") as content:
        os.fsync(content.fileno())
        digest = hashlib.file_digest(content, "sha256").hexdigest()
    shards = (*work.kept, *fresh)
    size = file.stat().st_size
    says = Generation(
        index_version=INDEX_VERSION,
        manifest_version=store.manifest.version,
        content=store.manifest.content_digest(),
        feature_set_digest=store.feature_set.digest,
        rate_hz=store.rate_hz,
        surface=surface,
        shards=shards,
        rows=rows,
        valid_frames=valid,
        bytes=size,
        sha256=digest,
        whole_bytes_per_frame=start.whole_bytes_per_frame or size / max(1, sum(shard.frames for shard in shards)),
        built=now(),
        built_frames=sum(shard.frames for shard in fresh),
        build_seconds=round(time.perf_counter() - began, 3),
    )
    with open(folder / SAYS, "w", encoding="utf-8") as said:
        said.write(says.to_json())
        said.flush()
        os.fsync(said.fileno())
    sync_folder(folder)


def _copied(store: Store, file: Path) -> _Start:
    """Copy the newest generation that can serve as a start; an empty start where none can."""
    for generation in generations(store.path):
        says = read_generation(generation)
        if (
            says is not None
            and says.shards
            and (says.index_version, says.feature_set_digest, says.rate_hz)
            == (INDEX_VERSION, store.feature_set.digest, store.rate_hz)
            and says.bytes <= MOST_WASTE * says.whole_bytes_per_frame * says.frames + SPARE_BYTES
        ):
            if _copy(generation / FILE, file) == says.sha256:
                whole = [
                    file_digest(generation / slices_name(shard.number)) == shard.slices_sha256 for shard in says.shards
                ]
                return _Start(
                    generation,
                    tuple(compress(says.shards, whole)),
                    tuple(shard for shard, stays in zip(says.shards, whole, strict=True) if not stays),
                    says.surface,
                    says.whole_bytes_per_frame,
                )
            # damaged: what is copied from it would get a checksum that fits
            file.unlink(missing_ok=True)
    return _Start()


def _copy(source: Path, target: Path) -> str:
    """Copy a file and return its checksum; an empty text where it is not there."""
    digest = hashlib.sha256()
    try:
        with open(source, "rb") as content, open(target, "wb") as copy:
            while piece := content.read(1 << 20):
                digest.update(piece)
                copy.write(piece)
    except FileNotFoundError:
        return ""
    return digest.hexdigest()


def _delete(connection: duck.Connection, store: Store, work: Plan, start: _Start) -> None:
    """Delete what is not in the next generation any more."""
    before = {shard.number: shard.take_ids for shard in (*start.shards, *start.lost)}
    removed = (*work.removed, *(shard.number for shard in start.lost))
    after = {shard.number: shard.take_ids for shard in work.kept}
    tables.delete(
        connection,
        store.feature_set,
        {number: before[number] for number in removed},
        {number: (lost, after[number]) for number, lost in work.dropped.items()},
    )


def _link(kept: Iterable[Shard], before: Path | None, folder: Path) -> None:
    """Take over the bit slices of shards that stay: one file in both generations, where the file system can."""
    for shard in kept:
        assert before is not None
        name = slices_name(shard.number)
        try:
            os.link(before / name, folder / name)
        except OSError:
            shutil.copyfile(before / name, folder / name)


def _insert(
    connection: duck.Connection, store: Store, work: Plan, start: _Start, folder: Path, threads: int | None
) -> tuple[Shard, ...]:
    """Make the new shards, several at a time, and store them in their order; bit slices go into files beside."""
    features = len(store.feature_set.features)

    def make(item: tuple[int, tuple[Part, ...]]) -> tuple[Shard, tables.ShardRows]:
        number, parts = item
        words = read_words(store.path, replace(store.manifest, frames=parts), None)
        slices = slice_words(words.words, words.offsets, features)
        written = write_slices(folder / slices_name(number), words.take_ids, slices)
        rows = tables.make_shard(words, store.feature_set)
        return Shard(number, shard_parts(parts), rows.frames, rows.frames, *written), rows

    before = max((shard.number for shard in (*start.shards, *start.lost)), default=0)
    fresh: list[Shard] = []
    workers = min(_AHEAD, threads or os.cpu_count() or 1, len(work.fresh))
    for shard, rows in _ahead(make, enumerate(work.fresh, before + 1), workers):
        if fresh:
            # one transaction for all would keep something of each: 1.6 GB instead of 0.7 at 400 hours
            connection.execute("COMMIT")
            connection.execute("BEGIN")
        tables.insert(connection, shard.number, rows)
        fresh.append(shard)
    return tuple(fresh)


def _ahead(function: Callable[[Item], Result], items: Iterable[Item], workers: int) -> Iterator[Result]:
    """Apply a function in threads, at most one item a thread ahead of what is taken; results in the items' order."""
    if workers <= 1:
        yield from map(function, items)
        return
    with ThreadPoolExecutor(workers) as pool:
        waiting: deque[Future[Result]] = deque()
        try:
            for item in items:
                waiting.append(pool.submit(function, item))
                if len(waiting) > workers:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()
