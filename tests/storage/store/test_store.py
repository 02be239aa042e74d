"""Tests of reading a store."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from kinedex.ops.errors import KinedexError, ParameterError, StoreError
from kinedex.storage.snapshot.manifest_files import manifest_path
from kinedex.storage.snapshot.parts import ROW_GROUP, joint_positions
from kinedex.storage.snapshot.schemas import FORMAT_VERSION
from kinedex.storage.store.store import open_store
from kinedex.storage.store.writer import StoreWriter
from tests.storage.made_up import BODY, add, arrays, make_store, take_row, takes_table, write_frames

TAKES = {"bd_walk": 50, "bk_kick": 7, "dg_still": 1, "mm_empty": 0}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return make_store(tmp_path / "store", TAKES)


def test_takes_come_back_sorted_by_name(path: Path) -> None:
    takes = open_store(path).takes()
    assert takes["name"].to_list() == sorted(TAKES)
    assert takes["frames"].to_list() == [TAKES[name] for name in sorted(TAKES)]


def test_a_filter_selects_takes(path: Path) -> None:
    store = open_store(path)
    assert store.takes("actor IN ('bd', 'mm') AND class IS NULL")["name"].to_list() == ["bd_walk", "mm_empty"]
    assert store.takes("groups ->> 'session' = '1'").height == 4
    assert store.takes("frames > 1000 -- none").schema == store.takes().schema


@pytest.mark.parametrize("wrong", ["actr = 'bd'", "actor = ", "-- all", "true); DROP TABLE takes; SELECT (1"])
def test_a_wrong_filter_is_refused_with_the_columns(path: Path, wrong: str) -> None:
    with pytest.raises(KinedexError) as caught:
        open_store(path).takes(wrong)
    assert wrong in str(caught.value)


@pytest.mark.parametrize("nothing", ["", " \n"])
def test_an_empty_filter_is_no_filter_and_said_to_be_none(path: Path, nothing: str) -> None:
    with pytest.raises(KinedexError, match="the filter over takes is empty; leave it out"):
        open_store(path).takes(nothing)


def test_a_misspelt_column_is_answered_with_the_columns(path: Path) -> None:
    with pytest.raises(KinedexError, match="columns of takes: take_id, name, source"):
        open_store(path).takes("actr = 'bd'")


def test_words_come_back_as_they_were_written(path: Path) -> None:
    store = open_store(path)
    words = store.words()
    names = {store.take_id(name): name for name in TAKES}
    assert words.take_ids.tolist() == sorted(names)
    for index, take in enumerate(words.take_ids):
        np.testing.assert_array_equal(words.take(index), arrays(names[int(take)], TAKES[names[int(take)]])[2])


def test_words_of_some_takes_are_in_order_of_take_id_and_each_once(path: Path) -> None:
    store = open_store(path)
    first, last = store.take_id("bd_walk"), store.take_id("dg_still")
    words = store.words([last, first, last])
    assert words.take_ids.tolist() == [first, last]
    assert words.frames.tolist() == [50, 1]
    assert len(store.words([]).words) == 0


def test_an_unknown_take_is_an_error(path: Path) -> None:
    with pytest.raises(StoreError, match="99"):
        open_store(path).words([99])
    with pytest.raises(StoreError, match="did you mean 'bd_walk'"):
        open_store(path).frames("bd_wlk")


def test_frames_of_a_take_have_its_joints_and_its_root(path: Path) -> None:
    table = open_store(path).frames("bd_walk", 10, 20)
    positions, orientation, words = arrays("bd_walk", 50)
    assert table.column("frame").to_pylist() == list(range(10, 20))
    np.testing.assert_array_equal(joint_positions(table, BODY.joints), positions[:, :, 10:20].astype(np.float32))
    np.testing.assert_array_equal(table.column("word").to_numpy(), words[10:20])
    assert table.column("root_orientation")[0]["w"].as_py() == np.float32(orientation[0, 10])
    assert open_store(path).frames("mm_empty").num_rows == 0


def test_a_range_outside_the_take_is_refused(path: Path) -> None:
    with pytest.raises(ParameterError, match="frame range"):
        open_store(path).frames("bk_kick", 3, 8)


def test_words_survive_many_parts_and_row_groups(tmp_path: Path) -> None:
    with StoreWriter.open(tmp_path, BODY) as writer:
        ids = writer.assign_take_ids(["a", "b", "c", "d"])
        frames = {"a": 200_000, "b": 30_000, "c": 90_000, "d": 5}
        # the ids of the two parts interleave
        parts = [write_words(tmp_path, {ids[n]: frames[n] for n in group}) for group in ("ac", "bd")]
        writer.add_takes(takes_table([take_row(ids[n], n, frames[n]) for n in frames]), parts)
        writer.commit()
    groups = pq.ParquetFile(tmp_path / parts[0].path).metadata
    whole = 290_000 // ROW_GROUP - 1
    expected = [ROW_GROUP] * whole + [290_000 - whole * ROW_GROUP]
    assert [groups.row_group(i).num_rows for i in range(groups.num_row_groups)] == expected
    words = open_store(tmp_path).words([ids["b"], ids["c"]])
    assert words.frames.tolist() == [30_000, 90_000]
    np.testing.assert_array_equal(words.take(1), np.arange(90_000, dtype=np.uint64) // 5 + ids["c"])
    assert open_store(tmp_path).frames("c", 89_999).num_rows == 1


def write_words(store: Path, takes: dict[int, int]):
    from kinedex.storage.snapshot.parts import FramesWriter

    with FramesWriter(store, BODY) as writer:
        for take, frames in sorted(takes.items()):
            still = np.broadcast_to(np.float32(0), (24, 3, frames))
            words = np.arange(frames, dtype=np.uint64) // 5 + np.uint64(take)
            writer.add(take, still, np.broadcast_to(np.float32(0), (4, frames)), words)
        return writer.close()


def test_a_store_that_is_moved_still_reads(path: Path, tmp_path: Path) -> None:
    moved = tmp_path / "elsewhere" / "moved"
    moved.parent.mkdir()
    shutil.move(path, moved)
    assert open_store(moved).words().frames.sum() == 58


def test_a_reader_keeps_its_version_while_a_writer_commits(path: Path) -> None:
    before = open_store(path)
    with StoreWriter.open(path, BODY) as writer:
        add(writer, {"bd_walk": 20, "tr_new": 5}, edition=1)
        writer.drop_takes([writer.assign_take_ids(["bk_kick"])["bk_kick"]])
        writer.commit()
    assert before.takes()["name"].to_list() == sorted(TAKES)
    np.testing.assert_array_equal(before.frames("bd_walk").column("word").to_numpy(), arrays("bd_walk", 50)[2])
    after = open_store(path)
    assert after.takes()["name"].to_list() == ["bd_walk", "dg_still", "mm_empty", "tr_new"]
    np.testing.assert_array_equal(after.frames("bd_walk").column("word").to_numpy(), arrays("bd_walk", 20, 1)[2])


def test_no_store_and_other_directories_are_told_apart(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="does not exist"):
        open_store(tmp_path / "none")
    with pytest.raises(StoreError, match="is no kinedex store"):
        open_store(tmp_path)


def test_a_store_of_another_format_is_refused(path: Path) -> None:
    newest = manifest_path(path, 2)
    newest.write_text(newest.read_text().replace(f'"format_version": {FORMAT_VERSION}', '"format_version": 7'))
    with pytest.raises(StoreError, match="the manifest is damaged"):
        open_store(path)
    content = {name: value for name, value in json.loads(newest.read_text()).items() if name != "checksum"}
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    newest.write_text(json.dumps(content | {"checksum": hashlib.sha256(text.encode()).hexdigest()}))
    with pytest.raises(StoreError, match="format version 7, this kinedex reads versions 3 and 4"):
        open_store(path)


@pytest.mark.parametrize(
    "damage", [lambda text: text[: len(text) // 2], lambda text: text.replace('"rows": 58', '"rows": 59')]
)
def test_a_damaged_manifest_is_named(path: Path, damage) -> None:
    newest = manifest_path(path, 2)
    newest.write_text(damage(newest.read_text()))
    with pytest.raises(StoreError, match="json: the manifest is damaged"):
        open_store(path)


def test_a_missing_and_a_broken_part_are_named(path: Path) -> None:
    store = open_store(path)
    part = path / store.manifest.frames[0].path
    part.write_bytes(part.read_bytes()[:-100])
    with pytest.raises(StoreError, match=part.name):
        store.words()
    part.unlink()
    with pytest.raises(StoreError, match="file is missing"):
        store.words()


def test_the_store_brings_its_feature_set_along(path: Path) -> None:
    assert open_store(path).feature_set == BODY


def test_a_part_explains_its_own_bits(path: Path) -> None:
    metadata = pq.read_schema(path / open_store(path).manifest.frames[0].path).metadata
    assert b'"2":{"number":3,"name":"rhand_above_neck","feature_set":"upper"}' in metadata[b"kinedex.bits"]
    assert metadata[b"kinedex.feature_set_digest"].decode() == BODY.digest


def test_frames_given_as_a_table_are_the_same_as_a_part(path: Path, tmp_path: Path) -> None:
    whole = open_store(path)
    other = tmp_path / "other"
    with StoreWriter.open(other, BODY) as writer:
        ids = writer.assign_take_ids(["bk_kick"])
        table = whole.frames("bk_kick")
        column = np.full(table.num_rows, ids["bk_kick"])
        table = table.set_column(0, "take_id", [column])
        writer.add_takes(takes_table([take_row(ids["bk_kick"], "bk_kick", 7)]), table)
        writer.commit()
    np.testing.assert_array_equal(open_store(other).words().words, arrays("bk_kick", 7)[2])


def test_leftovers_are_named_after_their_content(path: Path) -> None:
    assert write_frames(path, {"x": (90, 12)}) == write_frames(path, {"x": (90, 12)})


def test_takes_come_as_arrow_too_and_a_joint_without_a_copy(path: Path) -> None:
    store = open_store(path)
    assert store.takes_table().column("name").to_pylist() == sorted(TAKES)
    assert store.takes_table("frames < 10").column("name").to_pylist() == ["bk_kick", "dg_still", "mm_empty"]
    assert store.takes_table("frames < 10").schema == store.takes_table().schema
    wrist = store.frames("bd_walk").column("rwrist")
    assert wrist.num_chunks == 1
    assert wrist.chunk(0).field("y").to_numpy(zero_copy_only=True).shape == (50,)
    words = store.words()
    assert words.words.flags.writeable
    assert np.shares_memory(words.take(0), words.words)
