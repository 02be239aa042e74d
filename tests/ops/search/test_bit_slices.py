"""Keyframe search on bit slices against its naive twins: blocks, groups and takes that end anywhere, invalid frames."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from random import Random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops.errors import ParameterError
from kinedex.ops.ranges import from_axis
from kinedex.ops.search import bit_slice_search as slicesearch
from kinedex.ops.search.bit_slice_search import search_slices
from kinedex.ops.search.bit_slices import GRANULE, BitSlices, slice_words, unsliced_words
from kinedex.ops.search.gaps import UNBOUNDED, gap_bounds
from kinedex.ops.search.inverted_lists import InvertedLists, inverted_lists
from kinedex.ops.search.keyframe_search import keyframe_list, search_lists
from kinedex.ops.words import I64, NO_WORD, U64, bits, cut
from tests.oracles.keyframes import ranges_by_enumeration, ranges_by_sets

FEATURES = 5
Query = tuple[list[int], list[int], list[tuple[int, int]]]


def slices_of(takes: list[U64], features: int = FEATURES) -> BitSlices:
    return slice_words(np.concatenate([np.zeros(0, np.uint64), *takes]), offsets_of(takes), features)


def offsets_of(takes: list[U64]) -> np.ndarray:
    return np.cumsum([0, *(len(take) for take in takes)])


def lists_of(takes: list[U64]) -> InvertedLists:
    return inverted_lists(np.concatenate([np.zeros(0, np.uint64), *takes]), offsets_of(takes), 1, FEATURES)


def by_take(found: I64, takes: int) -> list[list[tuple[int, int]]]:
    ranges: list[list[tuple[int, int]]] = [[] for _ in range(takes)]
    for take, (start, stop) in zip(*(part.tolist() for part in from_axis(found)), strict=True):
        ranges[take].append((start, stop))
    return ranges


def matches_in(take: U64, masks: list[int], values: list[int]) -> list[list[bool]]:
    """Return a list per keyframe, true at frames that meet it; an invalid frame meets none, not even wildcards."""
    return [
        [word != int(NO_WORD) and word & mask == value for word in take.tolist()]
        for mask, value in zip(masks, values, strict=True)
    ]


@st.composite
def archives(draw: st.DrawFn, longest: int) -> list[U64]:
    """Takes of words that stay for a while, some of them invalid."""
    takes = []
    for _ in range(draw(st.integers(0, 4))):
        length = draw(st.integers(0, longest))
        rng = np.random.default_rng(draw(st.integers(0, 2**32)))
        words = rng.integers(0, 2**FEATURES, length).astype(np.uint64)
        words[rng.random(length) < draw(st.sampled_from([0.0, 0.1]))] = NO_WORD
        takes.append(
            words[np.cumsum(rng.random(length) < draw(st.sampled_from([0.1, 0.5, 1.0]))) - 1] if length else words
        )
    return takes


@st.composite
def queries(draw: st.DrawFn, largest: int, bits_fixed: int = FEATURES) -> Query:
    masks, values = [], []
    for _ in range(draw(st.integers(1, largest))):
        mask = sum(1 << bit for bit in draw(st.sets(st.integers(0, FEATURES - 1), max_size=bits_fixed)))
        masks.append(mask)
        values.append(draw(st.integers(0, 2**FEATURES - 1)) & mask)
    soft = st.builds(gap_bounds, st.integers(0, 90), st.sampled_from([0.0, 0.28, 0.5, 0.9, 1.0]))
    given_range = st.tuples(st.integers(0, 140), st.integers(0, 140)).map(lambda pair: (pair[0], sum(pair)))
    near = st.tuples(st.integers(0, 3), st.integers(0, 6)).map(lambda pair: (pair[0], sum(pair)))
    hour = st.sampled_from([(0, 0), (0, 108_000), (0, UNBOUNDED), (3, UNBOUNDED), (64, 2**40), (108_000, 216_000)])
    return masks, values, [draw(st.one_of(soft, given_range, near, hour)) for _ in masks[1:]]


def test_slices_hold_the_words() -> None:
    rng = np.random.default_rng(1)
    takes = [rng.integers(0, 2**40, length).astype(np.uint64) for length in (1, 64, 0, 63, 130)]
    takes[4][[0, 65, 129]] = NO_WORD
    slices = slices_of(takes, 40)
    assert (len(slices), slices.features) == (5, 40)
    assert np.diff(slices.first).tolist() == [1, 2, 1, 1, 3]
    for index, take in enumerate(takes):
        rows = np.ascontiguousarray(slices.rows[:, slices.first[index] : slices.first[index + 1]])
        shown = np.unpackbits(rows.view(np.uint8), axis=1, bitorder="little")
        valid = take != NO_WORD
        assert shown[40, : len(take)].tolist() == valid.tolist()
        assert not shown[:, len(take) :].any()
        np.testing.assert_array_equal(shown[:40, : len(take)].T, bits(np.where(valid, take, 0), 40))


@settings(max_examples=50, deadline=None)
@given(archives(longest=140), st.randoms(use_true_random=False))
def test_words_come_back_from_their_slices(archive: list[U64], random: Random) -> None:
    order = random.sample(range(len(archive)), len(archive) // 2)
    starts = np.cumsum([1, *(len(archive[take]) + 1 for take in order)])
    words = np.full(int(starts[-1]), 77, np.uint64)
    unsliced_words(slices_of(archive), np.array(order, np.int64), starts[:-1], words)
    assert words.tolist() == [77, *(word for take in order for word in (*archive[take].tolist(), 77))]


def test_words_of_takes_that_are_not_there_or_do_not_fit_are_refused() -> None:
    slices = slices_of([np.arange(30, dtype=np.uint64)])
    for take, start, room in ((1, 0, 30), (-1, 0, 30), (0, 1, 30), (0, -1, 30)):
        with pytest.raises(ParameterError):
            unsliced_words(slices, np.array([take]), np.array([start]), np.zeros(room, np.uint64))


@pytest.mark.parametrize("features", [1, 40, 63])
def test_the_coarse_copy_says_what_occurs_in_a_few_frames(features: int) -> None:
    rng = np.random.default_rng(2)
    takes = [rng.integers(0, 2**features, length, np.uint64) for length in (1, 64, 0, 63, 130, 500)]
    takes[1][8:17], takes[5][::3] = NO_WORD, NO_WORD
    slices = slices_of(takes, features)
    on, valid = slices.rows[:features], slices.rows[features]
    wanted = np.vstack([on, ~on & valid, valid[None]])
    frames = np.unpackbits(np.ascontiguousarray(wanted).view(np.uint8), axis=1, bitorder="little")
    expected = frames.reshape(len(wanted), -1, GRANULE).any(axis=2)
    shown = np.unpackbits(slices.coarse.reshape(len(wanted), -1).view(np.uint8), axis=1, bitorder="little")
    np.testing.assert_array_equal(shown[:, : expected.shape[1]], expected)
    assert not shown[:, expected.shape[1] :].any()


def test_slices_are_made_again_from_their_arrays() -> None:
    slices = slices_of([np.arange(30, dtype=np.uint64)])
    again = BitSlices(**slices.arrays, features=slices.features)
    assert by_take(search_slices(again, [3], [2], []), 1) == by_take(search_slices(slices, [3], [2], []), 1)
    assert not any(array.flags.writeable for array in again.arrays.values())


@settings(max_examples=150, deadline=None)
@given(archives(longest=14), queries(largest=4), st.integers(1, 3))
def test_what_is_found_is_the_union_of_all_hits(archive: list[U64], query: Query, chunk: int) -> None:
    masks, values, gaps = query
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(slicesearch, "CHUNK", chunk)
        found = by_take(search_slices(slices_of(archive), *query), len(archive))
    assert found == [ranges_by_enumeration(matches_in(take, masks, values), gaps) for take in archive]


@settings(max_examples=120, deadline=None)
@given(archives(longest=210), queries(largest=5, bits_fixed=2), st.integers(1, 9))
def test_longer_takes_with_longer_gaps_agree_too(archive: list[U64], query: Query, chunk: int) -> None:
    masks, values, gaps = query
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(slicesearch, "CHUNK", chunk)
        found = by_take(search_slices(slices_of(archive), *query), len(archive))
    expected = []
    for take in archive:
        matches = matches_in(take, masks, values)
        expected.append(ranges_by_sets(matches, gaps) if all(map(any, matches)) else [])
    assert found == expected


@settings(max_examples=150, deadline=None)
@given(archives(longest=700), queries(largest=20, bits_fixed=2))
def test_slices_and_lists_find_the_same(archive: list[U64], query: Query) -> None:
    masks, values, gaps = query
    inverted, slices = lists_of(archive), slices_of(archive)
    lists = [keyframe_list(inverted, mask, value) for mask, value in zip(masks, values, strict=True)]
    for one, mask, value in zip(lists, masks, values, strict=True):
        np.testing.assert_array_equal(search_slices(slices, [mask], [value], []), one)
    np.testing.assert_array_equal(search_slices(slices, masks, values, gaps), search_lists(lists, gaps))


def test_a_query_of_twenty_keyframes_is_exact() -> None:
    rng = np.random.default_rng(20)
    archive = [rng.integers(0, 2**FEATURES, 120).astype(np.uint64) for _ in range(3)]
    masks = [1 << k % FEATURES for k in range(20)]
    values = [mask * (k % 3 > 0) for k, mask in enumerate(masks)]
    for gaps in ([(1, 4)] * 19, [(0, 7)] * 19, [(5, 5), (0, 3)] * 9 + [(2, 9)], [(0, UNBOUNDED)] * 19):
        found = by_take(search_slices(slices_of(archive), masks, values, gaps), len(archive))
        assert found == [ranges_by_sets(matches_in(take, masks, values), gaps) for take in archive]
        assert any(found)


def test_a_hit_may_span_invalid_frames_but_not_begin_or_end_there() -> None:
    take = np.array([1, 1, NO_WORD, NO_WORD, 2, NO_WORD], np.uint64)
    slices = slices_of([take])
    assert by_take(search_slices(slices, [1, 2], [1, 2], [(0, 9)]), 1) == [[(0, 5)]]
    assert by_take(search_slices(slices, [0, 0], [0, 0], [(0, 9)]), 1) == [[(0, 5)]]
    assert by_take(search_slices(slices, [4], [0], []), 1) == [[(0, 2), (4, 5)]]


@pytest.mark.parametrize("length", [63, 64, 65, 128])
def test_no_hit_leaves_its_take_however_long_the_gap(length: int) -> None:
    one, other = np.zeros(length, np.uint64), np.zeros(length, np.uint64)
    one[-1], other[0] = 1, 2
    for gap in ((0, UNBOUNDED), (1, 1), (0, 2**40), (1, 64), (1, 128)):
        slices = slices_of([one, other])
        assert len(search_slices(slices, [1, 2], [1, 2], [gap])) == 0
        assert len(search_slices(slices, [2, 1], [2, 1], [gap])) == 0
        assert by_take(search_slices(slices, [0], [0], []), 2) == [[(0, length)], [(0, length)]]


def test_an_hour_between_two_poses_is_found() -> None:
    hour = 30 * 3600
    take = np.zeros(hour + 100, np.uint64)
    take[10], take[10 + hour : 12 + hour] = 1, 2
    slices = slices_of([np.zeros(5, np.uint64), take])
    for gap, stop in (((hour, hour), 11), (gap_bounds(hour, 0.5), 12), ((0, UNBOUNDED), 12)):
        assert by_take(search_slices(slices, [1, 2], [1, 2], [gap]), 2)[1] == [(10, stop + hour)]
    assert len(search_slices(slices, [1, 2], [1, 2], [(hour + 2, 2 * hour)])) == 0


def test_sets_cut_from_words_are_stretches_of_their_rows() -> None:
    words = np.random.default_rng(3).integers(0, 2**FEATURES, 200).astype(np.uint64)
    upper = cut(words, 3, 3)
    found = search_slices(slices_of([words]), [0b10100], [0b00100], [])
    expected = search_slices(slices_of([upper], 3), [0b101], [0b001], [])
    assert by_take(found, 1) == by_take(expected, 1)


@pytest.mark.parametrize("chunk", [1, 70, 4096])
def test_rare_poses_far_apart_in_long_takes_are_all_found(chunk: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(slicesearch, "CHUNK", chunk)
    rng = np.random.default_rng(6)
    takes = []
    for length in (9000, 40, 64, 5000, 1, 700, 7000):
        take = rng.choice([0, 1, 2, 4], length, p=[0.994, 0.002, 0.002, 0.002]).astype(np.uint64)
        takes.append(take)
    poses = [1, 2, 4]
    lists = [keyframe_list(lists_of(takes), pose, pose) for pose in poses]
    for gaps in (
        [(0, 100), (300, 700)],
        [(500, 520), (0, UNBOUNDED)],
        [(64, 80), (0, 4000)],
        [(2048, 4096), (512, 640)],
    ):
        found = search_slices(slices_of(takes), poses, poses, gaps)
        np.testing.assert_array_equal(found, search_lists(lists, gaps))
        assert len(found)


def test_a_gap_longer_than_any_number_of_the_machine_has_no_bound() -> None:
    take = np.array([1, 0, 0, 2], np.uint64)
    assert by_take(search_slices(slices_of([take]), [1, 2], [1, 2], [(3, 2**80)]), 1) == [[(0, 4)]]
    assert by_take(search_slices(slices_of([take]), [1, 2], [1, 2], [(4, 2**80)]), 1) == [[]]


def test_an_archive_without_takes_has_no_hits() -> None:
    assert len(search_slices(slices_of([]), [1], [1], [])) == 0


@pytest.mark.parametrize(
    ("masks", "values", "gaps"),
    [
        ([], [], []),
        ([1], [], []),
        ([1], [2], []),
        ([1 << FEATURES], [0], []),
        ([-1], [0], []),
        ([2**64], [0], []),
        ([1], [2**70], []),
        ([-(2**70)], [0], []),
        ([1, 1], [1, 1], [(-1, 2)]),
        ([1, 1], [1, 1], [(1, 2), (1, 2)]),
        ([1, 1], [1, 1], []),
        ([1, 1], [1, 1], [(2, 1)]),
    ],
)
def test_queries_that_make_no_sense_are_refused(
    masks: list[int], values: list[int], gaps: list[tuple[int, int]]
) -> None:
    with pytest.raises(ParameterError):
        search_slices(slices_of([np.zeros(3, np.uint64)]), masks, values, gaps)


def test_words_that_cannot_be_sliced_are_refused() -> None:
    for features, offsets in ((0, [0, 3]), (64, [0, 3]), (5, [0, 2]), (5, [1, 3]), (5, [0, 3, 2, 3])):
        with pytest.raises(ParameterError):
            slice_words(np.zeros(3, np.uint64), np.array(offsets), features)


@settings(max_examples=100, deadline=None)
@given(archives(longest=300), queries(largest=4, bits_fixed=2), st.lists(st.integers(0, 4), max_size=3))
def test_parts_of_an_archive_find_what_the_whole_finds(archive: list[U64], query: Query, cuts: list[int]) -> None:
    slices = slices_of(archive)
    edges = sorted([0, len(archive), *(min(at, len(archive)) for at in cuts)])
    parts = [search_slices(slices, *query, takes=part) for part in pairwise(edges)]
    whole = search_slices(slices, *query)
    np.testing.assert_array_equal(np.concatenate(parts), whole)


@settings(max_examples=60, deadline=None)
@given(archives(longest=300), queries(largest=4, bits_fixed=2), st.integers(0, 4))
def test_slices_of_two_shards_find_what_one_of_all_takes_finds(archive: list[U64], query: Query, at: int) -> None:
    whole = by_take(search_slices(slices_of(archive), *query), len(archive))
    shards = archive[:at], archive[at:]
    assert [by_take(search_slices(slices_of(shard), *query), len(shard)) for shard in shards] == [
        whole[:at],
        whole[at:],
    ]


def test_threads_search_parts_of_one_archive_at_the_same_time() -> None:
    rng = np.random.default_rng(5)
    takes = [np.repeat(rng.integers(0, 2**FEATURES, 400), 9).astype(np.uint64) for _ in range(60)]
    slices, query = slices_of(takes), ([1, 6, 8], [1, 2, 8], [(2, 9), (0, 40)])
    whole = search_slices(slices, *query)
    with ThreadPoolExecutor(4) as pool:
        parts = list(pool.map(lambda at: search_slices(slices, *query, takes=(at, at + 4)), range(0, 60, 4)))
    np.testing.assert_array_equal(np.concatenate(parts), whole)
    assert len(whole) > 60


@pytest.mark.slow_as_python
@pytest.mark.parametrize("cached", [0, 2**20])
@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32), st.sampled_from([3, 60, 900]), queries(largest=4, bits_fixed=3))
def test_many_windows_of_short_and_long_takes_agree(cached: int, seed: int, mean: int, query: Query) -> None:
    rng = np.random.default_rng(seed)
    lengths = rng.geometric(1 / mean, max(30_000 // mean, 1)).clip(max=20_000)
    archive = [rng.integers(0, 2**FEATURES, length // 4 + 1).astype(np.uint64).repeat(4)[:length] for length in lengths]
    masks, values, gaps = query
    lists = [keyframe_list(lists_of(archive), mask, value) for mask, value in zip(masks, values, strict=True)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(slicesearch, "CACHED", cached)
        found = search_slices(slices_of(archive), *query)
    np.testing.assert_array_equal(found, search_lists(lists, gaps))


def test_ends_name_the_take_of_each_block_and_what_follows_in_it() -> None:
    slices = slices_of([np.zeros(length, np.uint64) for length in (0, 64, 5, 70 * 64, 1, 64 * 64 - 1, 3, 200 * 64)])
    words, before = slices.ends.reshape(-1, 2).T
    blocks = np.arange(len(slices.left))
    ends = np.unpackbits(np.ascontiguousarray(words).view(np.uint8), bitorder="little")
    assert ends.tolist() == [*(slices.left == 0).astype(int), *[0] * (len(ends) - len(blocks))]
    assert before.tolist() == [(slices.first[1:] <= block).sum() for block in range(0, len(blocks), 64)]


@pytest.mark.parametrize("takes", [(0, 3), (-1, 1), (2, 1)])
def test_takes_that_are_not_there_are_refused(takes: tuple[int, int]) -> None:
    with pytest.raises(ParameterError, match="takes"):
        search_slices(slices_of([np.zeros(3, np.uint64)] * 2), [1], [0], [], takes=takes)
