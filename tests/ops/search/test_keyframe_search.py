"""The keyframe search of the thesis against naive twins, its running example, and the authors' queries on motion."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops.errors import ParameterError
from kinedex.ops.ranges import from_axis, to_axis
from kinedex.ops.search.gaps import UNBOUNDED, gap_bounds, nominal_gap
from kinedex.ops.search.inverted_lists import InvertedLists, inverted_lists
from kinedex.ops.search.keyframe_search import completable_frames, keyframe_list, search_lists
from kinedex.ops.words import I64, MAX_FEATURES, U64, cut
from tests.oracles.keyframes import algorithm_1, all_hits, covered, ranges_by_enumeration, ranges_by_sets

EXAMPLE = ([(3, 4), (6, 7)], [(1, 2), (4, 6), (9, 10)], [(1, 3), (5, 8), (11, 12), (14, 15)])
EXAMPLE_GAPS = [(2, 6), (3, 8)]
STIFFNESS = [0.0, 0.07, 0.2, 0.28, 0.5, 0.55, 0.6, 0.75, 0.9, 1.0]


def segments(*pairs: tuple[int, int]) -> I64:
    return np.array(pairs, np.int64).reshape(-1, 2)


def pairs_of(found: I64) -> list[tuple[int, int]]:
    return [tuple(pair) for pair in found.tolist()]


def lists_of(takes: list[U64]) -> InvertedLists:
    return inverted_lists(np.concatenate(takes), np.cumsum([0, *map(len, takes)]), 1, MAX_FEATURES)


def by_take(found: I64, takes: int) -> list[list[tuple[int, int]]]:
    ranges: list[list[tuple[int, int]]] = [[] for _ in range(takes)]
    for take, (start, stop) in zip(*(part.tolist() for part in from_axis(found)), strict=True):
        ranges[take].append((start, stop))
    return ranges


# ---- gaps ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("distance", "stiffness", "gap"),
    [
        (25, 0.28, (7, 89)),
        (100, 0.55, (55, 181)),
        (7, 0.07, (1, 100)),
        (3, 0.5, (2, 6)),
        (5, 0.6, (3, 8)),
        (9, 1.0, (9, 9)),
        (0, 0.4, (0, 0)),
        (0, 0.0, (0, UNBOUNDED)),
        (12, 0.0, (0, UNBOUNDED)),
        (108_000, 1e-6, (1, UNBOUNDED)),
        (5, 5e-324, (0, UNBOUNDED)),
    ],
)
def test_the_admissible_gap_of_a_distance_is_rounded_before_it_is_cut(
    distance: int, stiffness: float, gap: tuple[int, int]
) -> None:
    assert gap_bounds(distance, stiffness) == gap


@given(st.integers(0, 5000), st.sampled_from(STIFFNESS))
def test_the_distance_itself_is_always_admissible(distance: int, stiffness: float) -> None:
    low, high = gap_bounds(distance, stiffness)
    assert low <= distance <= high


@pytest.mark.parametrize(("distance", "stiffness"), [(-1, 0.5), (2.5, 0.5), (3, -0.1), (3, 1.1), (3, np.nan)])
def test_a_distance_or_stiffness_out_of_its_domain_is_refused(distance: int, stiffness: float) -> None:
    with pytest.raises(ParameterError, match="must be"):
        gap_bounds(distance, stiffness)


def test_a_range_shows_the_stiffness_it_stands_for() -> None:
    assert nominal_gap(2, 8) == (4.0, 0.5)
    assert nominal_gap(0, 0) == (0.0, 1.0)
    assert nominal_gap(3, UNBOUNDED) == (float("inf"), 0.0)


# ---- segments and lists ----------------------------------------------------------------------------------


def test_a_wildcard_joins_the_runs_of_all_words_it_stands_for() -> None:
    lists = lists_of([np.array([5, 5, 7, 1, 5, 7, 7], np.uint64), np.array([7, 0], np.uint64)])
    second = 1 << 32
    assert pairs_of(keyframe_list(lists, mask=0b101, value=0b101)) == [(0, 3), (4, 7), (second, second + 1)]


@given(st.lists(st.lists(st.integers(0, 7), max_size=30), min_size=1, max_size=4), st.integers(0, 7), st.integers(0, 7))
def test_a_keyframe_list_holds_the_frames_whose_words_match(takes: list[list[int]], mask: int, value: int) -> None:
    value &= mask
    found = keyframe_list(lists_of([np.array(take, np.uint64) for take in takes]), mask, value)
    expected = [covered((n, n) for n, word in enumerate(take) if word & mask == value) for take in takes]
    assert by_take(found, len(takes)) == expected


def test_a_keyframe_that_asks_for_bits_it_masks_is_refused() -> None:
    with pytest.raises(ParameterError):
        keyframe_list(lists_of([np.zeros(3, np.uint64)]), mask=2, value=3)


# ---- the running example ---------------------------------------------------------------------------------


def test_the_recursion_finds_the_matches_of_table_3_1() -> None:
    assert algorithm_1(EXAMPLE, (3, 5), (0.5, 0.6)) == [
        ((1, 2, 2), (3, 8)),
        ((1, 2, 3), (3, 12)),
        ((1, 2, 4), (3, 14)),
        ((1, 3, 4), (3, 15)),
        ((2, 3, 4), (6, 15)),
    ]


def test_the_running_example_is_one_range_from_3_to_15() -> None:
    lists = [segments(*((s - 1, t) for s, t in one)) for one in EXAMPLE]
    gaps = [gap_bounds(3, 0.5), gap_bounds(5, 0.6)]
    assert gaps == EXAMPLE_GAPS
    assert pairs_of(search_lists(lists, gaps)) == [(2, 15)]


def test_the_hits_of_the_running_example_are_those_of_table_3_1() -> None:
    matches = [[any(s <= n + 1 <= t for s, t in one) for n in range(15)] for one in EXAMPLE]
    hits = {tuple(n + 1 for n in hit) for hit in all_hits(matches, EXAMPLE_GAPS)}
    from_first = {(3, 5, 8), (3, 5, 11), (3, 6, 11), (3, 6, 12), (4, 6, 11), (4, 6, 12), (3, 6, 14)}
    from_first |= {(4, 6, 14)}
    to_last = {(a, b, c) for a in (3, 4) for b in (9, 10) for c in (14, 15)} - {(3, 10, 14), (3, 10, 15)}
    second = {(a, b, c) for a in (6, 7) for b in (9, 10) for c in (14, 15)}
    table = from_first | to_last | second
    assert table <= hits
    # The printed table forgets (3, 5, 12), and leaves out the irrelevant matches (1, 3, 3) and (2, 3, 3).
    assert hits - table == {(3, 5, 12), (3, 9, 12), (4, 9, 12), (6, 9, 12), (7, 9, 12)}


# ---- random motion against the twins ---------------------------------------------------------------------


@st.composite
def archives(draw: st.DrawFn, longest: int = 12) -> list[dict[str, U64]]:
    """A few takes, each with words in two feature sets of two and three features."""
    takes = []
    for _ in range(draw(st.integers(1, 3))):
        length = draw(st.integers(1, longest))
        takes.append(
            {
                "two": np.array(draw(st.lists(st.integers(0, 3), min_size=length, max_size=length)), np.uint64),
                "three": np.array(draw(st.lists(st.integers(0, 7), min_size=length, max_size=length)), np.uint64),
            }
        )
    return takes


@st.composite
def queries(draw: st.DrawFn, largest: int) -> tuple[list[tuple[str, int, int]], list[tuple[int, int]]]:
    """Keyframes (set, mask, value) and gaps, given by distance and stiffness or as ranges."""
    count = draw(st.integers(1, largest))
    frames = []
    for _ in range(count):
        name, width = draw(st.sampled_from([("two", 2), ("three", 3)]))
        mask = draw(st.integers(0, 2**width - 1))
        frames.append((name, mask, draw(st.integers(0, 2**width - 1)) & mask))
    soft = st.builds(gap_bounds, st.integers(0, 9), st.sampled_from(STIFFNESS))
    given_range = st.tuples(st.integers(0, 6), st.integers(0, 8)).map(lambda pair: (pair[0], sum(pair)))
    hour = st.sampled_from([(0, 108_000), (0, UNBOUNDED), (3, UNBOUNDED), (0, 2**40), (108_000, 216_000)])
    gaps = [draw(st.one_of(soft, given_range, hour)) for _ in range(count - 1)]
    return frames, gaps


def found_in(archive: list[dict[str, U64]], frames: list[tuple[str, int, int]]) -> list[I64]:
    lists = {name: lists_of([take[name] for take in archive]) for name in ("two", "three")}
    return [keyframe_list(lists[name], mask, value) for name, mask, value in frames]


def matches_in(take: dict[str, U64], frames: list[tuple[str, int, int]]) -> list[list[bool]]:
    return [[int(word) & mask == value for word in take[name]] for name, mask, value in frames]


@settings(max_examples=250, deadline=None)
@given(archives(), queries(largest=4))
def test_what_is_found_is_the_union_of_all_hits(
    archive: list[dict[str, U64]], query: tuple[list[tuple[str, int, int]], list[tuple[int, int]]]
) -> None:
    frames, gaps = query
    found = by_take(search_lists(found_in(archive, frames), gaps), len(archive))
    assert found == [ranges_by_enumeration(matches_in(take, frames), gaps) for take in archive]


@settings(max_examples=150, deadline=None)
@given(archives(longest=40), queries(largest=6))
def test_longer_motion_with_more_keyframes_agrees_too(
    archive: list[dict[str, U64]], query: tuple[list[tuple[str, int, int]], list[tuple[int, int]]]
) -> None:
    frames, gaps = query
    found = by_take(search_lists(found_in(archive, frames), gaps), len(archive))
    assert found == [ranges_by_sets(matches_in(take, frames), gaps) for take in archive]


@settings(max_examples=100, deadline=None)
@given(archives(longest=8), queries(largest=4))
def test_both_twins_agree(
    archive: list[dict[str, U64]], query: tuple[list[tuple[str, int, int]], list[tuple[int, int]]]
) -> None:
    for take in archive:
        matches = matches_in(take, query[0])
        assert ranges_by_sets(matches, query[1]) == ranges_by_enumeration(matches, query[1])


@settings(max_examples=150, deadline=None)
@given(archives(longest=25), queries(largest=5), st.data())
def test_the_printed_recursion_leaves_out_irrelevant_matches_only(
    archive: list[dict[str, U64]],
    query: tuple[list[tuple[str, int, int]], list[tuple[int, int]]],
    data: st.DataObject,
) -> None:
    frames = query[0]
    distances = [data.draw(st.integers(0, 9)) for _ in frames[1:]]
    stiffness = [data.draw(st.sampled_from(STIFFNESS)) for _ in frames[1:]]
    one_take = archive[:1]
    lists = found_in(one_take, frames)
    found = search_lists(lists, [gap_bounds(d, s) for d, s in zip(distances, stiffness, strict=True)])
    closed = [[(start + 1, stop) for start, stop in pairs_of(one)] for one in lists]
    recursion = covered(span for _, span in algorithm_1(closed, distances, stiffness))
    assert pairs_of(found) == [(start - 1, stop - 1) for start, stop in recursion]


@settings(max_examples=100, deadline=None)
@given(archives(), queries(largest=4))
def test_a_frame_survives_if_the_rest_of_the_query_follows_it(
    archive: list[dict[str, U64]], query: tuple[list[tuple[str, int, int]], list[tuple[int, int]]]
) -> None:
    frames, gaps = query
    kept = completable_frames(found_in(archive, frames), gaps)
    for k in range(len(frames)):
        for index, take in enumerate(archive):
            begun = {hit[0] for hit in all_hits(matches_in(take, frames[k:]), gaps[k:])}
            assert by_take(kept[k], len(archive))[index] == covered((n, n) for n in begun)


def test_a_query_of_twenty_keyframes_is_exact() -> None:
    rng = np.random.default_rng(20)
    archive = [
        {"two": rng.integers(0, 4, 120).astype(np.uint64), "three": rng.integers(0, 8, 120).astype(np.uint64)}
        for _ in range(3)
    ]
    frames = [("two", 2, 2 * (k % 2)) if k % 3 else ("three", 4, 4) for k in range(20)]
    for gaps in ([(1, 4)] * 19, [(0, 7)] * 19, [(5, 5), (0, 3)] * 9 + [(2, 9)], [(0, UNBOUNDED)] * 19):
        found = by_take(search_lists(found_in(archive, frames), gaps), len(archive))
        expected = [ranges_by_sets(matches_in(take, frames), gaps) for take in archive]
        assert found == expected
        assert any(expected)


def test_the_farthest_end_differs_inside_a_segment() -> None:
    # From frame 0 only the nearer last keyframe is in reach, from frame 3 the farther one as well.
    lists = [segments((0, 4)), segments((5, 6), (8, 9))]
    assert pairs_of(search_lists(lists, [(5, 5)])) == [(0, 9)]
    assert pairs_of(completable_frames(lists, [(5, 5)])[0]) == [(0, 1), (3, 4)]


def test_ranges_that_touch_are_one_range() -> None:
    lists = [segments((0, 1), (3, 4)), segments((2, 3), (5, 6))]
    assert pairs_of(search_lists(lists, [(2, 2)])) == [(0, 6)]


def test_no_hit_leaves_its_take_however_long_the_gap() -> None:
    last_frame = 2**31 - 1
    take = 1 << 32
    first = segments((last_frame, last_frame + 1))
    second = segments((take, take + 1))
    for gap in ((0, UNBOUNDED), (0, 2**62), (1, 1), (UNBOUNDED, UNBOUNDED)):
        assert len(search_lists([first, second], [gap])) == 0
        assert len(search_lists([second, first], [gap])) == 0
    whole = segments((0, last_frame + 1), (take, take + last_frame + 1))
    assert int(np.diff(search_lists([whole, whole], [(0, UNBOUNDED)])).sum()) == 2 * 2**31


def test_an_hour_between_two_poses_is_found() -> None:
    hour = 30 * 3600
    lists = [segments((10, 11)), segments((10 + hour, 12 + hour))]
    assert pairs_of(search_lists(lists, [(hour, hour)])) == [(10, 11 + hour)]
    assert pairs_of(search_lists(lists, [gap_bounds(hour, 0.5)])) == [(10, 12 + hour)]
    assert len(search_lists(lists, [(hour + 2, 2 * hour)])) == 0


def test_a_pose_that_never_occurs_leaves_nothing() -> None:
    none, some = segments(), segments((3, 9))
    for lists in ([none], [none, some], [some, none], [some, none, some], [none, none]):
        assert len(search_lists(lists, [(0, 5)] * (len(lists) - 1))) == 0


def test_a_query_of_one_keyframe_returns_its_segments() -> None:
    assert pairs_of(search_lists([segments((1, 3), (5, 9))], [])) == [(1, 3), (5, 9)]


@pytest.mark.parametrize("gaps", [[], [(0, 1), (0, 1)], [(3, 2)], [(-1, 2)]])
def test_gaps_that_do_not_fit_the_query_are_refused(gaps: list[tuple[int, int]]) -> None:
    with pytest.raises(ParameterError, match="gap"):
        search_lists([segments((1, 2)), segments((1, 2))], gaps)


def test_a_query_without_keyframes_is_refused() -> None:
    with pytest.raises(ParameterError, match="keyframe"):
        search_lists([], [])


def test_frames_beyond_the_axis_are_refused() -> None:
    assert to_axis([1], [2**31]).tolist() == [2**32 + 2**31]
    for take, frame in ((0, 2**31 + 1), (0, -1), (-1, 0), (2**31, 0)):
        with pytest.raises(ParameterError):
            to_axis([take], [frame])


# ---- the authors' queries on real motion -----------------------------------------------------------------

SETS = {"upper": (1, 14), "lower": (15, 12), "mix": (27, 14)}


@pytest.mark.shared
def test_the_authors_queries_agree_with_brute_force_on_hdm05(shared: Path) -> None:
    table = pq.read_table(shared / "reference" / "feature_words.parquet")
    every_fourth = table.column("source_frame").to_numpy() % 4 == 0
    names = table.column("take").to_numpy()[every_fourth]
    words = table.column("word").to_numpy().astype(np.uint64)[every_fourth]
    motion = [words[names == name] for name in dict.fromkeys(names) if str(name).startswith("HDM_")]
    assert len(motion) == 193
    cuts = {name: [cut(take, *span) for take in motion] for name, span in SETS.items()}
    inverted = {name: lists_of(takes) for name, takes in cuts.items()}
    compared = hits = 0
    for query in json.loads((shared / "reference" / "keyframe_queries.json").read_text()):
        frames = []
        for keyframe in query["keyframes"]:
            fixed = [(i, c) for i, c in enumerate(keyframe["pattern"]) if c != "*"]
            frames.append(
                (keyframe["feature_set"], sum(1 << i for i, _ in fixed), sum(1 << i for i, c in fixed if c == "1"))
            )
        gaps = [gap_bounds(d, s) for d, s in zip(query["distances"], query["stiffness"], strict=True)]
        lists = [keyframe_list(inverted[name], mask, value) for name, mask, value in frames]
        found = by_take(search_lists(lists, gaps), len(motion))
        for index in range(len(motion)):
            matches = [
                ((cuts[name][index] & np.uint64(mask)) == np.uint64(value)).tolist() for name, mask, value in frames
            ]
            expected = ranges_by_sets(matches, gaps) if all(map(any, matches)) else []
            assert found[index] == expected, (query["name"], index)
            compared += 1
            hits += len(expected)
    assert compared == 62 * 193
    assert hits > 100
