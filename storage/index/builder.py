"""Build the index: copy the previous generation, replace the shards that changed, and publish the copy by a rename."""

from __future__ import annotations

import os
import shutil
import time
import uuid
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from itertools import compress
from pathlib import Path
from typing import Protocol, TypeVar

import xxhash

from kinedex.ops.errors import StoreError
from kinedex.ops.search.bit_slices import slice_words
from kinedex.storage import duckdb_sql
from kinedex.storage.durable_files import sync_file, sync_folder, write_errors, write_flushed
from kinedex.storage.index import index_tables
from kinedex.storage.index.generations import (
    BUILDING,
    FILE,
    INDEX_VERSION,
    KEPT,
    RECORD,
    Generation,
    Shard,
    current_generation,
    file_digest,
    generations,
    is_of,
    is_whole,
    new_generation,
    read_generation,
    slices_name,
)
from kinedex.storage.index.index_views import views_digest as index_surface
from kinedex.storage.index.shard_plan import SHARD_FRAMES, ShardPlan, plan_shards, shard_parts
from kinedex.storage.index.slice_files import write_slices
from kinedex.storage.leases import open_versions
from kinedex.storage.lock import NO_WAIT, Lock, Wait
from kinedex.storage.snapshot.frames import read_words
from kinedex.storage.snapshot.manifest import Part, now
from kinedex.storage.snapshot.manifest_files import content_digest_of
from kinedex.storage.snapshot.snapshot import Snapshot

MAX_WASTE = 2.0
"""The largest ratio of an index file's size to that of a complete rewrite; a larger file is rewritten."""

SPARE_BYTES = 4_000_000
"""The number of bytes that a small file may waste without being rewritten."""

_AHEAD = 4
"""The largest number of shards made in advance of the one being stored; each takes some 100 MB."""


class Counter(Protocol):
    """A progress counter."""

    def advance(self, n: int = 1) -> object:
        """Advance the counter by n."""


Progress = Callable[[str, int], AbstractContextManager[Counter]]
"""A function that takes a description and a number of steps, and returns a context manager that shows the progress."""

Item = TypeVar("Item")
Result = TypeVar("Result")


def build_index(
    store: Snapshot,
    threads: int | None = None,
    memory_mb: int | None = None,
    shard_frames: int = SHARD_FRAMES,
    wait: Wait = NO_WAIT,
    progress: Progress | None = None,
) -> Path:
    """Build and publish the index of a store's live takes, unless it exists already.

    The newest `KEPT` generations are kept, and those of versions that readers have open.

    Shards of the previous generation whose takes are unchanged are copied, not made again.

    Parameters
    ----------
    store : Snapshot
        The version to index.
    threads : int, optional
        Number of threads that make shards (4 at most), and that store them; one for every core by default.
    memory_mb : int, optional
        Largest memory of DuckDB in MB; by default DuckDB decides.
    shard_frames : int, optional
        Number of frames at which a shard is full.
    wait : Wait, optional
        The time to wait for another build to finish.
    progress : callable, optional
        Shows the progress of storing newly indexed frames.

    Returns
    -------
    Path
        The generation's folder. Readers that have an older generation open keep it.

    Raises
    ------
    StoreError
        Another process builds an index of this store, a part cannot be read, or there is no space for the index; the
        previous generation is kept.
    """
    folder = store.path / "index"
    with write_errors(folder):
        folder.mkdir(exist_ok=True)
    with Lock(folder / "lock", "this build", wait):
        standing = current_generation(store.path, store.manifest)
        if standing is not None and _is_current(store, standing):
            return standing
        for leftover in folder.glob(f"{BUILDING}*"):
            shutil.rmtree(leftover, ignore_errors=True)
        building = folder / f"{BUILDING}{uuid.uuid4().hex}"
        generation = new_generation(store.path, store.manifest.version)
        try:
            with write_errors(building):
                building.mkdir()
                _build(store, building, threads, memory_mb, shard_frames, progress)
                os.rename(building, generation)
                sync_folder(folder)
        finally:
            shutil.rmtree(building, ignore_errors=True)
        _remove_old(store, generation)
        return generation


def _remove_old(store: Snapshot, built: Path) -> None:
    """Remove generations that the new one replaces, and old generations whose versions no reader has open."""
    for number, old in enumerate(generations(store.path)):
        # an index of the same version of the store is damaged, or made with another index version or other macros
        if old != built and is_of(old, store.manifest.version):
            _remove_generation(store, old, replaced=True)
        elif number >= KEPT and not _is_read(store, old):
            _remove_generation(store, old)


