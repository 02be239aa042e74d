"""Checks of checksums: their cost beside reading a part of 100 MB whole, and beside opening one take of it.

The part holds the motion of the synthetic archive with noise of a tenth of a millimetre, so that it is compressed as
measured motion is. All files are in the memory of the operating system; from a disk a check costs one reading of the
file. Shares and differences are of the processors' time, which other work of the machine disturbs less. No check costs
less than reading the file's bytes, whose share stands beside.
"""

from __future__ import annotations

import os
import pickle
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from benchmarks.archive import BUILD
from benchmarks.harness import Figure, seconds, sized
from kinedex.storage.snapshot.checked_files import CheckedFiles
from kinedex.storage.snapshot.parts import FramesWriter, joint_positions
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.writer import StoreWriter
from tests.storage.made_up import take_row, takes_table

PART_BYTES = sized(100_000_000, 4_000_000)

MANY = sized(40, 3)
"""Runs of what takes milliseconds."""


def figures(source: Store) -> Iterator[Figure]:
    """Time the check of a part alone, beside other work on it, and after it is done."""
    store = large_part(source)
    (part,) = store.manifest.frames
    file, take = store.path / part.path, next(iter(store.take_ids))

    def read() -> object:
        return pq.ParquetFile(file).read()

    def check() -> object:
        return CheckedFiles(store.path).part(part)

    def sql() -> object:
        return store.sql("FROM frames")

    work = f"{part.bytes / 1e6:.0f} MB"
    yield Figure(f"check a part of {work}", part.bytes / 1e9, "GB", seconds(check, MANY), "reading it", seconds(read))
    spent, plain = _processor(check, MANY), _processor(lambda: _read_bytes(file), MANY)
    for name, whole in {"reading all columns": _processor(read, 10), "FROM frames": _processor(sql, 5)}.items():
        least = 100 * plain / whole
        yield Figure(f"its share of {name}", 100 * spent / whole, "%", None, "that of its bytes", None, least)

    def opened(*, sound: bool) -> Callable[[], object]:
        def work() -> object:
            fresh = open_store(store.path)
            if sound:
                fresh.checked = known
            return fresh.frames(take)

        return work

    store.frames(take)
    known = store.checked
    without, checked = _processor(opened(sound=True), MANY), _processor(opened(sound=False), MANY)
    yield Figure(f"open one take of {work}: processors", 1, "takes", checked, "without the check", without)
    added = 1000 * (checked - without)
    yield Figure("one take: added by the check", added, "ms", None, "at most 20 ms", None, 20.0)
    again = seconds(lambda: [store.checked.part(part) for _ in range(1000)]) / 1000
    yield Figure("check a part that was checked before", 1, "parts", again, "a call of os.stat", _stat(file))
    sent = pickle.dumps(store)
    yield Figure(
        "one take in a worker that received the store", 1, "takes",
        _processor(lambda: pickle.loads(sent).frames(take), MANY), "a store that was opened there", checked,
    )  # fmt: skip


def _processor(work: Callable[[], object], runs: int) -> float:
    """Return the shortest time that the processors spent on work, which other work of the machine disturbs less."""
    times = []
    for _ in range(runs):
        begin = time.process_time()
        work()
        times.append(time.process_time() - begin)
    return min(times)


def _read_bytes(file: Path) -> None:
    """Read a file into one block of memory after the other, as a check does."""
    block = bytearray(1 << 20)
    with open(file, "rb", buffering=0) as opened:
        while opened.readinto(block):
            pass


def _stat(file: Path) -> float:
    return seconds(lambda: [os.stat(file) for _ in range(1000)]) / 1000


def large_part(source: Store) -> Store:
    """Return a store with one part of frames of `PART_BYTES`; make it if it is missing."""
    path = BUILD / "large-part"
    if not (path / "manifest").is_dir() or not open_store(path).manifest.frames:
        dice = np.random.default_rng(0)
        with StoreWriter.open(path, source.feature_set) as writer:
            rows = source.take_rows.to_pylist()
            bytes_per_frame = 173
            wanted = PART_BYTES // bytes_per_frame
            copies = -(-wanted // sum(row["frames"] for row in rows))
            names = {f"{row['name']} {copy}": row for copy in range(copies) for row in rows}
            ids = writer.assign_take_ids(names)
            taken, total = [], 0
            with FramesWriter(path, source.feature_set) as frames:
                for name, take_id in ids.items():
                    if total >= wanted:
                        break
                    table = source.frames(names[name]["name"])
                    positions = joint_positions(table, source.feature_set.joints)
                    positions = positions + dice.normal(0, 1e-4, positions.shape).astype(np.float32)
                    turned = table.column("root_orientation").combine_chunks().flatten()
                    words = source.words([names[name]["take_id"]]).words
                    frames.add(take_id, positions, np.array([axis.to_numpy() for axis in turned]), words)
                    taken.append(take_row(take_id, name, table.num_rows))
                    total += table.num_rows
                part = frames.close()
            writer.add_takes(takes_table(taken), part)
            writer.commit()
    return open_store(path)
