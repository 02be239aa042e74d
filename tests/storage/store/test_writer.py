"""Tests of writing a store: a commit is seen whole or not at all."""

from __future__ import annotations

import gc
import json
import multiprocessing
import os
import signal
import time
import weakref
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from kinedex.ops.errors import KinedexError, ParameterError, StoreError
from kinedex.storage.snapshot.manifest import ResultPart, StageRecord
from kinedex.storage.snapshot.manifest_files import manifest_path, publish, read_newest, versions
from kinedex.storage.store import writer as admission
from kinedex.storage.store.store import open_store
from kinedex.storage.store.verification import verify
from kinedex.storage.store.writer import StoreWriter
from tests import killed_runs
from tests.storage.made_up import BODY, add, arrays, make_store, take_row, takes_table, write_frames


def test_nothing_is_visible_before_the_commit(tmp_path: Path) -> None:
    with StoreWriter.open(tmp_path, BODY) as writer:
        add(writer, {"a": 3})
        assert open_store(tmp_path).takes().height == 0
        writer.commit()
        assert open_store(tmp_path).takes().height == 1
        add(writer, {"b": 3})
    assert open_store(tmp_path).takes()["name"].to_list() == ["a"]


def test_a_commit_without_changes_makes_no_version(tmp_path: Path) -> None:
    with StoreWriter.open(tmp_path, BODY) as writer:
        add(writer, {"a": 3})
        assert writer.commit().version == writer.commit().version == 2
    assert versions(tmp_path) == [1, 2]


def test_a_take_keeps_its_id_when_it_is_ingested_again(tmp_path: Path) -> None:
    make_store(tmp_path, {"b": 5, "d": 4})
    with StoreWriter.open(tmp_path, BODY) as writer:
        assert writer.assign_take_ids(["d", "c", "a", "b"]) == {"b": 1, "d": 2, "a": 3, "c": 4}
        add(writer, {"b": 9}, edition=1)
        writer.commit()
    store = open_store(tmp_path)
    assert store.take_id("b") == 1
    assert store.words([1, 2]).frames.tolist() == [9, 4]
    assert [part.dropped for part in store.manifest.frames] == [(1,), ()]


def test_ids_of_removed_takes_are_never_used_again(tmp_path: Path) -> None:
    make_store(tmp_path, {"a": 5, "b": 4})
    with StoreWriter.open(tmp_path, BODY) as writer:
        writer.drop_takes([2])
        writer.commit()
    with StoreWriter.open(tmp_path, BODY) as writer:
        assert writer.assign_take_ids(["b"]) == {"b": 3}
        with pytest.raises(StoreError, match="no live take has the id 2"):
            writer.drop_takes([2])


def test_the_same_part_again_brings_its_takes_back(tmp_path: Path) -> None:
    make_store(tmp_path, {"a": 5, "b": 4})
    for edition in (1, 0):
        with StoreWriter.open(tmp_path, BODY) as writer:
            add(writer, {"a": 5, "b": 4} if edition == 0 else {"a": 6}, edition=edition)
            writer.commit()
    store = open_store(tmp_path)
    assert len(store.manifest.frames) == len(store.manifest.takes) == 1
    assert store.words().frames.tolist() == [5, 4]


def test_a_part_without_live_takes_leaves_the_manifest_but_not_the_disk(tmp_path: Path) -> None:
    make_store(tmp_path, {"a": 5})
    before = open_store(tmp_path)
    with StoreWriter.open(tmp_path, BODY) as writer:
        add(writer, {"a": 6}, edition=1)
        writer.commit()
    with StoreWriter.open(tmp_path, BODY):
        assert len(open_store(tmp_path).manifest.frames) == 1
        assert before.words().frames.tolist() == [5]


