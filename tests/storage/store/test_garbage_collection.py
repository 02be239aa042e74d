"""Garbage collection: what goes, what stays, and that a version that stays can be read whole."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from kinedex.ops.errors import ParameterError, StoreError
from kinedex.storage.durable_files import write_flushed
from kinedex.storage.index.builder import build_index
from kinedex.storage.lock import Lock
from kinedex.storage.snapshot.manifest_files import manifest_path, named_files, read_version, versions
from kinedex.storage.store import garbage_collection as garbage
from kinedex.storage.store import history
from kinedex.storage.store.compaction import FANOUT, compact
from kinedex.storage.store.garbage_collection import CollectedGarbage, collect_garbage, shown_bytes, summary
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.verification import verify
from kinedex.storage.store.writer import StoreWriter
from tests.storage.made_up import BODY, add, make_store, write_frames
from tests.storage.store.test_writer import hits


@pytest.fixture
def store(tmp_path: Path) -> Store:
    """Nine versions, two generations of the index, and a compaction."""
    path = make_store(tmp_path / "store", {"first": 30})
    with StoreWriter.open(path, BODY) as writer:
        for batch in range(FANOUT - 1):
            add(writer, {f"t{batch}": 30})
            writer.put_results("hits", hits(batch), stage="p/search", run=f"r{batch}")
            writer.commit()
            if batch == 0:
                build_index(writer.store)
        compact(writer)
    build_index(open_store(path, at="newest"))
    return open_store(path, at="newest")


def files(path: Path) -> set[str]:
    return {file.relative_to(path).as_posix() for file in path.rglob("*") if file.is_file()}


def test_what_only_old_versions_need_goes_and_the_rest_reads_as_before(store: Store) -> None:
    before = files(store.path)
    previous = Store(store.path, read_version(store.path, 9))
    found = collect_garbage(store.path).removed
    assert versions(store.path) == [9, 10]
    assert before - files(store.path) >= {item.path for item in found if item.kind != "index generation"}
    assert verify(store) == []
    assert store.words().frames.tolist() == previous.words().frames.tolist() == [30] * FANOUT
    assert store.sql("SELECT count(*)::BIGINT AS n FROM hits").column(0).to_pylist() == [1]
    assert [item.kind for item in found].count("old version") == 8
    assert not any(item.kind in ("frames part", "takes part") for item in found)
    assert sorted(os.listdir(store.path / "results/hits")) == [Path(store.manifest.results["hits"][0].path).name]
    assert collect_garbage(store.path) == CollectedGarbage([], [])
    assert summary([]) == ["nothing: there is no garbage"]


def test_the_newest_version_alone_needs_only_its_own_parts(store: Store) -> None:
    collect_garbage(store.path, keep=1)
    assert versions(store.path) == [10]
    parts = {file for file in files(store.path) if file.startswith(("frames/", "takes/", "results/"))}
    assert parts == named_files(store.path, 10)
    assert store.index_path().is_file()
    assert sorted(os.listdir(store.path / "index")) == [store.index_path().parent.name, "lock"]
    assert verify(store) == []


def test_a_dry_run_says_the_same_and_removes_nothing(store: Store) -> None:
    before = files(store.path)
    message = collect_garbage(store.path, keep=1, dry_run=True).removed
    assert files(store.path) == before
    assert collect_garbage(store.path, keep=1).removed == message
    assert sum(item.bytes for item in message if item.kind == "old version") > 0
    assert summary(message)[0].startswith("9 old versions, ")


def test_what_kinedex_has_not_made_is_not_touched(store: Store) -> None:
    mine = {"notes.txt", "frames/notes.txt", "results/reports/p/report.html", "index/mine.duckdb"}
    for name in mine:
        (store.path / name).parent.mkdir(parents=True, exist_ok=True)
        (store.path / name).touch()
    collect_garbage(store.path, keep=1)
    assert files(store.path) >= mine | {"lock"}


def test_leftovers_of_killed_runs_and_a_stale_index_go(store: Store) -> None:
    orphan = write_frames(store.path, {"x": (90, 12)})
    (store.path / "takes/.tmp-1.parquet").touch()
    (store.path / "index/.building-1").mkdir()
    (store.path / "index/.building-1/index.duckdb").write_bytes(b"1" * 100)
    found = {item.path: item for item in collect_garbage(store.path, keep=100).removed}
    assert found[orphan.path].kind == "frames part"
    assert found["index/.building-1"].bytes == 100
    assert found["takes/.tmp-1.parquet"].kind == "unfinished file"
    assert not files(store.path) & {orphan.path, "takes/.tmp-1.parquet", "index/.building-1/index.duckdb"}


UNFINISHED = (
    "frames/.tmp-1", "labels/.tmp-1", "manifest/.tmp-1", "history/.tmp-1", "history/files/.tmp-1", ".tmp-1",
    ".tmp-1.wal", "jobs/.tmp-1", "quarantine/q/.tmp-quarantine.json", "results/reports/p/.tmp-1", "results/hits/.tmp-1",
)  # fmt: skip


def test_an_unfinished_file_is_noted_and_removed_wherever_it_lies(store: Store) -> None:
    collect_garbage(store.path)
    for name in UNFINISHED:
        (store.path / name).parent.mkdir(parents=True, exist_ok=True)
        (store.path / name).write_bytes(b"unfinished")
    noted = {found.file for found in verify(store) if found.kind == "leftover" and not found.fault}
    assert noted >= set(UNFINISHED)
    assert {(item.path, item.bytes, item.kind) for item in collect_garbage(store.path).removed} == {
        (name, 10, "unfinished file") for name in UNFINISHED
    }
    assert collect_garbage(store.path).removed == []
    assert not files(store.path).intersection(UNFINISHED)


def test_a_run_that_is_written_while_garbage_is_collected_is_in_the_history(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    collections = []

    def collected(path: Path, content: bytes) -> None:
        write_flushed(path, content)
        if not collections:
            collections.append(collect_garbage(store.path))

    monkeypatch.setattr(history, "write_flushed", collected)
    history.write_run(store.path, history.PipelineRun("20260101-000000-abcdef", "p", begun="2026"))
    assert any(item.path.startswith("history/.tmp-") for item in collections[0].removed)
    assert [run.run for run in history.list_runs(store.path)][-1] == "20260101-000000-abcdef"
    assert list((store.path / "history").iterdir()) == [store.path / "history" / "20260101-000000-abcdef.json"]


def test_garbage_is_not_collected_while_anybody_writes(store: Store) -> None:
    with StoreWriter.open(store.path, BODY), pytest.raises(StoreError, match="is being written by process"):
        collect_garbage(store.path)
    with Lock(store.path / "index" / "lock", "this"), pytest.raises(StoreError, match="garbage collection must wait"):
        collect_garbage(store.path)


def test_what_a_damaged_version_needs_is_not_guessed(store: Store) -> None:
    manifest_path(store.path, 9).write_text("{")
    before = files(store.path)
    with pytest.raises(StoreError, match=r"000009\.json: the manifest is damaged"):
        collect_garbage(store.path)
    assert files(store.path) == before
    collect_garbage(store.path, keep=1)
    assert versions(store.path) == [10]


def test_killed_on_the_way_it_leaves_a_sound_store(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    class Killed(BaseException):
        pass

    for limit in (1, 5, 9, 11):
        left = limit

        def remove(path: Path, really=garbage._remove) -> None:
            nonlocal left
            left -= 1
            if left < 0:
                raise Killed
            really(path)

        monkeypatch.setattr(garbage, "_remove", remove)
        with pytest.raises(Killed):
            collect_garbage(store.path, keep=1)
        assert not any(finding.fault for finding in verify(store))
        for version in versions(store.path):
            assert Store(store.path, read_version(store.path, version)).words().frames.sum() > 0
        monkeypatch.undo()
    collect_garbage(store.path, keep=1)
    assert verify(store) == []


def test_at_least_one_version_stays_and_only_stores_are_cleaned(tmp_path: Path, store: Store) -> None:
    with pytest.raises(ParameterError, match="keep must be at least 1"):
        collect_garbage(store.path, keep=0)
    with pytest.raises(StoreError, match="does not exist"):
        collect_garbage(tmp_path / "none")


def test_bytes_are_told_in_units_for_people() -> None:
    assert [shown_bytes(n) for n in (0, 999, 1000, 1_250_000, 3 * 10**9)] == [
        "0 bytes", "999 bytes", "1.0 kB", "1.2 MB", "3.0 GB",
    ]  # fmt: skip
