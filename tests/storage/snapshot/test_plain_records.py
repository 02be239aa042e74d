"""Manifests are the records that pydantic makes of the same JSON, or pydantic names what is wrong."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError

from kinedex.ops.errors import StoreError
from kinedex.storage.snapshot.manifest import Manifest
from kinedex.storage.snapshot.manifest_files import json_checksum, manifest_path, read_newest, versions
from kinedex.storage.snapshot.plain_records import record_of
from tests.storage.made_up import make_store
from tests.storage.stores import unpacked

ADAPTER = TypeAdapter(Manifest)
RECORDS: dict[str, dict[str, Any]] = {
    "columns": {"height": {"type": "DOUBLE", "origin": "metadata"}},
    "sources": {"/in": {"stage": "a/ingest", "settings": {"rate": [1, None]}, "recorded": "2026"}},
    "removed_files": {"/in": ["a.amc"]},
    "stages": {"a/ingest": {"stage": "a", "fingerprint": "f", "run": "r", "finished": "2026", "seconds": 3}},
}
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=2) | st.dictionaries(st.text(max_size=3), inner, max_size=2),
    max_leaves=3,
)


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path: Path = tmp_path_factory.mktemp("records") / "store"
    make_store(path, {"bd_walk": 50, "mm_empty": 0})
    return path


@pytest.fixture(scope="module")
def content(store: Path) -> dict[str, Any]:
    made: dict[str, Any] = json.loads(manifest_path(store, versions(store)[-1]).read_text())
    return made | RECORDS


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Return the way to every value within a JSON value."""
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [path, *(found for key, item in inner for found in places(item, (*path, key)))]


def test_the_record_of_a_manifest_is_that_of_pydantic(content: dict[str, Any], tmp_path: Path) -> None:
    old = unpacked(3, tmp_path)
    for one in (content, json.loads(manifest_path(old, versions(old)[-1]).read_text())):
        assert repr(record_of(Manifest, one)) == repr(ADAPTER.validate_python(one))


@given(data=st.data())
def test_a_changed_manifest_is_read_as_by_pydantic_or_not_at_all(content: dict[str, Any], data: st.DataObject) -> None:
    changed = copy.deepcopy(content)
    *way, last = data.draw(st.sampled_from(places(changed)[1:]))
    holder = changed
    for key in way:
        holder = holder[key]
    if data.draw(st.booleans()):
        del holder[last]
    else:
        holder[last] = data.draw(VALUES)
    try:
        found = record_of(Manifest, changed)
    except (ValueError, OverflowError):
        return
    assert repr(found) == repr(ADAPTER.validate_python(changed))


def test_half_of_a_surrogate_pair_is_a_text_as_for_pydantic(content: dict[str, Any]) -> None:
    changed = content | {"command": "\ud800", "mappings": {"\ud800": ""}}
    assert repr(record_of(Manifest, changed)) == repr(ADAPTER.validate_python(changed))


@given(value=VALUES)
def test_what_pydantic_refuses_is_no_record(value: Any) -> None:
    with pytest.raises(ValidationError):
        ADAPTER.validate_python(value)
    with pytest.raises(ValueError):
        record_of(Manifest, value)


def test_a_sound_manifest_of_another_kind_names_the_value_at_fault(tmp_path: Path) -> None:
    make_store(tmp_path / "store", {"bd_walk": 50})
    path = manifest_path(tmp_path / "store", versions(tmp_path / "store")[-1])
    made = json.loads(path.read_text())
    made["frames"][0]["rows"] = "many"
    del made["checksum"]
    path.write_text(json.dumps(made | {"checksum": json_checksum(made)}))
    with pytest.raises(StoreError, match=r"frames\.0\.rows: .*integer"):
        read_newest(tmp_path / "store")