def test_takes_and_frames_must_be_the_same_takes(tmp_path: Path) -> None:
    with StoreWriter.open(tmp_path, BODY) as writer:
        ids = writer.assign_take_ids(["a", "b"])
        part = write_frames(tmp_path, {"a": (ids["a"], 4)})
        with pytest.raises(StoreError, match="must be the same"):
            writer.add_takes(takes_table([take_row(ids["b"], "b", 4)]), part)
        with pytest.raises(StoreError, match="5 frames together, their frames parts 4 rows"):
            writer.add_takes(takes_table([take_row(ids["a"], "a", 5)]), part)
        with pytest.raises(StoreError, match="ids come from assign_take_ids"):
            writer.add_takes(takes_table([take_row(ids["a"], "other", 4)]), part)
        with pytest.raises(StoreError, match="missing column name"):
            writer.add_takes(takes_table([take_row(ids["a"], "a", 4)]).drop_columns("name"), part)
        assert writer.commit().version == 1


def test_a_worker_adds_takes_in_order(tmp_path: Path) -> None:
    with StoreWriter.open(tmp_path, BODY):
        with pytest.raises(ParameterError, match="take_id must be above 3"):
            write_frames_backwards(tmp_path)
        assert os.listdir(tmp_path / "frames") == []


def write_frames_backwards(store: Path) -> None:
    from kinedex.storage.snapshot.parts import FramesWriter

    with FramesWriter(store, BODY) as writer:
        writer.add(3, *arrays("c", 4))
        writer.add(2, *arrays("b", 4))


def test_a_second_writer_is_told_who_holds_the_store(tmp_path: Path) -> None:
    with StoreWriter.open(tmp_path, BODY) as writer:
        with pytest.raises(StoreError, match=f"process {os.getpid()} on "):
            StoreWriter.open(tmp_path, BODY)
        writer.close()
        StoreWriter.open(tmp_path, BODY).close()


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_forked_worker_does_not_keep_the_lock(tmp_path: Path) -> None:
    writer = StoreWriter.open(tmp_path, BODY)
    fork = multiprocessing.get_context("fork")
    running = fork.Event()
    worker = fork.Process(target=_say_and_sleep, args=(running,))
    worker.start()
    try:
        assert running.wait(60)
        writer._lock._file.close()  # as the end of the process does it, without unlocking
        StoreWriter.open(tmp_path, BODY).close()
    finally:
        worker.kill()
        worker.join()


def _say_and_sleep(running) -> None:
    running.set()
    time.sleep(30)


def test_a_version_is_never_overwritten(tmp_path: Path) -> None:
    make_store(tmp_path, {"a": 5})
    before = manifest_path(tmp_path, 2).read_bytes()
    with StoreWriter.open(tmp_path, BODY) as writer:
        add(writer, {"b": 3})
        publish(tmp_path, replace(read_newest(tmp_path), version=3))
        with pytest.raises(StoreError, match="another writer"):
            writer.commit()
    assert manifest_path(tmp_path, 2).read_bytes() == before


def test_what_killed_runs_left_is_removed_and_nothing_else(tmp_path: Path) -> None:
    make_store(tmp_path, {"a": 5})
    old = open_store(tmp_path)
    with StoreWriter.open(tmp_path, BODY) as writer:
        add(writer, {"a": 6}, edition=1)
        writer.commit()
    orphan = tmp_path / write_frames(tmp_path, {"x": (90, 12)}).path
    unfinished = tmp_path / "frames" / ".tmp-0.parquet"
    unfinished.touch()
    mine = tmp_path / "frames" / "notes.txt"
    mine.touch()
    StoreWriter.open(tmp_path, BODY).close()
    assert not orphan.exists()
    assert not unfinished.exists()
    assert mine.exists()
    assert old.words().frames.tolist() == [5]


