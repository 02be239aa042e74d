"""The index: what is in it, when it counts, and that publishing it disturbs nobody."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import duckdb
import numpy as np
import pytest
import xxhash

from kinedex.ops.errors import StoreError
from kinedex.ops.words import NO_WORD, cut
from kinedex.storage.index import builder, generations
from kinedex.storage.index.builder import build_index
from kinedex.storage.index.generations import KEPT, current_generation, read_generation
from kinedex.storage.lock import Lock
from kinedex.storage.snapshot.parts import FramesWriter
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.verification import verify
from kinedex.storage.store.writer import StoreWriter
from tests.oracles import runs as naive
from tests.storage.made_up import BODY, add, arrays, make_store, take_row, takes_table

ROOT = Path(__file__).parents[2]

TAKES = {"bd_walk": 90, "bk_kick": 40, "dg_still": 1, "mm_empty": 0}


@pytest.fixture
def store(tmp_path: Path) -> Store:
    make_store(tmp_path / "store", TAKES)
    store = open_store(tmp_path / "store")
    build_index(store)
    return store


def change(store: Store, frames: int) -> Store:
    with StoreWriter.open(store.path, BODY) as writer:
        add(writer, {"bd_walk": frames}, edition=frames)
        writer.commit()
    return open_store(store.path, at="newest")


@pytest.mark.parametrize("name", ["upper", "lower", "mix"])
def test_word_runs_are_those_of_the_words_sorted_by_word(store: Store, name: str) -> None:
    words = store.words()
    home = BODY.sets[name]
    takes = [cut(words.take(i), home.first, home.count).tolist() for i in range(len(words))]
    expected = sorted(
        (word, int(words.take_ids[take]), start, stop) for take, start, stop, word in naive.word_runs(takes)
    )
    found = store.sql("SELECT word, take_id, start, stop FROM word_runs WHERE feature_set = ?", [name])
    assert list(zip(*(column.to_pylist() for column in found.columns), strict=True)) == expected


def test_feature_runs_come_with_their_seconds(store: Store) -> None:
    words = store.words()
    takes = [words.take(i).tolist() for i in range(len(words))]
    expected = [
        (feature, int(words.take_ids[take]), start, stop, (stop - start) / 30)
        for feature, take, start, stop in naive.feature_runs(takes, 40)
    ]
    found = store.sql("FROM feature_runs")
    assert list(zip(*(column.to_pylist() for column in found.columns), strict=True)) == expected


def test_the_vocabulary_counts_runs_and_frames(store: Store) -> None:
    found = store.sql(
        "SELECT feature_set, sum(frames)::BIGINT AS frames, sum(runs)::BIGINT AS runs FROM vocabulary GROUP BY 1"
    )
    runs = store.sql("SELECT feature_set, count(*) AS runs FROM word_runs GROUP BY 1").to_pylist()
    assert {row["feature_set"]: row["frames"] for row in found.to_pylist()} == dict.fromkeys(BODY.sets, 131)
    assert {r["feature_set"]: r["runs"] for r in found.to_pylist()} == {r["feature_set"]: r["runs"] for r in runs}


def test_features_know_their_bit(store: Store) -> None:
    found = store.sql("SELECT feature_set, bit, name FROM features WHERE number = 15").to_pylist()
    assert found == [{"feature_set": "lower", "bit": 0, "name": "rfoot_behind"}]


def test_any_duckdb_client_can_read_the_file(store: Store) -> None:
    with duckdb.connect(str(store.index_path()), read_only=True) as plain:
        assert plain.execute("SELECT count(*) FROM takes").fetchall() == [(4,)]
        seen = plain.execute("SELECT count(*) FROM runs_where('rhand_above_neck', min_seconds := 0.1)").fetchall()
        version = plain.execute("SELECT tags['storage_version'] FROM duckdb_databases() WHERE NOT internal").fetchall()
    expected = store.sql("SELECT count(*) AS n FROM runs_where(3, min_seconds := 0.1)").column(0).to_pylist()
    assert [row[0] for row in seen] == expected
    assert all("v2" not in str(row[0]) for row in version)


def test_an_index_is_built_once(store: Store) -> None:
    before = store.index_path().stat()
    assert build_index(store) == store.index_path().parent
    assert store.index_path().stat() == before


def test_results_do_not_make_an_index_stale(store: Store) -> None:
    from kinedex.storage.snapshot.manifest import StageRecord

    with StoreWriter.open(store.path, BODY) as writer:
        writer.record_stage(StageRecord("p/index", "f", "r", "2026-01-01T00:00:00Z", 1.0))
        assert writer.commit().version == 3
    assert open_store(store.path, at="newest").index_path() == store.index_path()


def test_a_stale_index_is_not_used(store: Store) -> None:
    later = change(store, 50)
    with pytest.raises(StoreError, match=r"the index is stale: .* `kinedex repair .*` builds it again"):
        later.index_path()
    with pytest.raises(StoreError, match="the index is stale"):
        later.sql("FROM word_runs")
    with pytest.raises(StoreError, match="the index is stale"):
        later.sql("FROM runs_where(1)")
    assert later.sql("SELECT count(*) AS n FROM frames").column(0).to_pylist() == [91]
    build_index(later)
    assert open_store(store.path, at="newest").sql("SELECT sum(frames)::BIGINT AS n FROM takes").column(
        0
    ).to_pylist() == [91]


def test_a_reader_finds_the_generation_of_its_version_until_it_is_closed(store: Store) -> None:
    lazy = open_store(store.path, at="newest")
    for frames in range(10, 13):
        build_index(change(store, frames))
    assert lazy.sql("SELECT sum(frames)::BIGINT AS n FROM takes").to_pylist() == [{"n": 131}]
    assert lazy.sql("SELECT count(*) AS n FROM word_runs") == store.sql("SELECT count(*) AS n FROM word_runs")
    later = open_store(store.path, at="newest")
    for frames in range(13, 13 + KEPT):
        build_index(change(store, frames))
    assert len(list((store.path / "index").glob("gen-*"))) == KEPT + 2
    assert later.sql("SELECT sum(frames)::BIGINT AS n FROM vocabulary").num_rows
    later.close()
    newest = build_index(change(store, 50))
    assert len(list((store.path / "index").glob("gen-*"))) == KEPT + 1
    told = (
        rf"version {later.manifest.version}, which is open here, has no index; the newest version that has one is "
        rf"{int(newest.name[4:])}: open the store again"
    )
    with pytest.raises(StoreError, match=told):
        later.index_path()
    with pytest.raises(StoreError, match=told):
        later.sql("FROM word_runs")
    with later.connect(threads=1) as connection:
        for query in ("SELECT take_id FROM word_runs", "SELECT count(*) FROM vocabulary", "FROM runs_where(1)"):
            with pytest.raises(duckdb.Error, match=told):
                connection.execute(query).fetchall()
        assert connection.execute("SELECT count(*) FROM takes").fetchall() == [(4,)]


def test_an_index_that_is_published_after_the_first_question_is_found(tmp_path: Path) -> None:
    store = open_store(make_store(tmp_path / "store", {"a": 40}), at="newest")
    with pytest.raises(StoreError, match="the index is missing"):
        store.sql("FROM word_runs")
    build_index(store)
    assert store.sql("FROM word_runs").num_rows


def test_there_is_always_an_index_while_one_of_the_same_version_is_replaced(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = []
    rename, removed = os.rename, shutil.rmtree

    def look(function: Callable[..., None]) -> Callable[..., None]:
        def looking(*args: object, **kwargs: object) -> None:
            seen.append(current_generation(store.path, store.manifest))
            function(*args, **kwargs)
            seen.append(current_generation(store.path, store.manifest))

        return looking

    monkeypatch.setattr(builder, "index_surface", lambda *_: "other macros")
    monkeypatch.setattr(os, "rename", look(rename))
    monkeypatch.setattr(shutil, "rmtree", look(removed))
    generation = build_index(store)
    assert len(seen) >= 6
    assert None not in seen
    assert seen[-1] == generation
    assert sorted(os.listdir(store.path / "index")) == [generation.name, "lock"]


def test_a_reader_that_has_listed_what_is_replaced_looks_again(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    listed = generations.generations
    moved = store.index_path().parent

    def replaced(path: Path) -> list[Path]:
        found = listed(path)
        if moved.exists():
            moved.rename(moved.with_name(f"{moved.name}-2"))
        return found

    monkeypatch.setattr(generations, "generations", replaced)
    assert current_generation(store.path, store.manifest) == moved.with_name(f"{moved.name}-2")


def test_a_reader_keeps_its_generation_and_old_ones_go(store: Store) -> None:
    store.sql("FROM vocabulary LIMIT 1")
    before = store.sql("SELECT count(*) AS n FROM word_runs").to_pylist()
    for frames in range(10, 11 + KEPT):
        build_index(change(store, frames))
    kept = [f"gen-{version:06d}" for version in range(4, 4 + KEPT)]
    assert sorted(os.listdir(store.path / "index")) == ["gen-000002", *kept, "lock"]
    assert store.sql("SELECT count(*) AS n FROM word_runs").to_pylist() == before


def test_a_damaged_index_is_built_again(store: Store) -> None:
    file = store.index_path()
    file.write_bytes(file.read_bytes()[:5000])
    with pytest.raises(StoreError, match="the index is"):
        store.index_path()
    assert build_index(store) == file.parent.with_name("gen-000002-2")
    assert not file.exists()
    assert open_store(store.path, at="newest").sql("SELECT count(*) AS n FROM takes").to_pylist() == [{"n": 4}]


def test_an_index_that_was_damaged_without_changing_its_size_is_built_again(store: Store) -> None:
    file = store.index_path()
    whole = file.read_bytes()
    file.write_bytes(whole[:-5000] + bytes(255 - byte for byte in whole[-5000:]))
    assert build_index(store) == file.parent.with_name("gen-000002-2")
    assert open_store(store.path, at="newest").sql("SELECT sum(frames)::BIGINT AS n FROM vocabulary").to_pylist() == [
        {"n": 3 * 131}
    ]


def test_two_builds_at_once_are_kept_apart_and_leftovers_go(store: Store) -> None:
    later = change(store, 5)
    leftover = store.path / "index" / ".building-0"
    leftover.mkdir()
    with Lock(store.path / "index" / "lock", "this"), pytest.raises(StoreError, match="this build must wait"):
        build_index(later)
    build_index(later)
    assert not leftover.exists()


def test_a_store_without_takes_has_an_empty_index(tmp_path: Path) -> None:
    StoreWriter.open(tmp_path, BODY).close()
    store = open_store(tmp_path, at="newest")
    build_index(store)
    assert store.sql("FROM runs_where('rhand_fast')").num_rows == 0
    assert store.sql("SELECT count(*) AS n FROM frames").to_pylist() == [{"n": 0}]


def test_a_build_without_space_says_so_and_leaves_nothing(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise duckdb.IOException('IO Error: Could not write file "x": No space left on device')

    later = change(store, 5)
    before = sorted(os.listdir(store.path / "index"))
    monkeypatch.setattr(builder.index_tables, "insert", full)
    with pytest.raises(StoreError, match=r"the index cannot be built: .*No space left on device; .*`kinedex gc`"):
        build_index(later)
    assert sorted(os.listdir(store.path / "index")) == before


def test_a_killed_build_leaves_nothing_visible_and_the_next_cleans_up(store: Store) -> None:
    later = change(store, 5)
    before = sorted(os.listdir(store.path / "index"))
    killed = subprocess.run([sys.executable, "-c", KILLED, str(store.path)], cwd=ROOT, timeout=240)
    assert killed.returncode == -signal.SIGKILL
    left = sorted(set(os.listdir(store.path / "index")) - set(before))
    assert [name[:10] for name in left] == [".building-"]
    assert store.sql("SELECT sum(frames)::BIGINT AS n FROM takes").to_pylist() == [{"n": 131}]
    with pytest.raises(StoreError, match="the index is stale"):
        later.index_path()
    build_index(later)
    assert sorted(os.listdir(store.path / "index")) == ["gen-000002", "gen-000003", "lock"]


KILLED = """
import os, signal, sys
from kinedex.storage.index.builder import build_index
from kinedex.storage.index.generations import current_generation, read_generation
from kinedex.storage.index import index_tables
from kinedex.storage.store.store import open_store
index_tables.count = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
build_index(open_store(sys.argv[1], at="newest"))
"""


@pytest.mark.parametrize("room", [10_000, 200_000, 600_000])
def test_a_disk_that_fills_is_a_clear_error_and_leaves_the_generation_before(store: Store, room: int) -> None:
    later = change(store, 60_000)
    before = sorted(os.listdir(store.path / "index"))
    done = subprocess.run(
        [sys.executable, "-c", FULL, str(store.path), str(room)], cwd=ROOT, capture_output=True, text=True, timeout=240
    )
    assert "way out" in done.stdout, done.stdout + done.stderr
    assert sorted(os.listdir(store.path / "index")) == before
    assert store.sql("SELECT sum(frames)::BIGINT AS n FROM takes").to_pylist() == [{"n": 131}]
    build_index(later)
    assert later.sql("SELECT sum(frames)::BIGINT AS n FROM takes").to_pylist() == [{"n": 60_041}]


FULL = """
import resource, signal, sys
from kinedex.ops.errors import StoreError
from kinedex.storage.index.builder import build_index
from kinedex.storage.index.generations import current_generation, read_generation
from kinedex.storage.store.store import open_store
store = open_store(sys.argv[1], at="newest")
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), int(sys.argv[2])))
try:
    build_index(store, threads=1)
