"""verify finds what is wrong with a store, and nothing in a sound one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from kinedex.storage.index.builder import build_index
from kinedex.storage.snapshot.manifest import Manifest, Part
from kinedex.storage.snapshot.manifest_files import manifest_path
from kinedex.storage.snapshot.parts import publish_part
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.verification import verify
from kinedex.storage.store.writer import StoreWriter
from tests.storage.made_up import BODY, add, make_store, write_frames


@pytest.fixture
def store(tmp_path: Path) -> Store:
    make_store(tmp_path / "store", {"a": 30, "b": 20, "c": 0})
    with StoreWriter.open(tmp_path / "store", BODY) as writer:
        add(writer, {"b": 25}, edition=1)
        writer.commit()
    store = open_store(tmp_path / "store")
    build_index(store)
    return store


def problems(store: Store) -> str:
    return "\n".join(map(str, verify(store)))


def test_a_sound_store_has_no_findings(store: Store) -> None:
    assert problems(store) == ""
    checked = list[None]()
    assert verify(store, lambda: checked.append(None)) == []
    assert len(checked) == len(store.manifest.parts)


def test_a_cut_off_a_changed_and_a_missing_part_are_found(store: Store) -> None:
    part = store.path / store.manifest.frames[0].path
    whole = part.read_bytes()
    part.write_bytes(whole[:-1])
    assert f"{part.name}: has {len(whole) - 1} bytes" in problems(store)
    part.write_bytes(whole[:1000] + bytes([whole[1000] ^ 1]) + whole[1001:])
    assert f"{part.name}: its content does not fit its checksum" in problems(store)
    part.unlink()
    assert f"{part.name}: is missing; `kinedex repair" in problems(store)


def rewritten(store: Store, change: Callable[[pa.Table], pa.Table]) -> Store:
    """The store with its first frames part changed, checksum and all."""
    old = store.manifest.frames[0]
    table = change(pq.read_table(store.path / old.path))
    temporary = store.path / "frames" / ".tmp-test.parquet"
    pq.write_table(table, temporary)
    part = publish_part(store.path, temporary, "frames", table.num_rows, old.take_ids)
    part = replace(part, dropped=old.dropped, dropped_rows=old.dropped_rows)
    return Store(store.path, replace(store.manifest, frames=(part, *store.manifest.frames[1:])))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda table: table.slice(0, 10), "take 1 has 10 frames, takes records 30"),
        (lambda table: table.take([1, 0, *range(2, 50)]), "take 1 lacks frame 0"),
        (lambda table: table.take([*range(30, 50), *range(30)]), "not sorted by take_id"),
        (lambda table: table.drop_columns("word"), "column word is missing"),
        (lambda table: table.replace_schema_metadata({}), "metadata kinedex.kind is nothing, expected frames"),
        (lambda table: table.set_column(0, "take_id", pa.array([1] * 30 + [9] * 20)), "holds take 9"),
    ],
)
def test_rows_that_are_not_as_they_should_be_are_found(store: Store, change, message: str) -> None:
    assert message in problems(rewritten(store, change))


def test_a_take_that_is_live_twice_is_found(store: Store) -> None:
    twice = replace(store.manifest.frames[0], dropped=())
    manifest = replace(store.manifest, frames=(twice, *store.manifest.frames[1:]))
    assert "take 2 is live here and in" in problems(Store(store.path, manifest))


def test_a_wrong_count_of_dropped_rows_is_found(store: Store) -> None:
    wrong = replace(store.manifest.frames[0], dropped_rows=19)
    manifest = replace(store.manifest, frames=(wrong, *store.manifest.frames[1:]))
    assert "20 of its rows are of dropped takes, not 19" in problems(Store(store.path, manifest))


def without(parts: tuple[Part, ...], take: int) -> tuple[Part, ...]:
    return tuple(replace(part, dropped=(*part.dropped, take)) if take in part.take_ids else part for part in parts)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: replace(m, takes=without(m.takes, 1)), "take 1 has no row in takes"),
        (lambda m: replace(m, frames=without(m.frames, 1)), "take 1 has no frames"),
        (lambda m: replace(m, next_take_id=3), "next_take_id 3 is taken already"),
    ],
)
def test_takes_and_frames_that_differ_are_found(
    store: Store, change: Callable[[Manifest], Manifest], message: str
) -> None:
    assert message in problems(Store(store.path, change(store.manifest)))


def test_leftovers_and_a_stale_index_are_notes(store: Store) -> None:
    orphan = write_frames(store.path, {"x": (90, 12)})
    with_orphan = verify(store)
    assert [(finding.file, finding.fault) for finding in with_orphan] == [(orphan.path, False)]
    with StoreWriter.open(store.path, BODY) as writer:
        add(writer, {"d": 4})
        writer.commit()
    found = verify(open_store(store.path, at="newest"))
    assert ["stale" in finding.problem and not finding.fault for finding in found] == [True]


def test_a_changed_index_is_found(store: Store) -> None:
    file = store.index_path()
    content = file.read_bytes()
    file.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    assert "index.duckdb: its content does not fit its checksum; `kinedex repair" in problems(store)
    file.write_bytes(content[:-1])
    assert f"index.duckdb: the index is damaged: the file has {len(content) - 1} bytes" in problems(store)


def test_a_damaged_old_manifest_is_a_note(store: Store) -> None:
    manifest_path(store.path, 2).write_text("{")
    found = verify(store)
    assert [(finding.file, finding.fault) for finding in found] == [("manifest/000002.json", False)]
    assert "damaged" in found[0].problem
