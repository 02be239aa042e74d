"""A file of a store is checked once, before it is first read, and again once it has changed."""

from __future__ import annotations

import os
import pickle
import re
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from kinedex.ops.errors import StoreError
from kinedex.storage.durable_files import xxh3_of
from kinedex.storage.snapshot import checked_files
from kinedex.storage.store.store import Store, open_store
from tests.storage.flipped import flip_bit
from tests.storage.made_up import make_store


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return make_store(tmp_path / "store", {"a": 300, "b": 200})


def frames_file(store: Store) -> Path:
    return store.path / store.manifest.frames[0].path


class Counter:
    """Computes checksums and counts them; it waits for no other thread."""

    def __init__(self) -> None:
        self.files: list[Path] = []

    def __call__(self, file: Path) -> tuple[str, os.stat_result]:
        self.files.append(file)
        return xxh3_of(file)


@pytest.mark.parametrize("keep_time", [False, True])
def test_a_flipped_bit_is_an_error_that_names_the_part_and_the_remedy(path: Path, keep_time: bool) -> None:
    store = open_store(path)
    file = frames_file(store)
    flip_bit(file, file.stat().st_size // 2, keep_time=keep_time)
    for read in (lambda: store.frames("a"), store.words):
        with pytest.raises(StoreError, match=f"{re.escape(str(file))}: the part is damaged.*kinedex repair"):
            read()
    assert store.takes().height == 2
    flip_bit(file, file.stat().st_size // 2)
    assert store.frames("a").num_rows == 300


def test_a_file_is_checked_once_by_any_number_of_threads(path: Path) -> None:
    store, counted = open_store(path), Counter()
    file, recorded = frames_file(store), store.manifest.frames[0].xxh3
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(lambda _: store.checked.is_sound(file, recorded, counted), range(40)))
    assert (found, counted.files) == ([True] * 40, [file])


def test_a_file_that_has_changed_is_checked_again(path: Path) -> None:
    store, counted = open_store(path), Counter()
    file, recorded = frames_file(store), store.manifest.frames[0].xxh3
    assert store.checked.is_sound(file, recorded, counted)
    content, status = file.read_bytes(), file.stat()
    os.utime(file, ns=(status.st_atime_ns, status.st_mtime_ns + 1))
    assert store.checked.is_sound(file, recorded, counted)
    file.with_suffix(".other").write_bytes(content)
    os.replace(file.with_suffix(".other"), file)
    os.utime(file, ns=(status.st_atime_ns, status.st_mtime_ns + 1))
    assert store.checked.is_sound(file, recorded, counted)
    assert counted.files == [file] * 3


def test_a_store_takes_what_it_knows_to_a_worker_which_keeps_what_it_finds(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = open_store(path)
    store.words()
    before = pickle.dumps(open_store(path))
    first, second = pickle.loads(before), pickle.loads(before)
    assert first.checked is second.checked
    assert first.checked is not store.checked
    first.words()
    monkeypatch.setattr(checked_files, "xxh3_of", None)
    pickle.loads(pickle.dumps(store)).words()
    assert pickle.loads(before).checked is not first.checked  # a store that came later has taken its place


def test_parts_of_format_3_are_checked_by_their_sha256(path: Path) -> None:
    store = open_store(path)
    part = store.manifest.frames[0]
    old = type(part)(part.path, part.rows, part.bytes, part.sha256, part.take_ids)
    assert store.checked.part(old) == frames_file(store)
    flip_bit(frames_file(store), 100)
    with pytest.raises(StoreError, match="the part is damaged"):
        store.checked.part(old)


def test_a_missing_part_is_named(path: Path) -> None:
    store = open_store(path)
    frames_file(store).unlink()
    with pytest.raises(StoreError, match=f"{re.escape(str(frames_file(store)))}.*missing"):
        store.words()
