"""Compaction: what is merged, that nothing is lost on the way, and what it costs."""

from __future__ import annotations

import os
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops.errors import StoreError
from kinedex.storage.index.builder import build_index
from kinedex.storage.remedies import repair
from kinedex.storage.snapshot.manifest import Part
from kinedex.storage.snapshot.manifest_files import versions
from kinedex.storage.snapshot.parts import ROW_GROUP, FramesWriter
from kinedex.storage.store import compaction
from kinedex.storage.store import writer as writers
from kinedex.storage.store.compaction import FANOUT, compact, merge_groups, part_count
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.verification import verify
from kinedex.storage.store.writer import StoreWriter
from tests import killed_runs
from tests.storage.made_up import BODY, add, arrays, take_row, takes_table


def in_batches(path: Path, batches: int, frames: int = 9, edition: int = 0) -> Store:
    """A store whose takes b00_0, b00_1, b01_0, … came in so many batches, each committed."""
    with StoreWriter.open(path, BODY) as writer:
        for batch in range(batches):
            add(writer, {f"b{batch:02}_{i}": frames + i for i in range(2)}, edition=edition)
            writer.commit()
    return open_store(path)


def content(store: Store) -> tuple[pl.DataFrame, list[tuple[int, list[int], float]]]:
    """Everything that a reader sees of the takes."""
    words = store.words()
    rows = []
    for place, take in enumerate(words.take_ids.tolist()):
        name = store.takes().filter(pl.col("take_id") == take)["name"][0]
        table = store.frames(name)
        assert table.column("frame").to_pylist() == list(range(table.num_rows))
        heights = table.column("rwrist").combine_chunks().field("y").to_numpy()
        rows.append((take, words.take(place).tolist(), float(heights.sum())))
    return store.takes(), rows


def same(one: Store, other: Store) -> bool:
    (takes, rows), (other_takes, other_rows) = content(one), content(other)
    return takes.equals(other_takes) and rows == other_rows


def test_many_small_parts_become_one_sorted_by_take_and_nothing_else_changes(tmp_path: Path) -> None:
    before = in_batches(tmp_path, FANOUT + 1)
    build_index(before)
    with StoreWriter.open(tmp_path, BODY) as writer:
        done = compact(writer)
    after = open_store(tmp_path)
    assert (done.frames_before, done.frames_after, done.takes_before, done.takes_after) == (9, 1, 9, 1)
    assert len(after.manifest.frames) == len(after.manifest.takes) == 1
    assert after.manifest.frames[0].take_ids == after.manifest.live_takes
    assert same(before, after)
    assert after.index_path() == before.index_path()
    assert after.sql("SELECT count(*)::BIGINT AS n FROM frames").column(0).to_pylist() == [171]
    assert verify(after) == []


def test_a_take_replaced_after_the_compaction_makes_the_index_stale(tmp_path: Path) -> None:
    build_index(in_batches(tmp_path, FANOUT))
    with StoreWriter.open(tmp_path, BODY) as writer:
        compact(writer)
        add(writer, {"b00_0": 9}, edition=1)
        writer.commit()
    with pytest.raises(StoreError, match="the index is stale"):
        open_store(tmp_path, at="newest").index_path()


def test_every_change_of_takes_and_nothing_else_changes_what_the_index_goes_by(tmp_path: Path) -> None:
    digests = [in_batches(tmp_path, FANOUT).manifest.content_digest()]
    with StoreWriter.open(tmp_path, BODY) as writer:
        for change in (
            lambda: add(writer, {"b00_0": 9}, edition=1),
            lambda: add(writer, {"b00_0": 9}, edition=1, actor="someone else"),
            lambda: writer.drop_takes([1]),
            lambda: add(writer, {"new": 4}),
        ):
            change()
            digests.append(writer.commit().content_digest())
            compact(writer)
            assert writer.manifest.content_digest() == digests[-1]
    assert len(set(digests)) == len(digests)


def test_rows_of_replaced_and_dropped_takes_are_gone_afterwards(tmp_path: Path) -> None:
    in_batches(tmp_path, 4)
    in_batches(tmp_path, 4, frames=5, edition=1)
    with StoreWriter.open(tmp_path, BODY) as writer:
        add(writer, {f"c{i}": 7 for i in range(6)})
        writer.commit()
        gone = writer.assign_take_ids(["b00_1", "c0", "c1", "c2", "c3"])
        writer.drop_takes(gone.values())
        before = writer.commit()
        assert [part.dropped_rows for part in before.frames] == [6, 0, 0, 0, 28]
        assert verify(writer.store) == []
        for batch in range(4, 8):
            add(writer, {f"b{batch:02}_{i}": 5 + i for i in range(2)})
            writer.commit()
        before_store = writer.store
        compact(writer)
    after = open_store(tmp_path)
    assert sum(part.rows for part in after.manifest.frames) == sum(after.takes()["frames"])
    assert not any(part.dropped or part.dropped_rows for part in (*after.manifest.frames, *after.manifest.takes))
    assert same(before_store, after)
    assert verify(after) == []


