"""Merged stores have the takes and labels of both, frame for frame, or nothing has changed."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pytest

from kinedex.ops.errors import StoreError
from kinedex.storage.snapshot.schemas import TakeColumn
from kinedex.storage.store.merge import merge_store
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.verification import verify
from kinedex.storage.store.writer import StoreWriter
from tests.storage.made_up import BODY, add, make_store


@pytest.fixture
def first(tmp_path: Path) -> Path:
    return make_store(tmp_path / "first", {"a_walk": 30, "b_kick": 20})


@pytest.fixture
def second(tmp_path: Path) -> Store:
    """A store with replaced and removed takes, a column of its own, labels, and ids that are those of other takes."""
    path = make_store(tmp_path / "second", {"z_run": 40, "c_jump": 25, "d_gone": 9, "e_none": 0})
    with StoreWriter.open(path, BODY) as writer:
        writer.declare_columns({"style": TakeColumn("VARCHAR", "pattern")})
        add(writer, {"c_jump": 35}, edition=1)
        writer.drop_takes([writer.assign_take_ids(["d_gone"])["d_gone"]])
        row = {"take": "c_jump", "class": "jump", "start": 3, "stop": 9, "origin": "drawn"}
        made = writer.put_labels(pa.Table.from_pylist([row]))
        again = {**row, "stop": 12, "replaces": made.column("id")[0].as_py(), "origin": "corrected"}
        writer.put_labels(pa.Table.from_pylist([again]))
        writer.record_source("/films", "annotate/ingest", {"name": "stem"})
        writer.commit()
    return open_store(path)


def merge(path: Path, other: Store, prefix: str = "") -> Store:
    with StoreWriter.open(path, BODY) as writer:
        merge_store(writer, other, prefix)
    return open_store(path)


@pytest.mark.parametrize("prefix", ["", "lab-"])
def test_takes_come_frame_for_frame_and_labels_with_their_history(first: Path, second: Store, prefix: str) -> None:
    before = open_store(first)
    merged = merge(first, second, prefix)
    assert sorted(merged.take_ids) == sorted(["a_walk", "b_kick", *(f"{prefix}{name}" for name in second.take_ids)])
    for store, names in (
        (before, {"a_walk": "a_walk"}),
        (second, {name: f"{prefix}{name}" for name in second.take_ids}),
    ):
        for name, here in names.items():
            expected, found = store.frames(name), merged.frames(here)
            assert found.drop_columns("take_id").equals(expected.drop_columns("take_id")), name
    assert not [finding for finding in verify(merged) if finding.fault]
    assert "style" in merged.take_rows.column_names
    assert merged.manifest.sources["/films"].stage == "annotate/ingest"
    history = merged.labels(history=True).to_pylist()
    assert [(row["take"], row["stop"]) for row in history] == [(f"{prefix}c_jump", 9), (f"{prefix}c_jump", 12)]
    assert merged.labels().column("stop").to_pylist() == [12]


def test_equal_names_are_an_error_with_a_way_out(first: Path, second: Store) -> None:
    merge(first, second)
    version = open_store(first).manifest.version
    with pytest.raises(StoreError, match=r"both stores have 3 takes named 'c_jump', .*--prefix TEXT-"):
        merge(first, second)
    assert open_store(first).manifest.version == version
    with pytest.raises(StoreError, match="is the store itself"):
        merge(second.path, second)


def test_stores_of_other_rates_or_columns_are_refused(first: Path, tmp_path: Path, second: Store) -> None:
    with StoreWriter.open(tmp_path / "fast", BODY, 60.0) as writer:
        writer.commit()
    with pytest.raises(StoreError, match="holds frames at 60 Hz"):
        merge(first, open_store(tmp_path / "fast"))
    with StoreWriter.open(first, BODY) as writer:
        writer.declare_columns({"style": TakeColumn("DOUBLE", "quality")})
        writer.commit()
    with pytest.raises(StoreError, match="its takes have a column 'style'"):
        merge(first, second)


def test_a_merge_that_is_stopped_leaves_nothing(first: Path, second: Store) -> None:
    version = open_store(first).manifest.version

    def stop(takes: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), StoreWriter.open(first, BODY) as writer:
        merge_store(writer, second, progress=stop)
    with StoreWriter.open(first, BODY):
        parts = {f"frames/{file.name}" for file in (first / "frames").iterdir()}
    store = open_store(first)
    assert store.manifest.version == version
    assert parts == {part.path for part in store.manifest.frames}
