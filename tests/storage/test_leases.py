"""Leases: what a reader has open stays, in every process that has it, and goes once the reader is gone."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import pytest

from kinedex.ops.errors import ParameterError, StoreError
from kinedex.storage import leases
from kinedex.storage.index import builder, generations
from kinedex.storage.index.builder import build_index
from kinedex.storage.index.generations import current_generation
from kinedex.storage.leases import OpenVersion, open_versions, take_lease
from kinedex.storage.snapshot import manifest_files
from kinedex.storage.snapshot.manifest_files import manifest_path, versions
from kinedex.storage.store.garbage_collection import collect_garbage
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.writer import StoreWriter
from tests.killed_runs import channel, start
from tests.storage.made_up import BODY, add, make_store
from tests.storage.store.test_writer import hits

SECONDS = 60.0
"""Every answer of another process comes within this time."""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A store whose version 2 has three takes, a result and an index."""
    with StoreWriter.open(tmp_path / "store", BODY) as writer:
        add(writer, {"a": 20, "b": 30, "c": 40})
        writer.put_results("hits", hits(1, 2), stage="p/search", run="r")
        writer.commit()
    build_index(open_store(tmp_path / "store", at="newest"), threads=1)
    return tmp_path / "store"


def replaced(path: Path, times: int, *, indexed: bool = True) -> None:
    """Replace all takes and results so many times."""
    for edition in range(times):
        with StoreWriter.open(path, BODY) as writer:
            add(writer, {"a": 20 + edition, "b": 30, "c": 40}, edition=edition + 1)
            writer.put_results("hits", hits(edition), stage="p/search", run=f"r{edition}")
            writer.commit()
        if indexed:
            build_index(open_store(path, at="newest"), threads=1)


def everything(store: Store) -> dict[str, object]:
    """Read what only files of this version can answer."""
    from kinedex.pipelines.keyframes.slice_search import sliced_store

    numbers = "SELECT (SELECT count(*) FROM frames), (SELECT count(*) FROM hits), (SELECT sum(frames) FROM vocabulary)"
    return {
        "takes": store.takes()["name"].to_list(),
        "words": store.words().words.tolist(),
        "frames": store.frames("c").num_rows,
        "hits": store.result("hits").num_rows,
        "sql": store.sql(numbers).to_pylist(),
        "slices": sliced_store(store).take_ids.tolist(),
    }


def reader(pipe: Connection, path: Path, at: int | None = None) -> None:
    """Open a store, and read all of it whenever asked to."""
    store = open_store(path, at=at)
    pipe.send(store.manifest.version)
    while pipe.recv() == "read":
        pipe.send(everything(Store(store.path, store.manifest)))


@contextmanager
def reading(path: Path) -> Iterator[tuple[Any, Connection]]:
    """Run a reader in a process of its own, which has the store open."""
    ours, theirs = channel()
    process = start(reader, theirs, path)
    theirs.close()
    try:
        assert ours.poll(SECONDS)
        assert ours.recv() == 2
        yield process, ours
    finally:
        process.kill()
        process.join()