def test_new_parts_reach_the_target_and_hold_whole_takes(tmp_path: Path) -> None:
    before = in_batches(tmp_path, 24, frames=400)
    size = sum(part.bytes for part in before.manifest.frames)
    with StoreWriter.open(tmp_path, BODY) as writer:
        done = compact(writer, target_bytes=size // 5)
        assert done.frames_after == 4
        assert not compact(writer, target_bytes=size // 5).changed
    after = open_store(tmp_path)
    assert all(part.bytes >= size // 5 for part in after.manifest.frames)
    takes = [take for part in after.manifest.frames for take in part.take_ids]
    assert takes == sorted(takes)
    assert same(before, after)


def test_takes_that_interleave_over_parts_and_row_groups_come_out_in_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # so small that row groups must be read again and again
    monkeypatch.setattr(compaction, "KEPT_ROWS", 10)
    lengths = {take: 40 + take % 7 for take in range(1, 5 * FANOUT + 1)}
    lengths[7] = 0
    with StoreWriter.open(tmp_path, BODY) as writer:
        ids = writer.assign_take_ids([f"t{take:03}" for take in lengths])
        for place in range(FANOUT):
            monkeypatch.setattr("kinedex.storage.snapshot.parts.ROW_GROUP", 25)
            with FramesWriter(tmp_path, BODY) as part:
                mine = [take for take in lengths if take % FANOUT == place]
                for take in mine:
                    part.add(take, *arrays(f"t{take:03}", lengths[take]))
                written = part.close()
            monkeypatch.setattr("kinedex.storage.snapshot.parts.ROW_GROUP", ROW_GROUP)
            assert sorted(ids.values()) == sorted(lengths)
            writer.add_takes(takes_table([take_row(take, f"t{take:03}", lengths[take]) for take in mine]), written)
        before = Store(tmp_path, writer.commit())
        compact(writer)
    after = open_store(tmp_path)
    assert len(after.manifest.frames) == 1
    assert same(before, after)
    assert verify(after) == []


def test_a_damaged_part_of_takes_is_not_given_a_fresh_checksum(tmp_path: Path) -> None:
    store = in_batches(tmp_path, FANOUT)
    file = tmp_path / store.manifest.takes[3].path
    sound = file.read_bytes()
    file.write_bytes(sound[:200] + bytes([sound[200] ^ 1]) + sound[201:])
    with pytest.raises(StoreError, match="does not fit its checksum"), StoreWriter.open(tmp_path, BODY) as writer:
        compact(writer)
    assert open_store(tmp_path).manifest == store.manifest


def test_a_damaged_part_of_frames_stays_and_the_others_are_merged(tmp_path: Path) -> None:
    store = in_batches(tmp_path, FANOUT + 1)
    bad = store.manifest.frames[3]
    file = tmp_path / bad.path
    damaged = bytearray(file.read_bytes())
    damaged[200] ^= 1
    file.write_bytes(damaged)
    with StoreWriter.open(tmp_path, BODY) as writer:
        done = compact(writer)
    assert (done.frames_before, done.frames_after) == (FANOUT, 1)
    assert [bad.path.split("/")[1] in str(fault) for fault in done.damaged] == [True]
    assert [fault.remedy for fault in done.damaged] == [repair(tmp_path)]
    after = open_store(tmp_path).manifest
    assert bad in after.frames
    assert after.live_takes == store.manifest.live_takes
    assert file.read_bytes() == damaged


def test_a_writer_refuses_parts_that_do_not_hold_the_same(tmp_path: Path) -> None:
    store = in_batches(tmp_path, 3)
    first, second, third = store.manifest.frames
    with StoreWriter.open(tmp_path, BODY) as writer:
        for old, new in (([first], [second]), ([first, second], [third]), ([first], [])):
            with pytest.raises(StoreError, match="do not have the rows of the old"):
                writer.swap_parts("frames", old, new)
        add(writer, {"new": 3})
        with pytest.raises(StoreError, match="commit them first"):
            writer.swap_parts("frames", [first], [first])


def compact_and_die(store: Path, moment: str) -> None:
    def die(*_: object) -> None:
        os.kill(os.getpid(), signal.SIGKILL)

    if moment == "before the commit":
        writers.publish = die
    else:
        StoreWriter.swap_parts = die  # type: ignore[method-assign]
    with StoreWriter.open(store, BODY) as writer:
        compact(writer)


@pytest.mark.parametrize("moment", ["before the commit", "before the swap"])
def test_killed_on_the_way_it_leaves_the_store_as_it_was(tmp_path: Path, moment: str) -> None:
    before = in_batches(tmp_path, FANOUT)
    files = sorted(os.listdir(tmp_path / "frames"))
    killed = killed_runs.start(compact_and_die, tmp_path, moment)
    killed.join()
    assert killed.exitcode == -signal.SIGKILL
    assert len(os.listdir(tmp_path / "frames")) == len(files) + 1
    assert open_store(tmp_path).manifest == before.manifest
    with StoreWriter.open(tmp_path, BODY) as writer:
        assert sorted(os.listdir(tmp_path / "frames")) == files
        assert compact(writer).frames_after == 1
    assert same(before, open_store(tmp_path))
    assert verify(open_store(tmp_path, at="newest")) == []


def test_merges_may_run_anywhere_and_twice(tmp_path: Path) -> None:
    before = in_batches(tmp_path, FANOUT)
    with StoreWriter.open(tmp_path, BODY) as writer:
        compact(writer, spread=lambda function, items: iter([function(item) for item in items for _ in "ab"][::2]))
    assert same(before, open_store(tmp_path))


@pytest.mark.parametrize(
    ("count", "workers", "fits", "worth", "parts"),
    [
        (1, 1, 1, 9, 1), (1, 2, 1, 9, 2), (1, 2, 1, 1, 1), (1, 2, 1, 0, 1), (1, 16, 1, 9, FANOUT // 2),
        (3, 16, 3, 9, 4), (3, 2, 4, 30, 4), (3, 2, 3, 30, 3), (4, 2, 4, 30, 4), (7, 4, 8, 60, 8), (9, 4, 11, 80, 9),
        (9, 1, 11, 80, 9),
    ],
)  # fmt: skip
def test_a_large_merge_is_divided_evenly_and_parts_do_not_get_small(
    count: int, workers: int, fits: int, worth: int, parts: int
) -> None:
    assert part_count(count, workers, fits=fits, worth=worth) == parts


def test_the_workers_share_a_merge_and_its_parts_need_no_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compaction, "MIN_ROWS", 60)
    before = in_batches(tmp_path, FANOUT)
    tasks = []

    def spread(function, items):
        tasks.extend(items)
        return iter([function(item) for item in tasks])

    with StoreWriter.open(tmp_path, BODY) as writer:
        assert compact(writer, spread=spread, workers=2).frames_after == len(tasks) == 2
        assert not compact(writer, spread=spread, workers=2).changed
    after = open_store(tmp_path)
    assert same(before, after)
    assert all(
        compaction._tier(part.rows) > compaction._tier(before.manifest.frames[0].rows) for part in after.manifest.frames
    )
    assert verify(after) == []


def part(rows: int, dropped_rows: int = 0, name: str = "") -> Part:
    take_ids = (1, 2) if dropped_rows else (1,)
    return Part(f"frames/part-{name}", rows, 200 * rows, "", take_ids, take_ids[1:], dropped_rows)


def test_few_parts_and_full_parts_are_left_alone() -> None:
    assert merge_groups([part(100)] * (FANOUT - 1) + [part(1000)] * (FANOUT - 1)) == []
    assert merge_groups([part(1000)] * FANOUT, full_bytes=200_000) == []
    assert [len(group) for group in merge_groups([part(1000)] * FANOUT, full_bytes=200_001)] == [FANOUT]
    assert merge_groups([part(1000, 500)], full_bytes=0) == []
    assert merge_groups([part(1000, 501)], full_bytes=0) == [[part(1000, 501)]]


@settings(max_examples=30)
@given(st.lists(st.integers(1, 2000), min_size=200, max_size=400))
def test_each_row_is_written_again_only_a_few_times_however_it_came_in(batches: list[int]) -> None:
    parts: list[Part] = []
    written = 0
    for number, rows in enumerate(batches):
        parts.append(part(rows, name=str(number)))
        for group in merge_groups(parts):
            merged = sum(old.live_rows for old in group)
            written += merged
            parts = [old for old in parts if old not in group] + [part(merged, name=f"{number}-{merged}")]
    tiers = int(np.log(sum(batches)) / np.log(FANOUT)) + 1
    assert written <= tiers * sum(batches)
    assert len(parts) < FANOUT * tiers


def test_adding_ten_takes_to_many_rewrites_none_of_them(tmp_path: Path) -> None:
    with StoreWriter.open(tmp_path, BODY) as writer:
        add(writer, {f"t{number:05}": 2 for number in range(1000)})
        writer.commit()
        large = writer.manifest.frames
        for session in range(FANOUT):
            add(writer, {f"new{session}_{number}": 2 for number in range(10)})
            writer.commit()
            done = compact(writer)
            assert done.changed == (session == FANOUT - 1)
        assert large[0] in writer.manifest.frames
        assert pq.read_metadata(tmp_path / writer.manifest.frames[1].path).num_rows == 160
    assert replace(large[0], dropped=()) == large[0]
    assert len(versions(tmp_path)) == 1 + 1 + FANOUT + 1