except StoreError as fault:
    print("way out" if "kinedex gc" in str(fault) or "mend that" in str(fault) else "", fault)
"""


def test_invalid_frames_are_in_no_run_and_count_as_frames(tmp_path: Path) -> None:
    with StoreWriter.open(tmp_path, BODY) as writer:
        ids = writer.assign_take_ids(["gaps", "nothing"])
        with FramesWriter(tmp_path, BODY) as part:
            for name, words in (("gaps", [5, 5, NO_WORD, 5, NO_WORD, NO_WORD, 7]), ("nothing", [NO_WORD] * 3)):
                positions, orientation, _ = arrays(name, len(words))
                part.add(ids[name], positions, orientation, np.array(words, np.uint64))
            done = part.close()
        rows = [take_row(ids[name], name, frames) for name, frames in (("gaps", 7), ("nothing", 3))]
        writer.add_takes(takes_table(rows), done)
        writer.commit()
    store = open_store(tmp_path, at="newest")
    build_index(store)
    runs = store.sql("SELECT word, take_id, start, stop FROM word_runs WHERE feature_set = 'upper'").to_pylist()
    assert [(run["word"], run["start"], run["stop"]) for run in runs] == [(5, 0, 2), (5, 3, 4), (7, 6, 7)]
    assert store.sql("SELECT start, stop FROM feature_runs WHERE feature = 1").to_pylist() == [
        {"start": 0, "stop": 2}, {"start": 3, "stop": 4}, {"start": 6, "stop": 7}
    ]  # fmt: skip
    assert store.sql("SELECT sum(frames)::BIGINT AS n FROM vocabulary GROUP BY feature_set").column(0).to_pylist() == [
        4, 4, 4
    ]  # fmt: skip
    assert store.sql("SELECT count(*) AS n, count(word) AS w FROM frames").to_pylist() == [{"n": 10, "w": 4}]
    assert store.sql("SELECT count(*) AS n FROM frames WHERE has(word, 1)").to_pylist() == [{"n": 4}]
    assert store.sql("SELECT count(*) AS n FROM frames_between('gaps', 2, 4) WHERE word IS NULL").to_pylist() == [
        {"n": 1}
    ]
    assert store.words().words.tolist().count(int(NO_WORD)) == 6
    says = read_generation(store.index_path().parent)
    assert says is not None
    assert (says.frames, says.valid_frames) == (10, 4)
    assert verify(store) == []


def test_a_shard_with_wrong_rows_is_found_though_its_checksum_fits(store: Store) -> None:
    generation = store.index_path().parent
    with duckdb.connect(str(generation / "index.duckdb")) as client:
        client.execute("DELETE FROM stored_word_runs_lower WHERE rowid = 1")
        client.execute("UPDATE stored_vocabulary SET shard = 9 WHERE feature_set = 'mix'")
        client.execute("UPDATE stored_word_runs_upper SET take_id = 77 WHERE rowid = 0")
    says = read_generation(generation)
    assert says is not None
    content = (generation / "index.duckdb").read_bytes()
    said = replace(says, bytes=len(content), xxh3=xxhash.xxh3_128(content).hexdigest())
    (generation / "generation.json").write_text(said.to_json())
    found = "\n".join(map(str, verify(store)))
    assert "word_runs has" in found
    assert "the lists of lower in shard 1 are not those that its vocabulary counts" in found
    assert "mix has rows of a shard 9 that is none" in found
    assert "upper has rows of takes that are in no shard" in found
    assert "`kinedex repair" in found
