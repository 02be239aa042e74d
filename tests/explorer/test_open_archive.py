"""The open store of the explorer: newer versions appear, what a request holds stays, and faults are reported."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from kinedex.explorer import open_archive as module
from kinedex.explorer.open_archive import Archive
from kinedex.ops.errors import StoreError
from kinedex.storage.snapshot.manifest_files import manifest_path
from kinedex.storage.store.garbage_collection import collect_garbage
from kinedex.storage.store.writer import StoreWriter
from tests.storage.made_up import BODY, add


@pytest.fixture
def copy(store: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(store, tmp_path / "store"))


@pytest.fixture(autouse=True)
def no_pause(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "LOOK_SECONDS", 0.0)


def write(path: Path, name: str) -> None:
    with StoreWriter.open(path, BODY) as writer:
        add(writer, {name: 40})
        writer.commit()


def test_a_newer_version_appears_and_the_older_one_stays_readable(copy: Path) -> None:
    archive = Archive(copy)
    before = archive.store()
    write(copy, "new_one")
    after = archive.store()
    assert archive.store() is after, "a version is opened once"
    assert len(after.take_ids) == len(before.take_ids) + 1
    collect_garbage(copy, keep=1)
    name = next(iter(before.take_ids))
    assert before.frames(name).num_rows > 0


def test_between_two_looks_the_folder_is_left_alone(copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "LOOK_SECONDS", 60.0)
    archive = Archive(copy)
    before = archive.store()
    write(copy, "new_one")
    assert archive.store() is before


def test_a_store_that_is_gone_is_an_error_until_it_is_back(copy: Path) -> None:
    archive = Archive(copy)
    before = archive.store()
    away = copy.rename(copy.with_name("away"))
    with pytest.raises(StoreError, match="does not exist any more"):
        archive.state()
    copy.mkdir()
    with pytest.raises(StoreError, match="has no manifest any more"):
        archive.store()
    copy.rmdir()
    away.rename(copy)
    assert archive.store() is before


def test_a_version_that_cannot_be_read_is_an_error_until_it_is_repaired(copy: Path) -> None:
    archive = Archive(copy)
    write(copy, "new_one")
    newest = manifest_path(copy, archive.store().manifest.version)
    write(copy, "newer_one")
    damaged = newest.with_name(f"{int(newest.stem) + 1:06d}.json")
    text = damaged.read_text()
    damaged.write_text(text[:100])
    with pytest.raises(StoreError, match=damaged.name):
        archive.store()
    damaged.write_text(text)
    assert "newer_one" in archive.store().take_ids
