"""Every documented view and macro: its example runs, and its answer is that of a plain Python computation."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from kinedex.catalog.sql.views import MACROS, VIEWS
from kinedex.ops.errors import KinedexError
from kinedex.storage.index.builder import build_index
from kinedex.storage.snapshot.schemas import RESULT_KINDS
from kinedex.storage.store.store import Store, open_store
from tests.oracles import runs as naive
from tests.storage.made_up import BODY, arrays, make_store

TAKES = {"a_dance": 360, "b_dance": 75, "c_empty": 0}
NAMES = sorted(TAKES)
RUNS = naive.feature_runs([arrays(name, TAKES[name])[2].tolist() for name in NAMES], 40)
"""(feature, take, start, stop) of everything."""


def runs_of(feature: int) -> list[tuple[str, int, int]]:
    return [(NAMES[take], start, stop) for number, take, start, stop in RUNS if number == feature]


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    path = make_store(tmp_path_factory.mktemp("views") / "store", TAKES)
    build_index(open_store(path, at="newest"))
    return open_store(path)


def rows(store: Store, query: str) -> list[tuple[object, ...]]:
    table = store.sql(query)
    return [tuple(row.values()) for row in table.to_pylist()]


@pytest.mark.parametrize("macro", MACROS, ids=lambda macro: macro.name)
def test_the_example_of_a_macro_runs(store: Store, macro) -> None:
    assert f"{macro.name}(" in macro.example
    assert store.sql(macro.example).num_columns > 0


@pytest.mark.parametrize("view", VIEWS, ids=lambda view: view.name)
def test_a_view_stands_and_has_its_columns(store: Store, view) -> None:
    found = store.sql(f"DESCRIBE {view.name}").to_pylist()
    expected = [
        (name, column.type)
        for column in view.columns
        for name in (BODY.joints if column.name == "JOINT" else [column.name])
    ]
    assert [(row["column_name"], row["column_type"]) for row in found] == expected
    assert all(column.meaning for column in view.columns)


def test_every_kind_of_result_has_a_view_that_is_described() -> None:
    described = {view.name for view in VIEWS if view.origin == "results"}
    assert described == set(RESULT_KINDS)


def test_help_lists_what_there_is(store: Store) -> None:
    listed = [row[0] for row in rows(store, "SELECT name FROM help")]
    assert listed == [view.name for view in VIEWS] + [macro.name for macro in MACROS]
    for example in rows(store, "SELECT example FROM help"):
        store.sql(str(example[0]))


def test_has_reads_a_whole_word(store: Store) -> None:
    for feature in (3, "'rhand_above_neck'", "'F3'"):
        found = store.sql(f"SELECT count(*) AS n FROM frames WHERE has(word, {feature})").column(0)[0].as_py()
        assert found == sum(stop - start for _, start, stop in runs_of(3))
    assert rows(store, "SELECT has(1::UBIGINT << 39, 40), has(1::UBIGINT << 39, 39)") == [(True, False)]


def test_features_of_names_the_bits_of_a_set_word(store: Store) -> None:
    assert rows(store, "SELECT features_of('lower', 5), features_of('upper', 0)") == [
        (["rfoot_behind", "rfoot_raised"], [])
    ]


def test_runs_where_keeps_runs_that_last(store: Store) -> None:
    expected = [(take, start, stop) for take, start, stop in runs_of(7) if (stop - start) / 30 >= 0.2]
    assert 0 < len(expected) < len(runs_of(7))
    found = rows(store, "SELECT take, start, stop FROM runs_where('relbow_bent', min_seconds := 0.2)")
    assert found == expected
    assert len(rows(store, "FROM runs_where(7)")) == len(runs_of(7))


def test_together_is_where_both_are_on(store: Store) -> None:
    expected = []
    for take, a, b in runs_of(3):
        for other, c, d in runs_of(4):
            if take == other and max(a, c) < min(b, d):
                expected.append((take, max(a, c), min(b, d), pytest.approx((min(b, d) - max(a, c)) / 30)))
    assert expected
    found = rows(store, "SELECT take, start, stop, seconds FROM together(3, 'lhand_above_neck')")
    assert found == sorted(expected, key=lambda row: row[:2])


def test_followed_by_is_the_next_within_the_gap(store: Store) -> None:
    expected = [
        (take, a, b, c, d)
        for take, a, b in runs_of(20)
        for other, c, d in runs_of(25)
        if take == other and 0 <= (c - b) / 30 <= 0.5
    ]
    assert expected
    query = "SELECT take, start, a_stop, b_start, stop FROM followed_by('rknee_bent', 'rfoot_fast', 0.5)"
    assert rows(store, query) == sorted(expected)


def test_a_timeline_is_all_runs_of_one_take_by_start(store: Store) -> None:
    expected = sorted((start, feature, stop) for feature, take, start, stop in RUNS if NAMES[take] == "b_dance")
    assert rows(store, "SELECT start, feature, stop FROM timeline('b_dance')") == expected
    name = BODY.features[expected[0][1] - 1].name
    assert rows(store, "SELECT name FROM timeline('b_dance') LIMIT 1") == [(name,)]


def test_the_rarest_words_come_first(store: Store) -> None:
    counts: dict[int, int] = {}
    for name in NAMES:
        for word in arrays(name, TAKES[name])[2].tolist():
            word = word >> 14 & 0xFFF
            counts[word] = counts.get(word, 0) + 1
    found = rows(store, "SELECT word, frames FROM rarest_words('lower', n := 7)")
    assert [frames for _, frames in found] == sorted(counts.values())[:7]
    assert all(counts[word] == frames for word, frames in found)


def test_cooccurrence_counts_frames_where_both_are_on(store: Store) -> None:
    words = [word for name in NAMES for word in arrays(name, TAKES[name])[2].tolist()]
    own = sum(word >> 12 & 1 for word in words)
    found = {row[0]: row[1:] for row in rows(store, "FROM cooccurrence('rhand_fast')")}
    assert sorted(found) == [number for number in range(1, 41) if number != 13]
    for number, (name, frames, seconds, share) in found.items():
        both = sum(word >> 12 & word >> (number - 1) & 1 for word in words)
        assert (name, frames) == (BODY.features[number - 1].name, both)
        assert (seconds, share) == (pytest.approx(both / 30), pytest.approx(both / own))


def test_frames_between_is_a_stretch_of_a_take(store: Store) -> None:
    words = arrays("b_dance", 75)[2].tolist()
    assert [row[0] for row in rows(store, "SELECT word FROM frames_between('b_dance', 10, 20)")] == words[10:20]
    assert [row[0] for row in rows(store, "SELECT word FROM frames_between('b_dance', 70)")] == words[70:]
    assert rows(store, "SELECT word FROM frames_between('c_empty')") == []


@pytest.mark.parametrize(
    "query",
    [
        "FROM runs_where('rhand')",
        "FROM together(3, 41)",
        "SELECT has(1::UBIGINT, 'F0')",
        "FROM timeline('nobody')",
        "FROM frames_between('nobody')",
        "FROM rarest_words('uper')",
        "FROM pose('rhand_fast, not rhand')",
        "FROM pose('')",
        "FROM pattern(['rhand_fast', 'nothing'])",
        "FROM frames_around('nobody', 1, 2)",
        "SELECT features_of('uper', 3::UBIGINT)",
    ],
)
def test_a_macro_refuses_what_does_not_exist(store: Store, query: str) -> None:
    with pytest.raises(KinedexError, match=r"the view (features|takes) lists them"):
        store.sql(query)


@pytest.mark.parametrize(
    ("query", "near"),
    [
        ("FROM runs_where('rhand_abov_neck')", "no feature rhand_abov_neck (did you mean 'rhand_above_neck'?)"),
        ("FROM pattern(['lkne_bent', 'not rknee_bent'])", "no feature lkne_bent (did you mean 'lknee_bent'?)"),
        ("FROM timeline('b_dace')", "no take is named b_dace (did you mean 'b_dance'?)"),
        ("FROM rarest_words('uper')", "no feature set uper (did you mean 'upper'?)"),
        ("FROM runs_where('zzz')", "no feature zzz; the view features lists them"),
        ("FROM runs_where(NULL)", "no feature NULL; the view features lists them"),
    ],
)
def test_a_misspelt_name_is_answered_with_the_nearest(store: Store, query: str, near: str) -> None:
    with pytest.raises(KinedexError, match=re.escape(near)):
        store.sql(query)


def test_macros_over_frames_stand_without_an_index(tmp_path: Path) -> None:
    store = open_store(make_store(tmp_path, TAKES))
    assert len(rows(store, "SELECT has(word, 3), root.x FROM frames_between('b_dance', 10, 20)")) == 10
    assert rows(store, "SELECT count(*) FROM takes JOIN features ON true") == [(120,)]