def test_collection_and_builds_keep_all_that_a_reader_has_open(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(builder, "KEPT", 2)
    with open_store(path) as store:
        before = everything(store)
    with reading(path) as (process, pipe):
        replaced(path, 4)
        found = collect_garbage(path, keep=1)
        assert versions(path) == [2, 6]
        count = 1 if sys.platform == "linux" else None
        assert found.open_versions == [OpenVersion(2, count)]
        assert str(OpenVersion(2, 1)) == "version 2 is open in 1 process"
        pipe.send("read")
        assert pipe.poll(SECONDS)
        assert pipe.recv() == before
        os.kill(process.pid, signal.SIGKILL)
        process.join(SECONDS)
    assert collect_garbage(path, keep=1).open_versions == []
    assert versions(path) == [6]
    with open_store(path) as store:
        assert everything(store)["hits"] == 1


def test_a_store_lets_go_of_its_version_when_it_is_closed_or_forgotten(path: Path) -> None:
    one, other = open_store(path), open_store(path)
    assert [found.version for found in open_versions(path)] == [2]
    one.close()
    assert [found.version for found in open_versions(path)] == [2]
    del other
    assert open_versions(path) == []
    assert one.sql("SELECT count(*) AS n FROM frames").to_pylist() == [{"n": 90}]
    assert [found.version for found in open_versions(path)] == [2]
    one.close()
    replaced(path, 1)
    collect_garbage(path, keep=1)
    with pytest.raises(StoreError, match="version 2 has been removed; open the store again"):
        one.sql("SELECT count(*) FROM frames")


def test_a_connection_keeps_the_version_after_its_store_is_forgotten(path: Path) -> None:
    connection = open_store(path).connect(threads=1)
    assert [found.version for found in open_versions(path)] == [2]
    connection.close()
    del connection
    assert open_versions(path) == []


def test_a_store_that_is_sent_to_another_process_is_leased_there_too(path: Path) -> None:
    store = open_store(path)
    copy = pickle.loads(pickle.dumps(store))
    store.close()
    assert [found.version for found in open_versions(path)] == [2]
    assert copy.words().frames.tolist() == [20, 30, 40]
    copy.close()
    sent = pickle.dumps(store)
    replaced(path, 1)
    collect_garbage(path, keep=1)
    with pytest.raises(StoreError, match="version 2 has been removed"):
        pickle.loads(sent)


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
def test_a_forked_process_keeps_the_version_that_its_parent_closes(path: Path) -> None:
    store = open_store(path)
    ours, theirs = channel()
    child = multiprocessing.get_context("fork").Process(target=theirs.recv)
    child.start()
    try:
        store.close()
        assert [found.version for found in open_versions(path)] == [2]
        child.kill()
        child.join(SECONDS)
        assert open_versions(path) == []
    finally:
        child.kill()
        ours.close()


def test_to_open_and_read_a_store_writes_nothing(path: Path) -> None:
    before = {file: file.stat().st_mtime_ns for file in path.rglob("*")}
    with open_store(path) as store:
        everything(store)
        assert {file: file.stat().st_mtime_ns for file in path.rglob("*")} == before


def test_without_locks_versions_are_read_and_collected_by_number(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_locks(*_: object, **__: object) -> bool:
        raise OSError(38, "Function not implemented")

    replaced(path, 2)
    store = open_store(path, at=2)
    monkeypatch.setattr(leases.fcntl, "flock", no_locks)
    monkeypatch.setattr("filelock.lock_descriptor", no_locks)
    assert everything(open_store(path))["hits"] == 1
    assert open_versions(path) == []
    assert store.manifest.version == 2


def test_a_version_that_is_being_removed_is_waited_for_but_not_forever(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(leases, "_SECONDS", 0.1)
    with leases.without_readers(path, 2) as free:
        assert free
        with pytest.raises(StoreError, match=r"000002\.json: another process has kept this file locked"):
            take_lease(path, 2)
    assert take_lease(path, 2) is not None
    assert take_lease(path, 7) is None


def test_a_manifest_that_is_removed_while_it_is_opened_is_no_lease(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    share = leases._share

    def late(descriptor: int) -> bool:
        manifest_path(path, 2).unlink(missing_ok=True)
        return share(descriptor)

    monkeypatch.setattr(leases, "_share", late)
    assert take_lease(path, 2) is None


def test_a_version_that_is_opened_while_garbage_is_collected_stays(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from kinedex.storage.store import garbage_collection

    replaced(path, 3)
    late: list[Store] = []

    def unneeded(root: Path, gone: Any) -> Any:
        if not late:
            late.append(open_store(root, at=3))
        return really(root, gone)

    really = garbage_collection._unneeded
    monkeypatch.setattr(garbage_collection, "_unneeded", unneeded)
    found = collect_garbage(path, keep=1)
    assert [one.version for one in found.open_versions] == [3]
    assert versions(path) == [3, 5]
    assert everything(late[0])["frames"] == 40


# ---- the version that readers get ---------------------------------------------------------------------------


def test_readers_get_the_newest_version_with_its_index_unless_they_ask_for_another(path: Path) -> None:
    replaced(path, 2, indexed=False)
    store = open_store(path)
    assert (store.manifest.version, store.newest_version) == (2, 4)
    assert everything(store)["hits"] == 2
    newest = open_store(path, at="newest")
    assert (newest.manifest.version, newest.newest_version) == (4, 4)
    with pytest.raises(StoreError, match="the index is stale"):
        newest.index_path()
    third = open_store(path, at=3)
    assert (third.manifest.version, third.newest_version) == (3, 4)
    with pytest.raises(StoreError, match=r"version 3, .* has no index; the newest version that has one is 2: open"):
        third.sql("SELECT count(*) FROM word_runs")
    build_index(newest, threads=1)
    assert open_store(path).manifest.version == 4
    with pytest.raises(StoreError, match=r"it has no version 9 .*; it has 4 versions from 1 to 4"):
        open_store(path, at=9)
    with pytest.raises(ParameterError, match='at must be the number of a version, or "newest", got'):
        open_store(path, at="last")  # type: ignore[arg-type]


def test_results_and_layout_are_shown_as_they_are_newest_while_takes_change(path: Path) -> None:
    with StoreWriter.open(path, BODY) as writer:
        for number in range(3):
            writer.put_results("hits", hits(*range(number)), stage="p/search", run=f"n{number}")
            writer.commit()
        add(writer, {"d": 50})
        writer.commit()
    store = open_store(path)
    assert store.manifest.version == 5
    assert store.result("hits").num_rows == 2


def test_a_store_whose_index_was_never_built_is_shown_as_it_is(tmp_path: Path) -> None:
    path = make_store(tmp_path / "store", {"a": 20})
    replaced(path, 2, indexed=False)
    store = open_store(path)
    assert store.manifest.version == store.newest_version == 4
    with pytest.raises(StoreError, match="the index is missing"):
        store.sql("SELECT count(*) FROM word_runs")


def test_few_manifests_are_read_however_many_versions_there_are(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with StoreWriter.open(path, BODY) as writer:
        for number in range(25):
            writer.put_results("hits", hits(number), stage="p/search", run=f"n{number}")
            writer.commit()
        for number in range(25):
            add(writer, {f"d{number}": 5})
            writer.commit()
    read = []
    content = manifest_files._content
    monkeypatch.setattr(manifest_files, "_content", lambda file: read.append(file) or content(file))
    assert open_store(path).manifest.version == 27
    assert len(read) <= 10
    read.clear()
    assert open_store(path, at="newest").manifest.version == 52
    assert len(read) == 1


def test_the_version_that_readers_get_is_not_collected(path: Path) -> None:
    replaced(path, 4, indexed=False)
    collect_garbage(path, keep=1)
    assert versions(path) == [2, 6]
    store = open_store(path)
    assert store.manifest.version == 2
    assert current_generation(path, store.manifest) is not None
    assert generations.generations(path)


def test_versions_stay_while_they_are_young_or_few(path: Path) -> None:
    replaced(path, 3)
    assert collect_garbage(path, keep=1, older_than_seconds=3600).removed == []
    assert collect_garbage(path, keep=9, older_than_seconds=0.0).removed == []
    for version in (1, 2, 3):
        file = manifest_path(path, version)
        file.write_text("{")  # the time of a damaged version is that of its file
        os.utime(file, (0, 0))
    assert [one.path for one in collect_garbage(path, keep=1, older_than_seconds=3600).removed][:3] == [
        f"manifest/00000{version}.json" for version in (1, 2, 3)
    ]
    assert versions(path) == [4, 5]