def _is_read(store: Snapshot, generation: Path) -> bool:
    """Return whether a reader has a version open that belongs to a generation."""
    record = read_generation(generation)
    return record is not None and any(
        content_digest_of(store.path, one.version, store.manifest) == record.content
        for one in open_versions(store.path)
    )


def _remove_generation(store: Snapshot, generation: Path, *, replaced: bool = False) -> None:
    """Remove a generation, after renaming it so that no reader finds it."""
    removed = generation.with_name(f"{BUILDING}{uuid.uuid4().hex}")
    try:
        os.rename(generation, removed)
    except PermissionError:
        return  # Windows: a reader has it open; a later build removes it
    if not replaced and _is_read(store, removed):
        os.rename(removed, generation)  # a reader has opened its version in the meantime
        return
    shutil.rmtree(removed, ignore_errors=True)


def _is_current(store: Snapshot, generation: Path) -> bool:
    """Return whether a generation is undamaged and has the current views and macros."""
    record = read_generation(generation)
    return (
        record is not None
        and record.surface == index_surface(store.feature_set, store.rate_hz)
        and is_whole(generation)
    )


@dataclass(frozen=True)
class _Start:
    """The starting point of a build: a copy of an earlier generation with its shards, or an empty file.

    Attributes
    ----------
    generation : Path, optional
        Folder of the generation that was copied.
    shards : tuple of Shard
        Shards that can be reused.
    lost : tuple of Shard
        Shards whose bit slices are damaged.
    surface : str
        `Generation.surface` of the copied generation.
    whole_bytes_per_frame : float, optional
        Bytes per frame when its file was last written completely.
    """

    generation: Path | None = None
    shards: tuple[Shard, ...] = ()
    lost: tuple[Shard, ...] = ()
    surface: str = ""
    whole_bytes_per_frame: float | None = None


def _build(
    store: Snapshot,
    folder: Path,
    threads: int | None,
    memory_mb: int | None,
    shard_frames: int,
    progress: Progress | None,
) -> None:
    """Write the files of a new generation into a folder."""
    began = time.perf_counter()
    file = folder / FILE
    start = _copied(store, file)
    surface = index_surface(store.feature_set, store.rate_hz)
    work = plan_shards(store.manifest.frames, start.shards, shard_frames)
    connection = duckdb_sql.connect(threads, memory_mb)
    try:
        # both DuckDB 1.5 and 2.x read this storage version
        version = "" if start.generation else "(STORAGE_VERSION 'v1.5.0')"
        connection.execute(f"ATTACH {duckdb_sql.quote(str(file))} AS building {version}")
        connection.execute("USE building")
        connection.execute("BEGIN")
        if not start.generation:
            index_tables.create(connection, store.feature_set)
        elif start.surface != surface:
            index_tables.clear(connection)
        _delete(connection, store, work, start)
        _link(work.kept, start.generation, folder)
        frames = sum(part.rows - part.dropped_rows for parts in work.fresh for part in parts)
        with nullcontext() if progress is None else progress("frames", frames) as bar:
            fresh = _insert(connection, store, work, start, folder, threads, bar)
        index_tables.describe(connection, store, anew=start.surface != surface)
        rows = index_tables.count(connection)
        valid = index_tables.valid_frames(connection)
        connection.execute("COMMIT")
        connection.execute("USE memory")
        connection.execute("DETACH building")
    except duckdb_sql.Error as fault:
        raise StoreError(
            f"{file}: the index cannot be built: {duckdb_sql.first_line(fault)}; where space on disk or memory is "
            "short, "
            "make room (`kinedex gc` removes what only old versions need) or set `memory_mb` of the stage `index`"
        ) from None
    finally:
        connection.close()
    _write_record(store, folder, start, (*work.kept, *fresh), rows, valid, time.perf_counter() - began)
    sync_folder(folder)


def _write_record(
    store: Snapshot,
    folder: Path,
    start: _Start,
    shards: tuple[Shard, ...],
    rows: dict[str, int],
    valid_frames: int,
    seconds: float,
) -> None:
    """Flush the DuckDB file to disk and write the generation's record."""
    sums = sync_file(folder / FILE)
    old = {shard.number for shard in start.shards}
    record = Generation(
        index_version=INDEX_VERSION,
        manifest_version=store.manifest.version,
        content=store.manifest.content_digest(),
        feature_set_digest=store.feature_set.digest,
        rate_hz=store.rate_hz,
        surface=index_surface(store.feature_set, store.rate_hz),
        shards=shards,
        rows=rows,
        valid_frames=valid_frames,
        bytes=sums.bytes,
        xxh3=sums.xxh3,
        whole_bytes_per_frame=start.whole_bytes_per_frame or sums.bytes / max(1, sum(shard.frames for shard in shards)),
        built=now(),
        built_frames=sum(shard.frames for shard in shards if shard.number not in old),
        build_seconds=round(seconds, 3),
        takes=store.manifest.takes_digest(),
    )
    write_flushed(folder / RECORD, record.to_json())


