"""Shards: whatever the history of a store and however many there are, the index is that of its words."""

from __future__ import annotations

import random
import shutil
from pathlib import Path

import pytest

from kinedex.catalog.sql.views import MACROS
from kinedex.storage.index import index_views
from kinedex.storage.index.builder import build_index
from kinedex.storage.index.generations import Generation, read_generation
from kinedex.storage.index.shard_plan import FANOUT
from kinedex.storage.store.compaction import compact
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.verification import verify
from kinedex.storage.store.writer import StoreWriter
from tests.oracles import index_tables
from tests.storage.made_up import BODY, add, make_store

SETS = {name: (home.first, home.count) for name, home in BODY.sets.items()}
FEW = 50
"""A shard of so few frames is full in these tests."""


def says(store: Store) -> Generation:
    found = read_generation(store.index_path().parent)
    assert found is not None
    return found


def rows(store: Store, query: str) -> list[tuple[object, ...]]:
    found = store.sql(query)
    return list(zip(*(column.to_pylist() for column in found.columns), strict=True))


def is_that_of_the_words(store: Store) -> None:
    words = store.words()
    takes = {int(take): words.take(i).tolist() for i, take in enumerate(words.take_ids)}
    for view, expected in index_tables.tables(takes, SETS, 40, 30.0).items():
        assert sorted(rows(store, f"FROM {view}")) == expected, view
    assert verify(store) == []


def change(store: Path, takes: dict[str, int], drop: tuple[str, ...] = (), edition: int = 0) -> Store:
    with StoreWriter.open(store, BODY) as writer:
        if takes:
            add(writer, takes, edition)
        writer.drop_takes(writer.assign_take_ids(drop).values())
        writer.commit()
    return open_store(store, at="newest")


