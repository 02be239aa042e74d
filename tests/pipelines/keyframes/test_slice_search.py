"""Searching the bit slices of an index: the same hits for any shards, pieces and threads, and while it is replaced."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.queries.keyframe_query import KeyframeQuery, word_pattern
from kinedex.catalog.queries.query_reader import parse_queries
from kinedex.ops.errors import StoreError
from kinedex.ops.ranges import TakeRanges
from kinedex.ops.search.bit_slice_search import search_slices
from kinedex.ops.search.bit_slices import slice_words
from kinedex.ops.words import NO_WORD, U64, TakeWords
from kinedex.pipelines.keyframes import slice_search
from kinedex.pipelines.keyframes.slice_search import Shard, SlicedWords, sliced_store, sliced_words, stored_words
from kinedex.storage.index.builder import build_index
from kinedex.storage.store.garbage_collection import collect_garbage
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.writer import StoreWriter
from tests.ops.search.divided import ranges_by_take
from tests.storage.made_up import add, make_store

ROOT = Path(__file__).parents[3]
BODY = load_feature_set("body40")
QUERIES: tuple[KeyframeQuery, ...] = parse_queries(
    """
step: {keyframes: [{on: [1]}, {on: [2], off: [1]}], gaps: [{range: [1, 9]}]}
wave: {keyframes: [{on: [15]}, {off: [15]}, {on: [15, 27]}], gaps: [{range: [1, 20]}, {range: [0, 200]}]}
either: {any_of: [{keyframes: [{on: [3]}]}, {keyframes: [{on: [4]}, {on: [5]}], gaps: [{range: [0, 70]}]}]}
""",
    BODY,
)


def listed(found: TakeRanges) -> list[tuple[int, int, int]]:
    takes = np.repeat(np.arange(len(found)), np.diff(found.offsets))
    return list(zip(takes.tolist(), found.starts.tolist(), found.stops.tolist(), strict=True))


def together(takes: dict[int, U64]) -> TakeWords:
    ids = sorted(takes)
    offsets = np.cumsum([0, *(len(takes[take]) for take in ids)])
    return TakeWords(np.array(ids, np.int64), offsets, np.concatenate([np.empty(0, np.uint64), *map(takes.get, ids)]))


def made_up_words(seed: int, frames: int) -> U64:
    """Words that often match: few different ones, each for some frames, some of them invalid."""
    rng = np.random.default_rng(seed)
    few = rng.integers(0, 2**40, 5, dtype=np.uint64)
    words = np.repeat(rng.choice(few, frames // 3 + 1), 3)[:frames]
    words[rng.random(frames) < 0.05] = NO_WORD
    return words


@pytest.fixture
def small_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(slice_search, "PIECE_BLOCKS", 3)
    monkeypatch.setattr(slice_search, "WORTH_BLOCKS", 0)
    monkeypatch.setattr(slice_search, "_JOINED_BLOCKS", 2)


@given(
    lengths=st.lists(st.integers(0, 300), max_size=12),
    shards=st.integers(1, 4),
    threads=st.integers(1, 4),
    asked=st.one_of(st.none(), st.sets(st.integers(0, 11))),
    seed=st.integers(0, 2**32),
)
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_hits_do_not_depend_on_shards_pieces_and_threads(
    small_pieces: None, lengths: list[int], shards: int, threads: int, asked: set[int] | None, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    takes = {7 + 3 * i: made_up_words(seed + i, length) for i, length in enumerate(lengths)}
    home = dict(zip(takes, rng.integers(0, shards, len(takes)).tolist(), strict=True))
    ids = np.array(sorted(takes), np.int64)
    made = []
    for number in range(shards):
        here = together({take: words for take, words in takes.items() if home[take] == number})
        # a take that is gone, and whose id may be that of one that is elsewhere
        slices = slice_words(
            np.concatenate([here.words, made_up_words(seed, 90)]),
            np.concatenate([here.offsets, [len(here.words) + 90]]),
            40,
        )
        made.append(Shard(slices, np.concatenate([np.searchsorted(ids, here.take_ids), [-1]])))
    sliced = SlicedWords(ids, tuple(made), BODY)
    if asked is not None:
        ids = ids[[i for i in sorted(asked) if i < len(ids)]]
        sliced = sliced.select(ids)
    words = together({int(take): takes[int(take)] for take in ids})
    slices = slice_words(words.words, words.offsets, 40)
    expected = []
    for query in QUERIES:
        patterns = [word_pattern(chain, BODY) for chain in query.chains]
        found = [search_slices(slices, one.masks, one.values, one.gaps) for one in patterns]
        expected.append(listed(TakeRanges.united([ranges_by_take(one, len(words)) for one in found])))
    assert [listed(found) for found in sliced.search(QUERIES, threads)] == expected
    assert [listed(found) for found in sliced.search(QUERIES, 1)] == expected
    assert [listed(found) for found in sliced_words(words, BODY).search(QUERIES)] == expected


def test_a_take_that_is_not_there_cannot_be_searched(tmp_path: Path) -> None:
    store = open_store(make_store(tmp_path / "store", {"a": 40}), at="newest")
    build_index(store, threads=1)
    with pytest.raises(KeyError, match="9"):
        sliced_store(store).select(np.array([1, 9]))


def test_the_index_has_the_words_of_the_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = open_store(make_store(tmp_path / "store", {"a": 40, "b": 130, "c": 64}), at="newest")
    build_index(first, threads=1)
    store = changed(first, 0)
    with StoreWriter.open(store.path, BODY) as writer:
        writer.drop_takes([store.take_id("b")])
        writer.commit()
    store = open_store(store.path, at="newest")

    def same(asked: list[int]) -> bool:
        found, expected = stored_words(store, asked), store.words(asked)
        pairs = [(found.take_ids, expected.take_ids), (found.offsets, expected.offsets), (found.words, expected.words)]
        return all(np.array_equal(*pair) for pair in pairs)

    asked = sorted(store.take_ids.values())
    assert same(asked)  # without an index
    build_index(store, threads=1)
    store = open_store(store.path)
    monkeypatch.setattr(Store, "words", None)
    found = stored_words(store, asked[::-1])
    monkeypatch.undo()
    assert np.array_equal(found.words, store.words(asked).words)
    assert same(asked[1:2])
    assert same([])
    with pytest.raises(StoreError, match="no live take"):
        stored_words(store, [*asked, 999])


# ---- while the index is replaced -------------------------------------------------------------------------

_READER = """
import sys
from pathlib import Path
from kinedex.catalog.features import load_feature_set
from kinedex.catalog.queries.query_reader import parse_queries
from kinedex.pipelines.keyframes.slice_search import sliced_store
from kinedex.storage.store.store import open_store
from tests.pipelines.keyframes.test_slice_search import QUERIES, listed

