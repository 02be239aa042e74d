"""The files of bit slices beside an index: what is in them, and what happens where one is damaged."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops.errors import StoreError
from kinedex.ops.search.bit_slices import BitSlices, slice_words
from kinedex.ops.words import I64, NO_WORD
from kinedex.pipelines.keyframes.slice_search import sliced_store
from kinedex.storage.index.builder import build_index
from kinedex.storage.index.generations import (
    Generation,
    Shard,
    ShardPart,
    file_digest,
    read_generation,
    slices_name,
)
from kinedex.storage.index.slice_files import LAYOUT, MAGIC, ShardSlices, open_slices, write_slices
from kinedex.storage.remedies import repair
from kinedex.storage.snapshot.checked_files import CheckedFiles
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.verification import verify
from kinedex.storage.store.writer import StoreWriter
from tests.storage.flipped import flip_bit
from tests.storage.made_up import BODY, add, make_store

NOTHING = Generation(3, 1, "", "", 30.0, "", (), {}, 0, 0, "", 0.0, "", 0, 0.0)


def shard(size: int, xxh3: str, *takes: tuple[int, int]) -> Shard:
    return Shard(1, (ShardPart("", takes),), 0, 0, size, xxh3)


def opened(folder: Path, one: Shard) -> ShardSlices:
    (found,) = open_slices(CheckedFiles(folder), folder, replace(NOTHING, shards=(one,)))
    return found


@given(lengths=st.lists(st.integers(0, 200), max_size=6), features=st.integers(1, 63), seed=st.integers(0, 2**32))
@settings(max_examples=40, deadline=None)
def test_what_is_mapped_is_what_was_written(
    tmp_path_factory: pytest.TempPathFactory, lengths: list[int], features: int, seed: int
) -> None:
    folder = tmp_path_factory.mktemp("slices")
    rng = np.random.default_rng(seed)
    offsets = np.cumsum([0, *lengths])
    words = rng.integers(0, 2**features, offsets[-1], dtype=np.uint64)
    words[rng.random(len(words)) < 0.1] = NO_WORD
    slices = slice_words(words, offsets, features)
    take_ids = np.arange(5, 5 + 2 * len(lengths), 2)
    size, xxh3 = write_slices(folder / slices_name(1), take_ids, slices)
    assert (folder / slices_name(1)).stat().st_size == size
    assert file_digest(folder / slices_name(1)) == xxh3
    found = opened(folder, shard(size, xxh3, *((take, take + 1) for take in (5, 9) if take in take_ids)))
    assert found.take_ids.tolist() == take_ids.tolist()
    assert found.live.tolist() == [take in (5, 9) for take in take_ids.tolist()]
    assert found.slices.features == features
    for name, array in slices.arrays.items():
        np.testing.assert_array_equal(found.slices.arrays[name], array)


@pytest.fixture
def store(tmp_path: Path) -> Store:
    store = open_store(make_store(tmp_path / "store", {"a": 70, "b": 130}), at="newest")
    build_index(store, threads=1)
    return store


def file_of(store: Store, number: int = 1) -> Path:
    return store.index_path().parent / slices_name(number)


def head(*counts: int, letters: bytes = MAGIC) -> bytes:
    return letters + np.array(counts, "<u8").tobytes()


@pytest.mark.parametrize(
    ("at", "bytes_there"),
    [
        (0, b"KDXslice"),
        (0, head(LAYOUT + 1, 40, 2, 5)),
        (0, head(LAYOUT, 40, 2, 6)),
        (0, head(LAYOUT, 40, 2**63, 5)),
        (64 + 64, np.array([200], "<i8").tobytes()),
        (64 + 128 + 8, np.array([3], "<i8").tobytes()),
        (64 + 192, np.array([9], "<i4").tobytes()),
    ],
)
def test_a_damaged_file_is_named_and_never_searched(store: Store, at: int, bytes_there: bytes) -> None:
    file = file_of(store)
    content = bytearray(file.read_bytes())
    content[at : at + len(bytes_there)] = bytes_there
    file.write_bytes(content)
    with pytest.raises(StoreError, match=r"shard-000001\.slices: .* does not fit its checksum; `kinedex"):
        sliced_store(store)


def test_a_flipped_bit_is_found_and_only_its_shard_is_made_anew(store: Store) -> None:
    with StoreWriter.open(store.path, BODY) as writer:
        add(writer, {"c": 64})
        writer.commit()
    store = open_store(store.path, at="newest")
    build_index(store, threads=1)
    file = file_of(store, 2)
    content = file.read_bytes()
    file.write_bytes(content[:-9] + bytes([content[-9] ^ 1]) + content[-8:])
    (finding,) = verify(store)
    assert finding.fault
    assert "shard-000002.slices: its content does not fit its checksum; `kinedex repair" in str(finding)
    generation = build_index(store, threads=1)
    says = read_generation(generation)
    assert says is not None
    assert (says.built_frames, len(says.shards), says.frames) == (64, 2, 264)
    assert verify(store) == []


def test_slices_that_are_not_those_of_the_words_are_found(store: Store) -> None:
    file = file_of(store)
    words = store.words()
    changed = words.words ^ np.uint64(1)
    file.unlink()
    publish_slices(file, words.take_ids, slice_words(changed, words.offsets, 40))
    found = [str(finding) for finding in verify(store)]
    assert all("shard-000001.slices: its slices" in finding for finding in found)
    assert ["(bits)" in finding for finding in found] == [True, False]


def publish_slices(file: Path, take_ids: I64, slices: BitSlices) -> None:
    """Slices with the checksum and size that the index says."""
    file.unlink(missing_ok=True)
    size, xxh3 = write_slices(file, take_ids, slices)
    says = read_generation(file.parent)
    assert says is not None
    (first,) = says.shards
    said = replace(says, shards=(replace(first, slices_bytes=size, slices_xxh3=xxh3),))
    (file.parent / "generation.json").write_text(said.to_json())


@pytest.mark.parametrize("at", [0, 5, -1])
def test_a_coarse_copy_that_is_not_that_of_the_words_is_found(store: Store, at: int) -> None:
    words = store.words()
    slices = slice_words(words.words, words.offsets, 40)
    coarse = slices.coarse.copy()
    coarse[at] ^= np.uint64(1 << 63 if at == -1 else 2)
    publish_slices(file_of(store), words.take_ids, replace(slices, coarse=coarse))
    (finding,) = verify(store)
    assert "shard-000001.slices: its slices (coarse) are not those of the takes' words" in str(finding)


@pytest.mark.parametrize("ids", [[6, 2], [2, 1], [1, 3], [1, 1]])
def test_other_takes_than_those_of_the_shard_are_never_searched(store: Store, ids: list[int]) -> None:
    file = file_of(store)
    content = bytearray(file.read_bytes())
    content[64 : 64 + 16] = np.array(ids, "<i8").tobytes()
    file.write_bytes(content)
    with pytest.raises(StoreError, match=r"shard-000001\.slices: .* does not fit its checksum; `kinedex repair"):
        sliced_store(store)
    (finding,) = verify(store)
    assert str(finding).endswith(f"its content does not fit its checksum; {repair(store.path).text}")
    build_index(store, threads=1)
    assert verify(store) == []
    assert sliced_store(open_store(store.path, at="newest")).take_ids.tolist() == [1, 2]


def test_files_that_are_cut_short_or_gone_are_named_by_verify(store: Store) -> None:
    file = file_of(store)
    size = file.stat().st_size
    file.write_bytes(file.read_bytes()[:-64])
    (file.parent / "index.duckdb").unlink()
    gone, short = sorted(str(finding) for finding in verify(store))
    assert gone.endswith(f"index.duckdb: the index is damaged: the file is missing; {repair(store.path).text}")
    said = f"the file has {size - 64} bytes, the index records {size}; {repair(store.path).text}"
    assert short.endswith(f"shard-000001.slices: the index is damaged: {said}")
    build_index(store, threads=1)
    assert verify(store) == []


def test_an_index_of_another_version_is_told_and_built_again(store: Store) -> None:
    file = store.index_path().parent / "generation.json"
    file.write_text(file.read_text().replace('"slices_xxh3"', '"other"'))
    with pytest.raises(StoreError, match=r"generation\.json is damaged, or was built by another version"):
        store.index_path()
    (finding,) = verify(store)
    assert "the index is damaged or of another version" in finding.problem
    build_index(store, threads=1)
    assert verify(store) == []


def test_no_older_version_answers_for_one_whose_index_is_damaged(store: Store) -> None:
    with StoreWriter.open(store.path, BODY) as writer:
        add(writer, {"c": 64})
        writer.commit()
        newest = writer.store
    assert open_store(store.path).manifest.version == store.manifest.version  # the index is still to be built
    record = build_index(newest, threads=1) / "generation.json"
    assert open_store(store.path).manifest.version == newest.manifest.version
    flip_bit(record, 200)
    reopened = open_store(store.path)
    assert reopened.manifest.version == newest.manifest.version
    for ask in (lambda: sliced_store(reopened), lambda: reopened.sql("FROM word_runs")):
        with pytest.raises(StoreError, match=f"{record.parent.name}/generation.json is damaged"):
            ask()
