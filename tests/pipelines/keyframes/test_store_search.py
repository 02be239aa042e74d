"""Searching takes with keyframe queries: through the index, in memory, with margins for a template."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.queries.keyframe_query import KeyframeQuery, choose_queries
from kinedex.catalog.queries.query_reader import parse_queries, read_queries
from kinedex.ops.errors import KinedexError, StoreError
from kinedex.ops.ranges import TakeRanges
from kinedex.ops.search.inverted_lists import InvertedLists, inverted_lists
from kinedex.ops.search.keyframe_search import keyframe_list, search_lists
from kinedex.ops.words import U64, TakeWords, pack
from kinedex.pipelines.keyframes.preselected_frames import preselect, preselect_stored, template_ranges, template_window
from kinedex.pipelines.keyframes.search_explanation import explain_search, explain_store, read_lists
from kinedex.pipelines.keyframes.slice_search import sliced_store, sliced_words
from kinedex.pipelines.keyframes.store_search import load_query_file, save_hits, search_store
from kinedex.storage.index.builder import build_index
from kinedex.storage.snapshot.parts import FramesWriter
from kinedex.storage.snapshot.schemas import result_schema
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.writer import StoreWriter
from tests.ops.search.divided import ranges_by_take
from tests.oracles.keyframes import ranges_by_sets
from tests.storage.made_up import take_row, takes_table

BODY = load_feature_set("body40")
QUERIES = parse_queries(
    """
squat:
  class: squat1Reps
  keyframes: [{off: [rknee_bent]}, {on: [rknee_bent, body_low]}, {off: [rknee_bent]}]
  gaps: [{range: [1, 3]}, {range: [1, 3]}]
hand_up:
  keyframes: [{on: [rhand_above_neck]}]
