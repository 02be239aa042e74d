"""The index: what is in it, when it counts, and that publishing it disturbs nobody."""

from __future__ import annotations

import os
from pathlib import Path

import duckdb
import pytest

from ops.errors import StoreError
from ops.words import cut
from storage import index
from storage.index import tables
from storage.lock import Lock
from storage.store import Store, open_store
from storage.writer import StoreWriter
from tests.oracles import runs as naive
from tests.storage.made_up import BODY, add, make_store

TAKES = {"bd_walk": 90, "bk_kick": 40, "dg_still": 1, "mm_empty": 0}


@pytest.fixture
def store(tmp_path: Path) -> Store:
    make_store(tmp_path / "store", TAKES)
    store = open_store(tmp_path / "store")
    index.build(store)
    return store


def change(store: Store, frames: int) -> Store:
    with StoreWriter.open(store.path, BODY) as writer:
        add(writer, {"bd_walk": frames}, edition=frames)
        writer.commit()
    return open_store(store.path)


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
    assert index.build(store) == store.index_path().parent
    assert store.index_path().stat() == before


def test_results_do_not_make_an_index_stale(store: Store) -> None:
    from storage.manifest import StageRecord

    with StoreWriter.open(store.path, BODY) as writer:
        writer.record_stage(StageRecord("p/index", "f", "r", "2026-01-01T00:00:00Z", 1.0))
        assert writer.commit().version == 3
    assert open_store(store.path).index_path() == store.index_path()


def test_a_stale_index_is_not_used(store: Store) -> None:
    later = change(store, 50)
    with pytest.raises(StoreError, match=r"the index is stale: .* run the stage `index`"):
        later.index_path()
    with pytest.raises(StoreError, match="the index is stale"):
        later.sql("FROM word_runs")
    with pytest.raises(StoreError, match="the index is stale"):
        later.sql("FROM runs_where(1)")
    assert later.sql("SELECT count(*) AS n FROM frames").column(0).to_pylist() == [91]
    index.build(later)
    assert open_store(store.path).sql("SELECT sum(frames)::BIGINT AS n FROM takes").column(0).to_pylist() == [91]


def test_a_reader_keeps_its_generation_and_old_ones_go(store: Store) -> None:
    store.sql("FROM vocabulary LIMIT 1")
    before = store.sql("SELECT count(*) AS n FROM word_runs").to_pylist()
    for frames in (10, 20, 30):
        index.build(change(store, frames))
    assert sorted(os.listdir(store.path / "index")) == ["gen-000004", "gen-000005", "lock"]
    assert store.sql("SELECT count(*) AS n FROM word_runs").to_pylist() == before


def test_a_damaged_index_is_built_again(store: Store) -> None:
    file = store.index_path()
    file.write_bytes(file.read_bytes()[:5000])
    with pytest.raises(StoreError, match="the index is"):
        store.index_path()
    assert index.build(store) == file.parent
    assert open_store(store.path).sql("SELECT count(*) AS n FROM takes").to_pylist() == [{"n": 4}]


def test_an_index_that_was_damaged_without_changing_its_size_is_built_again(store: Store) -> None:
    file = store.index_path()
    whole = file.read_bytes()
    file.write_bytes(whole[:-5000] + bytes(5000))
    assert index.build(store) == file.parent
    assert open_store(store.path).sql("SELECT sum(frames)::BIGINT AS n FROM vocabulary").to_pylist() == [{"n": 3 * 131}]


def test_two_builds_at_once_are_kept_apart_and_leftovers_go(store: Store) -> None:
    later = change(store, 5)
    leftover = store.path / "index" / ".building-0"
    leftover.mkdir()
    with Lock(store.path / "index" / "lock", "this"), pytest.raises(StoreError, match="this build must wait"):
        index.build(later)
    index.build(later)
    assert not leftover.exists()


def test_a_store_without_takes_has_an_empty_index(tmp_path: Path) -> None:
    StoreWriter.open(tmp_path, BODY).close()
    store = open_store(tmp_path)
    index.build(store)
    assert store.sql("FROM runs_where('rhand_fast')").num_rows == 0
    assert store.sql("SELECT count(*) AS n FROM frames").to_pylist() == [{"n": 0}]


def test_a_build_without_space_says_so_and_leaves_nothing(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise duckdb.IOException('IO Error: Could not write file "x": No space left on device')

    later = change(store, 5)
    before = sorted(os.listdir(store.path / "index"))
    monkeypatch.setattr(tables, "insert", full)
    with pytest.raises(StoreError, match=r"the index cannot be built: .*No space left on device; .*`kinedex gc`"):
        index.build(later)
    assert sorted(os.listdir(store.path / "index")) == before
