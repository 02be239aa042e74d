"""The manifest: its checksums of parts, and the formats that are read and written."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import xxhash

from kinedex.ops.errors import StoreError
from kinedex.storage.snapshot.manifest_files import manifest_path, publish, read_newest, require_current_format
from kinedex.storage.snapshot.schemas import FORMAT_VERSION
from kinedex.storage.store.writer import StoreWriter
from tests.storage.made_up import BODY, make_store
from tests.storage.stores import unpacked


@pytest.fixture
def path(tmp_path: Path) -> Path:
    make_store(tmp_path / "store", {"bd_walk": 50, "mm_empty": 0})
    return tmp_path / "store"


def test_every_part_has_the_xxh3_of_its_file(path: Path) -> None:
    parts = read_newest(path).parts
    assert parts
    for part in parts:
        assert part.xxh3 == xxhash.xxh3_128((path / part.path).read_bytes()).hexdigest()


def test_a_store_of_format_3_is_not_written(tmp_path: Path) -> None:
    path = unpacked(3, tmp_path)
    manifest = read_newest(path)
    assert (manifest.format_version, {part.xxh3 for part in manifest.parts}) == (3, {""})
    with pytest.raises(StoreError, match=f"format 3, which is only read.*`kinedex upgrade {path}`"):
        StoreWriter.open(path, BODY)
    with pytest.raises(StoreError, match="kinedex upgrade"):
        publish(path, replace(manifest, version=manifest.version + 1))
    assert not (path / "labels").exists()
    require_current_format(path, replace(manifest, format_version=FORMAT_VERSION))


def test_the_manifest_is_json_with_a_line_for_each_part(path: Path) -> None:
    text = manifest_path(path, read_newest(path).version).read_text()
    assert json.loads(text)["format_version"] == FORMAT_VERSION
    assert text.count('\n  {"path": ') == len(read_newest(path).parts)