""",
    BODY,
)


def motion(**features: str) -> U64:
    """The words of a take in which each named feature is on where its line has an x."""
    frames = len(next(iter(features.values())))
    matrix = np.zeros((frames, 40), np.uint8)
    for name, line in features.items():
        matrix[:, BODY.feature(name).number - 1] = [letter == "x" for letter in line]
    return pack(matrix)


TAKES = {
    "zoe": motion(rknee_bent="..xxx..", body_low="...x...", rhand_above_neck=".xx...x"),
    "amy": motion(rknee_bent="xxxx...", body_low="xxxx...", rhand_above_neck="......."),
    "kim": motion(rknee_bent=".x..xx.", body_low=".x...x.", rhand_above_neck="......x"),
}


def make_store(path: Path, takes: dict[str, U64], *, indexed: bool = True) -> Store:
    with StoreWriter.open(path, BODY) as writer:
        ids = writer.assign_take_ids(takes)
        with FramesWriter(path, BODY) as frames:
            for name, words in sorted(takes.items(), key=lambda item: ids[item[0]]):
                nowhere = np.zeros((len(BODY.joints), 3, len(words)))
                frames.add(ids[name], nowhere, np.zeros((4, len(words))), words)
            part = frames.close()
        writer.add_takes(takes_table([take_row(ids[name], name, len(words)) for name, words in takes.items()]), part)
        writer.commit()
    store = open_store(path)
    if indexed:
        build_index(store, threads=1)
    return store


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    return make_store(tmp_path_factory.mktemp("search") / "store", TAKES)


def test_hits_come_by_query_then_by_take_and_start(store: Store) -> None:
    hits = search_store(store, QUERIES, run="r1")
    assert hits.schema == result_schema("hits")
    rows = [(row["query"], row["take"], row["start"], row["stop"]) for row in hits.to_pylist()]
    assert rows == [
        ("squat", "kim", 0, 7),
        ("squat", "zoe", 0, 7),
        ("hand_up", "kim", 6, 7),
        ("hand_up", "zoe", 1, 3),
        ("hand_up", "zoe", 6, 7),
    ]
    assert hits.column("run").unique().to_pylist() == ["r1"]
    zoe = hits.to_pylist()[-1]
    assert zoe["take_id"] == store.take_id("zoe")
    assert (zoe["start_seconds"], zoe["stop_seconds"]) == (0.2, 7 / 30)


def test_only_the_takes_of_the_filter_are_searched(store: Store) -> None:
    hits = search_store(store, QUERIES, "name = 'kim'")
    assert hits.column("take").to_pylist() == ["kim", "kim"]
    assert search_store(store, QUERIES, "frames > 100").num_rows == 0
    with pytest.raises(KinedexError, match="columns of takes"):
        search_store(store, QUERIES, "person = 'kim'")


def test_a_search_explains_what_its_keyframes_found(store: Store) -> None:
    squat, hand_up = explain_store(store, QUERIES)
    # a keyframe over two sets is two keyframes on the same frame
    assert [keyframe.set for keyframe in squat.keyframes] == ["lower", "lower", "mix", "lower"]
    assert squat.keyframes[1].pattern == "*****1******"
    assert [keyframe.frames for keyframe in squat.keyframes] == [11, 10, 7, 11]
    assert squat.keyframes[2].surviving == 6
    assert squat.keyframes[0].surviving == 5
    assert (squat.ranges, squat.takes, squat.frames_kept, squat.frames_searched) == (2, 2, 14, 21)
    assert (hand_up.keyframes[0].words, hand_up.keyframes[0].runs, hand_up.keyframes[0].segments) == (1, 3, 3)


def test_an_explanation_has_a_row_for_each_step_keyframe_search_and_hits(store: Store) -> None:
    table = explain_search(store, choose_queries(QUERIES, ["hand_up"]))
    timed = [row["milliseconds"] for row in table.to_pylist()]
    assert all(spent >= 0 for spent in timed[:-1])
    assert timed[-1] is None
    nothing = dict.fromkeys(table.drop_columns(["milliseconds"]).column_names)
    pattern = "**1***********"
    first = {"query": "hand_up", "step": "1", "set": "upper", "pattern": pattern, "words": 1, "runs": 3}
    first["features"] = "rhand_above_neck"
    assert table.drop_columns(["milliseconds"]).to_pylist() == [
        nothing | {"step": "takes"},
        nothing | {"step": "open"},
        nothing | {"step": "lists"},
        nothing | first | {"segments": 3, "frames": 4, "share": 4 / 21, "surviving": 4},
        nothing | {"query": "hand_up", "step": "search"},
        nothing | {"query": "hand_up", "step": "hits", "segments": 3, "frames": 4, "share": 4 / 21},
    ]
    assert explain_search(store, QUERIES, "frames > 100").num_rows == 12
    assert explain_search(store, []).num_rows == 0


def steps(store: Store, text: str) -> list[tuple[str, str | None, int | None]]:
    """The rows of an explanation that belong to queries: step, name, frames."""
    rows = explain_search(store, parse_queries(text, BODY)).to_pylist()
    return [(row["step"], row["name"], row["frames"]) for row in rows if row["query"]]


def test_alternatives_and_names_show_in_the_explanation(store: Store) -> None:
    text = "q: {any_of: [{keyframes: [{name: down, on: [body_low]}]}, {keyframes: [{on: [rhand_above_neck]}]}]}"
    assert steps(store, text) == [("1.1", "down", 7), ("2.1", None, 4), ("search", None, None), ("hits", None, 11)]


def test_keyframes_are_explained_by_the_names_of_their_features(store: Store) -> None:
    text = "q: {keyframes: [{on: [rhand_above_neck], off: [lhand_above_neck, rhand_forwards]}]}"
    (message,) = (row["features"] for row in explain_search(store, parse_queries(text, BODY)).to_pylist() if row["set"])
    assert message == "rhand_above_neck, not rhand_forwards, not lhand_above_neck"


def test_keyframes_are_numbered_as_written(store: Store) -> None:
    text = """q: {keyframes: [{on: [1]}, {after: same frame, on: [rknee_bent, body_low]}, {after: any time, on: [1]}]}
p: {keyframes: [{on: [1]}, {after: same frame, on: [rknee_bent]}]}"""
    named = [step for step, _, _ in steps(store, text)]
    assert named == ["1", "2a", "2b", "3", "search", "hits", "1", "2", "search", "hits"]


def test_an_explanation_counts_only_the_takes_that_a_querys_own_filter_leaves(store: Store) -> None:
    text = """own: {takes: "name = 'kim'", any_of: [both]}