def test_replaced_parts_are_not_looked_up_in_old_manifests_at_every_opening(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_store(tmp_path, {"a": 5})
    with StoreWriter.open(tmp_path, BODY) as writer:
        for edition in range(1, 5):
            add(writer, {"a": 5 + edition}, edition=edition)
            writer.commit()
    for part in tmp_path.glob("*/part-*"):
        os.utime(part, (1_000_000_000, 1_000_000_000))
    looked_up: list[int] = []
    monkeypatch.setattr(admission, "named_files", lambda _, version: looked_up.append(version) or set())
    before = sorted(tmp_path.glob("frames/part-*"))
    StoreWriter.open(tmp_path, BODY).close()
    assert looked_up == []
    assert sorted(tmp_path.glob("frames/part-*")) == before
    assert len(before) == 5


def test_another_feature_set_or_rate_is_refused(tmp_path: Path) -> None:

    make_store(tmp_path, {"a": 5})
    with pytest.raises(StoreError, match="ingest into a new store"):
        StoreWriter.open(tmp_path, replace(BODY, digest="other"))
    with pytest.raises(StoreError, match="30 Hz, not 60 Hz"):
        StoreWriter.open(tmp_path, BODY, rate_hz=60)


def test_a_directory_of_other_things_is_not_made_a_store(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(StoreError, match="thesis"):
        StoreWriter.open(tmp_path, BODY)


HITS = {"query": "kick", "take_id": 1, "take": "a", "start": 0, "stop": 3, "start_seconds": 0.0, "stop_seconds": 0.1}


def hits(*starts: int) -> pa.Table:
    from kinedex.storage.snapshot.schemas import result_schema

    schema = result_schema("hits")
    return pa.Table.from_pylist([HITS | {"start": s} for s in starts], schema=schema.remove(0))


def test_results_of_a_stage_replace_its_earlier_ones_only(tmp_path: Path) -> None:
    make_store(tmp_path, {"a": 5})
    with StoreWriter.open(tmp_path, BODY) as writer:
        writer.put_results("hits", hits(1, 2), stage="one/search", run="r1")
        writer.put_results("hits", hits(3), stage="two/search", run="r2")
        writer.commit()
        writer.put_results("hits", hits(4), stage="one/search", run="r3")
        writer.commit()
    store = open_store(tmp_path)
    assert store.result("hits").select(["run", "start"]).to_pylist() == [
        {"run": "r2", "start": 3},
        {"run": "r3", "start": 4},
    ]
    assert store.result("hits", run="r3").num_rows == store.result("hits", pipeline="two").num_rows == 1
    assert store.result("hits", run="r1").num_rows == 0
    assert store.result("metrics").column_names[:4] == ["run", "evaluation", "scope", "name"]


def test_results_that_come_piece_by_piece_are_one_part_and_never_in_memory_at_once(tmp_path: Path) -> None:
    make_store(tmp_path, {"a": 5})
    alive: list[weakref.ref[pa.Table]] = []
    gc.collect()
    gc.freeze()  # or else every collection goes through all that the test process holds

    def pieces() -> Iterator[pa.Table]:
        for start in range(9):
            gc.collect()
            assert sum(one() is not None for one in alive) <= 1
            table = hits(*range(start, start + start % 3))
            alive.append(weakref.ref(table))
            yield table

    with StoreWriter.open(tmp_path, BODY) as writer:
        writer.put_results("hits", pieces(), stage="p/search", run="r1")
        writer.commit()
        found = open_store(tmp_path)
        assert len(found.manifest.results["hits"]) == 1
        assert found.result("hits").column("start").to_pylist() == [
            start for first in range(9) for start in range(first, first + first % 3)
        ]
        assert found.sql("SELECT count(*) AS n FROM hits").to_pylist() == [{"n": 9}]
        writer.put_results("hits", iter([hits()]), stage="p/search", run="r2")
        writer.commit()
    assert open_store(tmp_path).result("hits").num_rows == 0


def test_results_that_are_long_are_several_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_store(tmp_path, {"a": 5})
    monkeypatch.setattr("kinedex.storage.snapshot.parts.FULL_BYTES", 20_000)
    random = np.random.default_rng(7)
    starts = [random.integers(0, 1 << 30, 1000).tolist() for _ in range(12)]
    with StoreWriter.open(tmp_path, BODY) as writer:
        writer.put_results("hits", (hits(*some) for some in starts), stage="p/search", run="r1")
        writer.commit()
    store = open_store(tmp_path)
    parts = store.manifest.results["hits"]
    assert 1 < len(parts) < 12
    assert all(part.bytes >= 20_000 for part in parts[:-1])
    assert sum(part.rows for part in parts) == 12_000
    assert store.result("hits").column("start").to_pylist() == [start for some in starts for start in some]
    assert verify(store) == []


def test_long_results_that_break_off_show_nothing_and_the_next_writer_removes_their_parts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_store(tmp_path, {"a": 5})
    monkeypatch.setattr("kinedex.storage.snapshot.parts.FULL_BYTES", 1)

    def pieces(stays: ResultPart, *starts: int) -> Iterator[pa.Table | ResultPart]:
        yield stays
        yield from map(hits, starts)
        raise KinedexError("a worker failed")

    with StoreWriter.open(tmp_path, BODY) as writer:
        writer.put_results("hits", hits(1), stage="p/search", run="r1")
        writer.commit()
        (first,) = writer.manifest.results["hits"]
        with pytest.raises(KinedexError, match="a worker failed"):
            writer.put_results("hits", pieces(first, 2, 3), stage="p/search", run="r2")
        assert writer.commit().version == 3
    store = open_store(tmp_path)
    assert store.result("hits").column("start").to_pylist() == [1]
    found = verify(store)
    assert len(found) == 2
    assert not any(one.fault for one in found)
    StoreWriter.open(tmp_path, BODY).close()
    assert verify(store) == []
    assert [path.name for path in (tmp_path / "results/hits").iterdir()] == [Path(first.path).name]


def test_parts_of_earlier_results_may_stay(tmp_path: Path) -> None:
    make_store(tmp_path, {"a": 5})
    with StoreWriter.open(tmp_path, BODY) as writer:
        writer.put_results("hits", hits(1, 2), stage="one/search", run="r1")
        writer.put_results("hits", hits(3), stage="two/search", run="r2")
        writer.commit()
        first, other = writer.manifest.results["hits"]
        writer.put_results("hits", [first, hits(4)], stage="one/search", run="r3")
        writer.commit()
        found = open_store(tmp_path)
        assert found.result("hits", stage="one/search").column("start").to_pylist() == [1, 2, 4]
        assert [part.run for part in found.manifest.results["hits"]] == ["r1", "r2", "r3"]
        writer.put_results("hits", [hits(0), first, hits(5)], stage="one/search", run="r4")
        writer.commit()
        assert open_store(tmp_path).result("hits", stage="one/search").column("start").to_pylist() == [0, 1, 2, 5]
        writer.put_results("hits", [first], stage="one/search", run="r5")
        writer.commit()
        with pytest.raises(StoreError, match="is no part of the results hits of one/search"):
            writer.put_results("hits", [other, hits(5)], stage="one/search", run="r6")
    store = open_store(tmp_path)
    assert store.result("hits").column("start").to_pylist() == [1, 2, 3]
    assert verify(store) == []


def test_pieces_that_fail_leave_no_file(tmp_path: Path) -> None:
    make_store(tmp_path, {"a": 5})

    def pieces() -> Iterator[pa.Table]:
        yield hits(1)
        raise KinedexError("a worker failed")

    with StoreWriter.open(tmp_path, BODY) as writer:
        with pytest.raises(KinedexError, match="a worker failed"):
            writer.put_results("hits", pieces(), stage="p/search", run="r1")
        with pytest.raises(StoreError, match="missing column take"):
            writer.put_results("hits", iter([hits(1), hits(2).drop_columns("take")]), stage="p/s", run="r")
        assert list((tmp_path / "results").rglob("*.parquet")) == []
        assert writer.commit().version == 2


def test_empty_results_remove_the_earlier_ones(tmp_path: Path) -> None:
    make_store(tmp_path, {"a": 5})
    with StoreWriter.open(tmp_path, BODY) as writer:
        writer.put_results("hits", hits(1, 2), stage="one/search", run="r1")
        writer.put_results("hits", hits(), stage="one/search", run="r2")
        writer.commit()
    assert open_store(tmp_path).result("hits").num_rows == 0


def test_wrong_results_are_refused(tmp_path: Path) -> None:
    with StoreWriter.open(tmp_path, BODY) as writer:
        with pytest.raises(KinedexError, match="did you mean 'hits'"):
            writer.put_results("hit", hits(1), stage="p/s", run="r")
        with pytest.raises(StoreError, match="missing column take"):
            writer.put_results("hits", hits(1).drop_columns("take"), stage="p/s", run="r")
        with pytest.raises(StoreError, match="column start must be int32"):
            writer.put_results("hits", hits(1).set_column(4, "start", pa.array(["soon"])), stage="p/s", run="r")
        with pytest.raises(ParameterError, match="run must be r2"):
            writer.put_results("hits", hits(1).append_column("run", pa.array(["r1"])), stage="p/s", run="r2")


def test_a_stage_record_is_kept(tmp_path: Path) -> None:
    record = StageRecord("annotate/index", "f1", "r1", "2026-01-01T00:00:00Z", 1.5, {"runs": 12, "sets": ["upper"]})
    with StoreWriter.open(tmp_path, BODY) as writer:
        writer.record_stage(record)
        writer.commit()
    assert open_store(tmp_path).manifest.stages == {"annotate/index": record}


def bring_in(path: Path, opened: Any) -> None:
    """An ingest of forty takes, three a commit; sends a word once the store is open."""
    names = {f"take_{i:03d}": 20 + i for i in range(40)}
    with StoreWriter.open(path, BODY) as writer:
        opened.send("open")
        have = set(writer.store.takes()["name"].to_list())
        todo = [name for name in names if name not in have]
        for i in range(0, len(todo), 3):
            add(writer, {name: names[name] for name in todo[i : i + 3]})
            writer.commit()


@pytest.mark.slow
def test_killed_at_any_moment_and_run_again_it_ends_with_exactly_its_takes(tmp_path: Path) -> None:
    store = tmp_path / "store"
    rng = np.random.default_rng(3)
    kills = 0
    for attempt in range(60):
        here, there = killed_runs.channel()
        process = killed_runs.start(bring_in, store, there)
        here.recv()
        if attempt < 6:
            time.sleep(rng.uniform(0, 0.12))
            process.kill()
        process.join()
        kills += process.exitcode == -signal.SIGKILL
        visible = open_store(store)
        words = visible.words()
        assert visible.takes().height == len(words)
        if process.exitcode == 0:
            break
        assert process.exitcode == -signal.SIGKILL
    assert kills >= 2
    final = open_store(store)
    assert final.takes()["name"].to_list() == [f"take_{i:03d}" for i in range(40)]
    assert final.takes()["frames"].to_list() == [20 + i for i in range(40)]
    for name in ("take_000", "take_039"):
        expected = arrays(name, 20 + int(name[-3:]))[2]
        np.testing.assert_array_equal(final.frames(name).column("word").to_numpy(), expected)
    StoreWriter.open(store, BODY).close()
    named = {part.path for v in versions(store) for part in json_parts(store, v)}
    there = {f"{folder}/{name}" for folder in ("frames", "takes") for name in os.listdir(store / folder)}
    assert there == named
    assert verify(final) == []


def json_parts(store: Path, version: int):
    from kinedex.storage.snapshot.manifest_files import read_version

    assert json.loads(manifest_path(store, version).read_text())["version"] == version
    return read_version(store, version).parts
