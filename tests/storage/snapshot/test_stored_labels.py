"""Labels: statements of people, which are added and replaced, and never lost."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pytest

from kinedex.ops.errors import ParameterError, StoreError
from kinedex.storage.snapshot.manifest_files import read_newest
from kinedex.storage.store.compaction import compact
from kinedex.storage.store.garbage_collection import collect_garbage
from kinedex.storage.store.store import open_store
from kinedex.storage.store.verification import verify
from kinedex.storage.store.writer import StoreWriter
from tests.storage.made_up import BODY, add, make_store


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return make_store(tmp_path / "store", {"bd_walk": 50, "mm_run": 40})


def row(
    take: str = "bd_walk", label: str = "walk", start: int = 3, stop: int = 20, **more: object
) -> dict[str, object]:
    return {"take": take, "class": label, "start": start, "stop": stop, "origin": "drawn", **more}


def put(path: Path, *rows: dict[str, object]) -> list[dict[str, object]]:
    names = dict.fromkeys(name for one in rows for name in one)
    with StoreWriter.open(path, BODY) as writer:
        new = writer.put_labels(pa.Table.from_pylist([{name: one.get(name) for name in names} for one in rows]))
        writer.commit()
    return new.to_pylist()


def shown(path: Path, *, history: bool = False) -> list[tuple[object, ...]]:
    labels = open_store(path, at="newest").labels(history=history).to_pylist()
    return [(one["take"], one["class"], one["start"], one["stop"], one["verdict"]) for one in labels]


def test_labels_are_completed_and_read_in_order(path: Path) -> None:
    first, second = put(path, row(confidence=0.5, note="sure?"), row("mm_run", "run", annotator="ann"))
    labels = open_store(path, at="newest").labels().to_pylist()
    assert labels == [first, second]
    assert first["id"] != second["id"]
    assert first["checksum"] == "00" * 32
    assert first["created"] is not None
    assert shown(path) == [("bd_walk", "walk", 3, 20, "positive"), ("mm_run", "run", 3, 20, "positive")]


def test_a_row_replaces_a_row_and_history_keeps_both(path: Path) -> None:
    (first,) = put(path, row())
    (second,) = put(path, row(start=5, replaces=first["id"], origin="corrected"))
    assert shown(path) == [("bd_walk", "walk", 5, 20, "positive")]
    put(path, row(replaces=second["id"], verdict="withdrawn"))
    assert shown(path) == []
    assert len(shown(path, history=True)) == 3
    put(path, row(verdict="negative", origin="accepted"))
    assert shown(path) == [("bd_walk", "walk", 3, 20, "negative")]


def test_the_same_rows_can_be_put_twice(path: Path) -> None:
    first = put(path, row(), row("mm_run"))
    version = read_newest(path).version
    assert put(path, *first) == []
    assert read_newest(path).version == version


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (row(start=20), "0 <= start < stop"),
        (row(start=-1), "0 <= start < stop"),
        (row(origin="guessed"), "one of imported, accepted, corrected, drawn"),
        (row(verdict="maybe"), "one of positive, negative, withdrawn"),
        (row(replaces="nothing"), "the id of another label"),
        (row(verdict="withdrawn"), "the id of the label that it withdraws"),
        (row(label=None), "must be given"),
        (row(colour="red"), "must be a table with columns"),
    ],
)
def test_a_wrong_label_is_refused_by_name(path: Path, bad: dict[str, object], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        put(path, row(), bad)
    assert shown(path) == []


def test_nothing_removes_labels(path: Path) -> None:
    put(path, row(), row("mm_run", "run"))
    expected = shown(path)
    with StoreWriter.open(path, BODY) as writer:
        add(writer, {"bd_walk": 30}, edition=1)  # re-ingest
        writer.commit()
        writer.drop_takes([open_store(path, at="newest").take_id("mm_run")])  # prune
        writer.commit()
        compact(writer, target_bytes=1)
    collect_garbage(path, keep=1)
    assert shown(path) == expected
    assert verify(open_store(path, at="newest")) == []
    with StoreWriter.open(path, BODY) as writer:
        add(writer, {"mm_run": 40})
        writer.commit()
    assert shown(path) == expected


def test_many_commits_make_few_parts(path: Path) -> None:
    with StoreWriter.open(path, BODY) as writer:
        for number in range(40):
            writer.put_labels(pa.Table.from_pylist([row(label=f"c{number:02}")]))
            writer.commit()
    parts = read_newest(path).labels
    assert len(parts) <= 6
    assert [one[1] for one in shown(path)] == [f"c{number:02}" for number in range(40)]
    assert verify(open_store(path, at="newest")) == []


def test_a_damaged_part_of_labels_is_an_error_and_is_found(path: Path) -> None:
    put(path, row())
    part = path / read_newest(path).labels[0].path
    content = bytearray(part.read_bytes())
    content[len(content) // 2] ^= 1
    part.write_bytes(content)
    with pytest.raises(StoreError, match=f"{part.name}: the part is damaged"):
        open_store(path, at="newest").labels()
    assert [finding.file for finding in verify(open_store(path, at="newest")) if finding.fault] == [
        f"labels/{part.name}"
    ]