@pytest.fixture(scope="module")
def batches(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = make_store(tmp_path_factory.mktemp("shards"), {"0_walk": 70, "0_kick": 30, "0_none": 0})
    for batch in range(1, 6):
        change(path, {f"{batch}_walk": 20 * batch, f"{batch}_kick": 35})
    change(path, {"2_walk": 33}, drop=("3_kick",), edition=1)
    return path


@pytest.fixture
def stores(batches: Path, tmp_path: Path) -> dict[str, Store]:
    """The same store with one shard, and with a shard for every part or two."""
    found = {}
    for name, shard_frames in (("one", 10**9), ("many", FEW)):
        shutil.copytree(batches, tmp_path / name)
        found[name] = open_store(tmp_path / name, at="newest")
        build_index(found[name], threads=2, shard_frames=shard_frames)
    return found


class Bar:
    """A progress bar that keeps what it was told."""

    def __init__(self) -> None:
        self.steps = list[tuple[str, int]]()
        self.advanced = list[int]()

    def __call__(self, description: str, steps: int) -> Bar:
        self.steps.append((description, steps))
        return self

    def __enter__(self) -> Bar:
        return self

    def __exit__(self, *_: object) -> None: ...

    def advance(self, n: int = 1) -> None:
        self.advanced.append(n)


@pytest.mark.parametrize("threads", [1, 2])
def test_a_build_shows_how_many_of_the_new_frames_are_stored(batches: Path, tmp_path: Path, threads: int) -> None:
    shutil.copytree(batches, tmp_path / "store")
    store, bar = open_store(tmp_path / "store", at="newest"), Bar()
    build_index(store, threads=threads, shard_frames=FEW, progress=bar)
    assert bar.steps == [("frames", says(store).built_frames)]
    assert len(bar.advanced) == len(says(store).shards) > 1
    assert sum(bar.advanced) == says(store).built_frames


def test_answers_are_the_same_for_one_shard_and_for_many(stores: dict[str, Store]) -> None:
    assert len(says(stores["one"]).shards) == 1
    assert len(says(stores["many"]).shards) >= 5
    for store in stores.values():
        is_that_of_the_words(store)
    for view in ("takes", "features", "help", "vocabulary", "word_runs", "feature_runs"):
        one, many = (rows(store, f"SELECT * EXCLUDE warnings FROM {view}" if view == "takes" else f"FROM {view}")
                     for store in stores.values())  # fmt: skip
        assert sorted(one, key=str) == sorted(many, key=str), view
    for macro in MACROS:
        one, many = (rows(store, macro.example) for store in stores.values())
        if "ORDER BY" not in macro.body.rsplit(")", 1)[-1]:
            one, many = sorted(one, key=str), sorted(many, key=str)
        assert one == many, macro.name


def test_one_shard_is_sorted_as_the_views_say(stores: dict[str, Store]) -> None:
    for view in ("word_runs", "feature_runs", "vocabulary"):
        found = rows(stores["one"], f"FROM {view}")
        assert found == sorted(found), view


def test_new_takes_cost_the_work_of_new_takes(stores: dict[str, Store]) -> None:
    for store in stores.values():
        before = says(store)
        later = change(store.path, {"new_1": 5, "new_2": 6})
        build_index(later)
        after = says(later)
        assert after.built_frames == 11
        assert after.shards[:-1] == before.shards
        is_that_of_the_words(later)


def test_a_take_that_is_replaced_or_dropped_leaves_its_shard(stores: dict[str, Store]) -> None:
    later = change(stores["one"].path, {"5_kick": 44}, drop=("0_kick", "1_walk"), edition=2)
    build_index(later)
    assert says(later).built_frames == 44
    assert rows(later, "SELECT count(*) FROM word_runs JOIN takes USING (take_id) WHERE name = '1_walk'") == [(0,)]
    is_that_of_the_words(later)


def test_a_shard_that_has_lost_half_of_its_frames_is_made_anew(stores: dict[str, Store]) -> None:
    before = says(stores["one"]).frames
    gone = tuple(rows(stores["one"], "SELECT list(name) FROM takes WHERE frames >= 60 OR name = '0_kick'")[0][0])
    later = change(stores["one"].path, {}, drop=gone)
    build_index(later)
    after = says(later)
    assert after.frames < before / 2
    assert after.built_frames == after.frames
    assert len(after.shards) == 1
    is_that_of_the_words(later)


@pytest.mark.parametrize("seed", range(2))
def test_an_index_follows_any_history_of_a_store(tmp_path: Path, seed: int) -> None:
    chance = random.Random(seed)
    store = open_store(make_store(tmp_path, {"first": 40}), at="newest")
    names = ["first"]
    for step in range(9):
        what = chance.choice(["add", "add", "replace", "drop", "compact", "damage"])
        if what == "add" or not names:
            new = {f"{step}_{i}": chance.randrange(60) for i in range(chance.randint(1, 3))}
            names += new
            store = change(tmp_path, new)
        elif what == "replace":
            chosen = chance.sample(names, min(len(names), 2))
            store = change(tmp_path, {name: chance.randrange(60) for name in chosen}, edition=step)
        elif what == "drop":
            gone = tuple(chance.sample(names, min(len(names), chance.randint(1, 3))))
            names = [name for name in names if name not in gone]
            store = change(tmp_path, {}, drop=gone)
        elif what == "compact":
            with StoreWriter.open(tmp_path, BODY) as writer:
                compact(writer)
            store = open_store(tmp_path, at="newest")
        elif (tmp_path / "index").exists():
            for file in (tmp_path / "index").glob("gen-*/index.duckdb"):
                file.write_bytes(file.read_bytes()[:-1] + b"?")
        build_index(store, threads=1, shard_frames=chance.choice([FEW, 500]))
        is_that_of_the_words(store)
        store.close()


def test_many_small_additions_leave_few_shards(tmp_path: Path) -> None:
    store = open_store(make_store(tmp_path, {"first": 40}), at="newest")
    build_index(store, threads=1)
    for step in range(FANOUT + 1):
        store = change(tmp_path, {f"take_{step}": 9})
        build_index(store, threads=1)
        assert len(says(store).shards) < FANOUT
    is_that_of_the_words(store)


def test_views_and_macros_that_are_out_of_date_are_made_anew_and_the_rows_stay(
    stores: dict[str, Store], monkeypatch: pytest.MonkeyPatch
) -> None:
    store = stores["many"]
    before = says(store)
    monkeypatch.setattr(index_views, "MACROS", index_views.MACROS[2:])
    build_index(store)
    after = says(store)
    assert after.surface != before.surface
    assert after.built_frames == 0
    is_that_of_the_words(open_store(store.path, at="newest"))