both: {keyframes: [{off: [rhand_above_neck]}, {after: within 1 s, on: [rhand_above_neck]}]}
none: {takes: "frames > 100", any_of: [both]}"""
    own, both, none = queries = parse_queries(text, BODY)
    (filtered,) = explain_store(store, [both], "name = 'kim'")
    found = explain_store(store, queries)
    assert found[0].keyframes == tuple(
        replace(keyframe, milliseconds=mine.milliseconds)
        for keyframe, mine in zip(filtered.keyframes, found[0].keyframes, strict=True)
    )
    assert [keyframe.frames for keyframe in found[0].keyframes] == [6, 1]
    assert (found[0].frames_searched, found[0].frames_kept, found[0].takes) == (7, 7, 1)
    assert [keyframe.frames for keyframe in found[1].keyframes] == [17, 4]
    assert [keyframe.frames for keyframe in found[2].keyframes] == [0, 0]
    rows = explain_search(store, [own, none]).to_pylist()
    assert [row["step"] for row in rows if row["query"] == "own"] == ["takes", "1", "2", "search", "hits"]
    assert all(row["share"] is None or row["share"] <= 1 for row in rows)


def test_what_is_explained_is_what_the_search_finds(store: Store) -> None:
    queries = [QUERIES[1], *read_queries("example", BODY)]
    hits = search_store(store, queries)
    for report in explain_store(store, queries):
        assert report.ranges == hits.column("query").to_pylist().count(report.query)


def test_a_hit_of_an_alternative_is_a_hit_of_the_query(store: Store) -> None:
    either, low = parse_queries(
        "either: {any_of: [low, {keyframes: [{on: [rhand_above_neck]}]}]}\nlow: {keyframes: [{on: [body_low]}]}", BODY
    )
    rows = [(row["take"], row["start"], row["stop"]) for row in search_store(store, [either]).to_pylist()]
    assert rows == [("amy", 0, 4), ("kim", 1, 2), ("kim", 5, 7), ("zoe", 1, 4), ("zoe", 6, 7)]
    assert explain_store(store, [either])[0].frames_kept == 11
    assert search_store(store, [low]).num_rows == 4


def test_a_query_searches_the_takes_of_its_own_filter(store: Store) -> None:
    query, wrong = parse_queries(
        "q: {takes: \"name <> 'zoe'\", keyframes: [{on: [body_low]}]}\nw: {takes: a b, keyframes: [{on: [1]}]}", BODY
    )
    assert search_store(store, [query]).column("take").to_pylist() == ["amy", "kim", "kim"]
    assert search_store(store, [query], "name <> 'amy'").column("take").to_pylist() == ["kim", "kim"]
    (report,) = explain_store(store, [query])
    assert (report.takes, report.frames_kept, report.frames_searched) == (2, 6, 14)
    with pytest.raises(KinedexError, match=r"^queries:2: query 'w': the filter over takes does not work"):
        search_store(store, [wrong])
    with pytest.raises(KinedexError, match="'q' has a filter over takes"):
        preselect(store.words(), BODY, [query])


def test_a_filter_over_a_column_that_takes_lack_names_the_nearest(store: Store) -> None:
    (query,) = parse_queries("q:\n  keyframes: [{on: [1]}]\n  takes: actr = 'al'", BODY, "mine.yaml")
    with pytest.raises(KinedexError, match=r"^mine\.yaml:3: query 'q': .*actr = 'al'; did you mean 'actor'"):
        search_store(store, [query])
    with pytest.raises(KinedexError, match="did you mean 'frames'"):
        explain_store(store, [query], "frmes > 3")


def test_hits_are_kept_in_place_of_those_of_the_same_name(tmp_path: Path) -> None:
    store = make_store(tmp_path / "store", TAKES)
    save_hits(store, search_store(store, QUERIES, run="r1"), "mine", "r1")
    save_hits(store, search_store(store, QUERIES[1:], run="r2"), "mine", "r2")
    save_hits(store, search_store(store, QUERIES[:1], run="r3"), "others", "r3")
    again = open_store(tmp_path / "store")
    kept = again.sql("SELECT saved_as, run, query, count(*) AS hits FROM hits GROUP BY ALL ORDER BY ALL").to_pylist()
    assert kept == [
        {"saved_as": "mine", "run": "r2", "query": "hand_up", "hits": 3},
        {"saved_as": "others", "run": "r3", "query": "squat", "hits": 2},
    ]
    assert search_store(again, QUERIES).num_rows == 5


def test_a_query_file_is_loaded_whole_or_by_name() -> None:
    assert [query.name for query in load_query_file("example", BODY, ["turn", "squat"])] == ["turn", "squat"]
    assert load_query_file("example", BODY) == read_queries("example", BODY)
    with pytest.raises(KinedexError, match="did you mean 'squat'"):
        load_query_file("example", BODY, ["squad"])


def test_a_part_asked_for_by_name_is_told_from_a_name_that_is_not_there(tmp_path: Path) -> None:
    (tmp_path / "q.yaml").write_text("a: {part: true, keyframes: [{on: [1]}]}\nb: {any_of: [a]}\n")
    (tmp_path / "q.json").write_text('[{"name": "a", "part": true, "keyframes": [{"on": [1]}]}]')
    for file in ("q.yaml", "q.json"):
        with pytest.raises(KinedexError, match=r"'a' is a part \(`part: true`\): other queries are made of it"):
            load_query_file(tmp_path / file, BODY, ["a"])
    assert [query.name for query in load_query_file(tmp_path / "q.yaml", BODY, ["b"])] == ["b"]


def ranges_of(found: TakeRanges) -> list[list[list[int]]]:
    return [found.take(i).tolist() for i in range(len(found))]


def test_words_in_memory_give_what_the_index_gives(store: Store) -> None:
    words = store.words()
    queries = [*QUERIES, *read_queries("example", BODY)]
    in_memory = {
        name: inverted_lists(words.words, words.offsets, one.first, one.count) for name, one in BODY.sets.items()
    }
    stored = read_lists(store, queries, words.take_ids)
    sliced, mapped = sliced_words(words, BODY), sliced_store(store)
    np.testing.assert_array_equal(mapped.take_ids, words.take_ids)
    for query, one, other in zip(queries, sliced.search(queries), mapped.search(queries), strict=True):
        expected = ranges_of(searched_lists(in_memory, query, len(words)))
        assert ranges_of(searched_lists(stored, query, len(words))) == expected
        assert ranges_of(one) == ranges_of(other) == expected


def searched_lists(lists: Mapping[str, InvertedLists], query: KeyframeQuery, takes: int) -> TakeRanges:
    """The ranges of a query by the algorithm of the thesis."""
    found = []
    for chain in query.chains:
        segments = [keyframe_list(lists[one.set], one.mask, one.value) for one in chain.keyframes]
        found.append(ranges_by_take(search_lists(segments, chain.bounds), takes))
    return TakeRanges.united(found)


def test_several_threads_share_the_slices_of_a_store(store: Store) -> None:
    sliced = sliced_store(store)
    expected = list(map(ranges_of, sliced.search(QUERIES)))
    with ThreadPoolExecutor(4) as threads:
        found = list(threads.map(lambda _: list(map(ranges_of, sliced.search(QUERIES))), range(40)))
    assert all(one == expected for one in found)


def test_preselection_in_the_index_is_that_in_words(tmp_path: Path) -> None:
    store = make_store(tmp_path / "store", TAKES, indexed=False)
    chosen = store.words([1, 3])
    expected = {query: ranges_of(found) for query, found in preselect(chosen, BODY, QUERIES).items()}
    for _ in ("without an index", "with one"):
        found = preselect_stored(store, chosen, QUERIES)
        assert {query: ranges_of(one) for query, one in found.items()} == expected
        build_index(store, threads=1)
    with_filter = parse_queries("q: {takes: \"name <> 'zoe'\", keyframes: [{on: [body_low]}]}", BODY)
    with pytest.raises(KinedexError, match="'q' has a filter over takes"):
        preselect_stored(store, chosen, with_filter)


def test_without_an_index_the_way_to_build_it_is_told(tmp_path: Path) -> None:
    unindexed = make_store(tmp_path / "store", TAKES, indexed=False)
    with pytest.raises(StoreError, match="index is missing"):
        search_store(unindexed, QUERIES)


def test_a_template_may_reach_out_of_the_hits_of_its_query() -> None:
    takes = [TAKES["zoe"], np.zeros(30, np.uint64)]
    words = TakeWords(np.array([3, 8]), np.array([0, 7, 37]), np.concatenate(takes))
    (squat,) = choose_queries(QUERIES, ["squat"])
    hits = preselect(words, BODY, QUERIES)
    template = np.zeros((8, 40))
    template[2:5, [BODY.feature("rknee_bent").number - 1, BODY.feature("body_low").number - 1]] = 1.0
    # keyframes fit columns 0, 2, 2 and 5: 0 columns before and 8 − 5 after, at the
    # stiffness sqrt(1 / 3) of the gaps, and 2 frames
    assert template_window(squat, template, BODY) == (2, 8)
    found = template_ranges(hits, [squat], template, BODY, words.offsets)
    assert found.tolist() == [[0, 7]]


def test_several_queries_for_one_template_are_united() -> None:
    words = TakeWords(np.array([1]), np.array([0, 40]), motion(rknee_bent="x" + "." * 39, body_low="." * 38 + "xx"))
    queries = parse_queries(
        "a: {keyframes: [{on: [rknee_bent]}], positions: [0]}\nb: {keyframes: [{on: [body_low]}], positions: [0]}", BODY
    )
    found = template_ranges(preselect(words, BODY, queries), queries, np.zeros((2, 40)), BODY, words.offsets)
    # K = 1: nothing is known of the tempo, so 2 columns may take 4 frames, and 2 frames are added
    assert found.tolist() == [[0, 7], [36, 40]]


def test_a_query_that_does_not_fit_the_template_is_told() -> None:
    query = KeyframeQuery("q", "q", QUERIES[1].keyframes, (), (5,))
    with pytest.raises(KinedexError, match="template column 5, but the template has 5"):
        template_window(query, np.zeros((5, 40)), BODY)
    # margins of its own: learned with another template, as where an actor is left out
    assert template_window(replace(query, margins=(3, 4)), np.zeros((5, 40)), BODY) == (3, 4)
    (turn,) = parse_queries("turn: {keyframes: [{on: [root_turning]}]}", BODY)
    with pytest.raises(KinedexError, match="F40, the template has 39"):
        template_window(turn, np.zeros((5, 39)), BODY)


# ---- real motion -----------------------------------------------------------------------------------------


def real_words(shared: Path) -> tuple[list[str], TakeWords]:
    table = pq.read_table(shared / "reference" / "feature_words.parquet")
    sampled = table.column("source_frame").to_numpy() % 4 == 0
    takes = np.array(table.column("take").to_pylist())[sampled]
    words = table.column("word").to_numpy().astype(np.uint64)[sampled]
    names = [name for name in dict.fromkeys(takes.tolist()) if name.startswith("HDM_")]
    parts = [words[takes == name] for name in names]
    offsets = np.cumsum([0, *(len(part) for part in parts)])
    return names, TakeWords(np.arange(len(names)), offsets, np.concatenate(parts))


@pytest.mark.shared
def test_the_authors_queries_agree_with_brute_force_on_hdm05(shared: Path) -> None:
    names, words = real_words(shared)
    queries = read_queries(shared / "reference" / "keyframe_queries.json", BODY)
    assert (len(queries), len(names)) == (62, 193)
    hits = preselect(words, BODY, queries)
    for query in queries:
        for i in range(len(names)):
            matches = []
            for keyframe in query.keyframes:
                word_set = BODY.sets[keyframe.set]
                take = (words.take(i) >> np.uint64(word_set.first - 1)) & np.uint64(keyframe.mask)
                matches.append((take == np.uint64(keyframe.value)).tolist())
            expected = ranges_by_sets(matches, query.bounds) if all(map(any, matches)) else []
            found = [tuple(own) for own in hits[query].take(i).tolist()]
            assert found == expected, (query.name, names[i])
    assert sum(len(found.ranges) for found in hits.values()) > 100


@pytest.mark.shared
@pytest.mark.parametrize(
    ("query", "motion_class", "least"),
    [
        ("squat", "squat1Reps", 36),
        ("kick_left", "kickLFront1Reps", 18),
        ("lie_down", "lieDownFloor", 14),
        ("reach_up_right", "grabHighR", 16),
        ("elbow_to_left_knee", "elbowToKnee1RepsLelbowStart", 17),
        ("arm_circle_backward", "rotateArmsBothBackward1Reps", 8),
        ("hands_up", "rotateArmsBothBackward1Reps", 10),
        ("hands_up", "throwBasketball", 9),
        ("turn", "jogLeftCircle4StepsRstart", 7),
    ],
)
def test_the_shipped_queries_find_the_clips_they_are_about(
    shared: Path, query: str, motion_class: str, least: int
) -> None:
    names, words = real_words(shared)
    queries = choose_queries(read_queries("example", BODY), [query])
    counts = np.diff(preselect(words, BODY, queries)[queries[0]].offsets)
    assert sum(count > 0 for name, count in zip(names, counts, strict=True) if f"_{motion_class}_" in name) >= least
