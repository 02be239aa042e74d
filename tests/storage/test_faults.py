"""A full disk and other refusals of the operating system: a clear error, nothing half-visible, and a way on."""

from __future__ import annotations

import errno
import io
import json
import os
import threading
import time
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.errors import StoreError
from kinedex.storage.lock import Lock, Wait
from kinedex.storage.snapshot.manifest import Manifest, ranges
from kinedex.storage.snapshot.manifest_files import json_checksum, manifest_path, named_files, publish, read_version
from kinedex.storage.snapshot.parts import FramesWriter
from kinedex.storage.snapshot.schemas import FORMAT_VERSION
from kinedex.storage.store import garbage_collection as garbage
from kinedex.storage.store.compaction import FANOUT, compact
from kinedex.storage.store.store import open_store
from kinedex.storage.store.verification import verify
from kinedex.storage.store.writer import StoreWriter
from tests.storage.made_up import BODY, add, arrays, make_store

FULL = Path("/dev/full")
needs_a_full_device = pytest.mark.skipif(not FULL.is_char_device(), reason="no /dev/full here")
MESSAGE = r"cannot be written: No space left on device; nothing was committed.*`kinedex gc STORE`.*run the same"


def no_space(*_: object, **__: object) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


def unfinished(path: Path) -> list[Path]:
    return list(path.rglob(".tmp-*"))


@needs_a_full_device
def test_a_frames_part_on_a_full_disk_is_a_clear_error_and_leaves_nothing(tmp_path: Path) -> None:
    make_store(tmp_path, {"a": 5})
    with FramesWriter(tmp_path, BODY) as writer:
        writer._temporary.symlink_to(FULL)
        writer.add(2, *arrays("b", 400))
        with pytest.raises(StoreError, match=MESSAGE):
            writer.close()
    assert unfinished(tmp_path) == []
    assert verify(open_store(tmp_path, at="newest")) == []


def add_and_commit(writer: StoreWriter) -> None:
    add(writer, {"b": 400})
    writer.commit()


@pytest.mark.parametrize("moment", [1, 2, 3, 4, 5, 6])
def test_a_disk_that_fills_at_any_moment_of_a_commit_leaves_the_version_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, moment: int
) -> None:
    make_store(tmp_path, {"a": 5})
    left = moment
    really = os.fsync

    def fsync(descriptor: int) -> None:
        nonlocal left
        left -= 1
        if left <= 0:
            no_space()
        really(descriptor)

    with StoreWriter.open(tmp_path, BODY) as writer:
        monkeypatch.setattr(os, "fsync", fsync)
        # frames part, takes part and manifest: each flushes its file, then its folder
        with pytest.raises(StoreError, match=MESSAGE):
            add_and_commit(writer)
    monkeypatch.undo()
    assert unfinished(tmp_path) == []
    with StoreWriter.open(tmp_path, BODY) as writer:
        if "b" not in writer.store.takes()["name"].to_list():
            add_and_commit(writer)
    assert open_store(tmp_path).words().frames.tolist() == [5, 400]
    assert verify(open_store(tmp_path, at="newest")) == []


def test_a_compaction_on_a_full_disk_changes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with StoreWriter.open(tmp_path, BODY) as writer:
        for number in range(FANOUT):
            add(writer, {f"t{number}": 9})
            before = writer.commit()
        monkeypatch.setattr("pyarrow.parquet.ParquetWriter.write_table", no_space)
        with pytest.raises(StoreError, match=MESSAGE):
            compact(writer)
        monkeypatch.undo()
        assert open_store(tmp_path).manifest == before
        assert unfinished(tmp_path) == []
        assert compact(writer).changed
    assert verify(open_store(tmp_path, at="newest")) == []


class FullFile(io.FileIO):
    """A file that can be opened and locked, but not written to."""

    def __init__(self, path: Path, mode: str, buffering: int) -> None:
        super().__init__(path, "a+")

    def write(self, text: object) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")


def test_garbage_can_be_collected_on_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_store(tmp_path, {"a": 5})
    with StoreWriter.open(tmp_path, BODY) as writer:
        add(writer, {"a": 6}, edition=1)
        writer.commit()
    monkeypatch.setattr("kinedex.storage.lock.open", FullFile, raising=False)
    assert [item.kind for item in garbage.collect_garbage(tmp_path, keep=1).removed].count("frames part") == 1


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(StoreError, match=r"file/store: cannot be written: Not a directory"):
        StoreWriter.open(tmp_path / "file" / "store", BODY)


def test_a_writer_may_wait_for_another_to_finish(tmp_path: Path) -> None:
    make_store(tmp_path, {"a": 5})
    first = StoreWriter.open(tmp_path, BODY)
    threading.Timer(0.3, first.close).start()
    with StoreWriter.open(tmp_path, BODY, wait=Wait(20)) as second:
        assert second.manifest.version == 2
        began = time.monotonic()
        with pytest.raises(StoreError, match="must wait"):
            Lock(tmp_path / "lock", "this one", Wait(0.2))
        assert time.monotonic() - began >= 0.2


@given(st.sets(st.integers(1, 60)))
def test_ids_as_ranges_are_the_same_ids(ids: set[int]) -> None:
    found = ranges(sorted(ids))
    assert {take for start, stop in found for take in range(start, stop)} == ids
    assert all(stop < start for (_, stop), (start, _) in pairwise(found))


def test_a_manifest_reads_back_as_it_was_written_a_line_for_each_part(tmp_path: Path) -> None:
    with StoreWriter.open(tmp_path, BODY) as writer:
        for names in ("abc", "d", "b"):
            add(writer, dict.fromkeys(names, 3), edition=len(names))
            writer.commit()
        writer.drop_takes([4])
        written = writer.commit()
    assert read_version(tmp_path, written.version) == written
    assert named_files(tmp_path, written.version) == {part.path for part in written.parts}
    lines = manifest_path(tmp_path, written.version).read_text().splitlines()
    assert len([line for line in lines if "frames/part-" in line]) == len(written.frames) == 2
    assert any('"take_ids": [[1, 4]], "dropped": [[2, 3]]' in line for line in lines)


@pytest.mark.parametrize("wrong", ["x", [[1]], [[1, 2.5]], [[0, 10**12]]])
def test_take_ids_that_are_none_are_a_damaged_manifest(tmp_path: Path, wrong: object) -> None:
    make_store(tmp_path, {"a": 5})
    path = manifest_path(tmp_path, 2)
    content = json.loads(path.read_text())
    content["frames"][0]["take_ids"] = wrong
    del content["checksum"]
    path.write_text(json.dumps({**content, "checksum": json_checksum(content)}))
    with pytest.raises(StoreError, match=r"the manifest is damaged: frames\.0\.take_ids: .* must be"):
        read_version(tmp_path, 2)


def test_a_manifest_that_is_not_published_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_store(tmp_path, {"a": 5})
    monkeypatch.setattr(os, "link", no_space)
    with pytest.raises(StoreError, match=MESSAGE):
        publish(tmp_path, Manifest(FORMAT_VERSION, 3, "", BODY, 30.0, 9))
    assert unfinished(tmp_path) == []