sliced = sliced_store(open_store(sys.argv[1], at="newest"))
print("open", flush=True)
sys.stdin.readline()
print([listed(found) for found in sliced.search(QUERIES)], flush=True)
"""


def changed(store: Store, edition: int) -> Store:
    """Another version, in which a take has been replaced and one was added; with its index."""
    with StoreWriter.open(store.path, BODY) as writer:
        add(writer, {"a": 200 + edition, f"more_{edition}": 70}, edition)
        writer.commit()
    later = open_store(store.path, at="newest")
    build_index(later, threads=1)
    return later


def test_a_process_reads_on_in_a_generation_that_has_been_replaced_and_removed(tmp_path: Path) -> None:
    store = open_store(make_store(tmp_path / "store", {"a": 300, "b": 500}), at="newest")
    old = build_index(store, threads=1)
    expected = [listed(found) for found in sliced_store(store).search(QUERIES)]
    assert any(expected)
    command = [sys.executable, "-c", _READER, str(store.path)]
    with subprocess.Popen(command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as reader:
        assert reader.stdin is not None
        assert reader.stdout is not None
        assert reader.stdout.readline() == "open\n"
        for edition in range(1, 4):
            store = changed(store, edition)
        collect_garbage(store.path, keep=1)
        assert not old.exists()
        reader.stdin.write("go\n")
        reader.stdin.flush()
        assert reader.stdout.readline() == f"{expected}\n"
    now = [listed(found) for found in sliced_store(store).search(QUERIES)]
    words = sliced_words(store.words(), BODY)
    assert now == [listed(found) for found in words.search(QUERIES)] != expected


def test_slices_of_shards_that_stay_are_one_file_in_both_generations(tmp_path: Path) -> None:
    store = open_store(make_store(tmp_path / "store", {"a": 300, "b": 500}), at="newest")
    before = build_index(store, threads=1)
    with StoreWriter.open(store.path, BODY) as writer:
        add(writer, {"c": 64})
        writer.commit()
    after = build_index(open_store(store.path, at="newest"), threads=1)
    files = [sorted(folder.glob("*.slices")) for folder in (before, after)]
    assert [len(found) for found in files] == [1, 2]
    assert os.path.samefile(files[0][0], files[1][0])


def test_what_is_mapped_cannot_be_written_to(tmp_path: Path) -> None:
    store = open_store(make_store(tmp_path / "store", {"a": 300}), at="newest")
    build_index(store, threads=1)
    (shard,) = sliced_store(store).shards
    with pytest.raises(ValueError, match="read-only"):
        shard.slices.bits[0] = 1


def test_an_index_whose_slices_are_gone_or_shortened_says_how_to_build_it(tmp_path: Path) -> None:
    store = open_store(make_store(tmp_path / "store", {"a": 300}), at="newest")
    (file,) = build_index(store, threads=1).glob("*.slices")
    content = file.read_bytes()
    for damage in (content[:-64], None):
        file.unlink()
        if damage is not None:
            file.write_bytes(damage)
        with pytest.raises(StoreError, match=r"stale: .* is damaged, or was built by another version"):
            sliced_store(store)
    build_index(store, threads=1)
    assert len(sliced_store(store).take_ids) == 1