def _copied(store: Snapshot, file: Path) -> _Start:
    """Copy the newest generation that can be a starting point; return an empty start if there is none."""
    for generation in generations(store.path):
        record = read_generation(generation)
        if record is not None and _can_start(store, record):
            if _copy(generation / FILE, file) == record.xxh3:
                whole = [
                    file_digest(generation / slices_name(shard.number)) == shard.slices_xxh3 for shard in record.shards
                ]
                return _Start(
                    generation,
                    tuple(compress(record.shards, whole)),
                    tuple(shard for shard, stays in zip(record.shards, whole, strict=True) if not stays),
                    record.surface,
                    record.whole_bytes_per_frame,
                )
            # the file is damaged; its copy would get a new checksum, which would match
            file.unlink(missing_ok=True)
    return _Start()


def _can_start(store: Snapshot, record: Generation) -> bool:
    """Return whether a generation indexes words of the store's kind, in a file that does not waste much space."""
    made_with = (record.index_version, record.feature_set_digest, record.rate_hz)
    return (
        bool(record.shards)
        and made_with == (INDEX_VERSION, store.feature_set.digest, store.rate_hz)
        and record.bytes <= MAX_WASTE * record.whole_bytes_per_frame * record.frames + SPARE_BYTES
    )


def _copy(source: Path, target: Path) -> str:
    """Copy a file and return its checksum; empty if there is no file."""
    digest = xxhash.xxh3_128()
    try:
        with open(source, "rb") as content, open(target, "wb") as copy:
            while piece := content.read(1 << 20):
                digest.update(piece)
                copy.write(piece)
    except FileNotFoundError:
        return ""
    return digest.hexdigest()


def _delete(connection: duckdb_sql.Connection, store: Snapshot, work: ShardPlan, start: _Start) -> None:
    """Delete the rows that the next generation does not contain."""
    before = {shard.number: shard.take_ids for shard in (*start.shards, *start.lost)}
    removed = (*work.removed, *(shard.number for shard in start.lost))
    after = {shard.number: shard.take_ids for shard in work.kept}
    index_tables.delete(
        connection,
        store.feature_set,
        {number: before[number] for number in removed},
        {number: (lost, after[number]) for number, lost in work.dropped.items()},
    )


def _link(kept: Iterable[Shard], before: Path | None, folder: Path) -> None:
    """Link the bit slices of reused shards into the new folder; copy them if the file system has no links."""
    for shard in kept:
        assert before is not None
        name = slices_name(shard.number)
        try:
            os.link(before / name, folder / name)
        except OSError:
            shutil.copyfile(before / name, folder / name)


def _insert(
    connection: duckdb_sql.Connection,
    store: Snapshot,
    work: ShardPlan,
    start: _Start,
    folder: Path,
    threads: int | None,
    bar: Counter | None,
) -> tuple[Shard, ...]:
    """Make new shards in threads and store their rows in order; write their bit slices to files beside the index."""
    features = len(store.feature_set.features)

    def make(item: tuple[int, tuple[Part, ...]]) -> tuple[Shard, index_tables.ShardRows]:
        number, parts = item
        words = store.with_known(read_words(store.checked, replace(store.manifest, frames=parts), None))
        slices = slice_words(words.words, words.offsets, features)
        written = write_slices(folder / slices_name(number), words.take_ids, slices)
        rows = index_tables.make_shard(words, store.feature_set)
        return Shard(number, shard_parts(parts), rows.frames, rows.frames, *written), rows

    before = max((shard.number for shard in (*start.shards, *start.lost)), default=0)
    fresh: list[Shard] = []
    workers = min(_AHEAD, threads or os.cpu_count() or 1, len(work.fresh))
    made = _ahead(make, enumerate(work.fresh, before + 1), workers)
    for (shard, rows), parts in zip(made, work.fresh, strict=True):
        if fresh:
            # a single transaction would hold more memory: 1.6 GB instead of 0.7 at 400 hours
            connection.execute("COMMIT")
            connection.execute("BEGIN")
        index_tables.insert(connection, shard.number, rows)
        fresh.append(shard)
        if bar is not None:
            bar.advance(sum(part.rows - part.dropped_rows for part in parts))
    return tuple(fresh)


def _ahead(function: Callable[[Item], Result], items: Iterable[Item], workers: int) -> Iterator[Result]:
    """Apply a function in threads and yield results in order, with at most one item per thread in advance."""
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
