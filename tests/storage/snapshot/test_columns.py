"""Declared columns of takes, and parts that lack columns which were added since."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from kinedex.ops.errors import StoreError
from kinedex.storage.index.builder import build_index
from kinedex.storage.snapshot.manifest import ResultPart
from kinedex.storage.snapshot.manifest_files import publish, read_newest
from kinedex.storage.snapshot.parts import write_part
from kinedex.storage.snapshot.schemas import TakeColumn, column_problem, result_schema, takes_schema
from kinedex.storage.store.compaction import compact
from kinedex.storage.store.store import open_store
from kinedex.storage.store.verification import verify
from kinedex.storage.store.writer import StoreWriter
from tests.storage.made_up import BODY, make_store, take_row, write_frames

STYLE, MASS = TakeColumn("VARCHAR", "pattern"), TakeColumn("DOUBLE", "metadata", "kg", "mass of the actor")
COLUMNS = {"style": STYLE, "mass": MASS}


def add_styled(writer: StoreWriter, name: str, frames: int = 20, **columns: object) -> None:
    """Add a take whose row has declared columns."""
    ids = writer.assign_take_ids([name])
    part = write_frames(writer.path, {name: (ids[name], frames)})
    row = take_row(ids[name], name, frames) | columns
    writer.add_takes(pa.Table.from_pylist([row], schema=writer.takes_schema), part)


@pytest.fixture(params=[True, False], ids=["indexed", "not indexed"])
def path(tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    """A store with a take from before the columns, and two with them."""
    store = make_store(tmp_path / "store", {"aa_old": 30})
    with StoreWriter.open(store, BODY) as writer:
        writer.declare_columns(COLUMNS)
        add_styled(writer, "bb_new", style="angry", mass=71.5, known=5)
        add_styled(writer, "cc_new", style="sad")
        writer.commit()
    if request.param:
        build_index(open_store(store, at="newest"))
    return store


def test_declared_columns_are_columns_everywhere(path: Path) -> None:
    store = open_store(path, at="newest")
    assert store.sql("SELECT name, mass FROM takes WHERE style = 'angry'").to_pylist() == [
        {"name": "bb_new", "mass": 71.5}
    ]
    assert store.takes(where="style IS NULL")["name"].to_list() == ["aa_old"]
    assert store.takes()["style"].to_list() == [None, "angry", "sad"]
    assert store.sql("SELECT known FROM takes ORDER BY name").to_pylist() == [
        {"known": None}, {"known": 5}, {"known": None},
    ]  # fmt: skip
    assert verify(store) == []


def test_some_columns_of_takes_are_read_without_the_others(path: Path) -> None:
    whole = open_store(path, at="newest").take_rows
    some = open_store(path, at="newest")
    for names in (("mass",), ("style", "name", "known"), ("warnings", "take_id")):
        assert some.take_columns(*names).equals(whole.select(names))
    assert some.take_ids == {"aa_old": 1, "bb_new": 2, "cc_new": 3}
    assert "take_rows" not in vars(some)
    with StoreWriter.open(path, BODY) as writer:
        writer.drop_takes([2])
        writer.commit()
    assert open_store(path, at="newest").take_columns("style").column("style").to_pylist() == [None, "sad"]


def test_a_column_that_is_declared_after_the_index_is_seen_at_once(path: Path) -> None:
    with StoreWriter.open(path, BODY) as writer:
        writer.declare_columns({"tags": TakeColumn("VARCHAR[]", "metadata")})
        rows = writer.store.take_rows.filter(pa.compute.equal(writer.store.take_rows.column("name"), "aa_old"))
        row = rows.to_pylist()[0] | {"tags": ["indoor", "slow"], "mass": 60.0}
        writer.restate_takes(pa.Table.from_pylist([row], schema=writer.takes_schema))
        writer.commit()
    store = open_store(path, at="newest")
    assert store.sql("SELECT name FROM takes WHERE list_contains(tags, 'slow')").to_pylist() == [{"name": "aa_old"}]
    assert store.sql("SELECT sum(mass) AS mass FROM takes").to_pylist() == [{"mass": 131.5}]
    with store.connect() as connection:
        assert connection.execute("SELECT count(tags) FROM takes").fetchall() == [(1,)]


def test_compaction_keeps_declared_columns(path: Path) -> None:
    with StoreWriter.open(path, BODY) as writer:
        for number in range(10):
            add_styled(writer, f"dd_{number}", 5, style="calm")
            writer.commit()
        assert compact(writer).takes_before > 0
    store = open_store(path, at="newest")
    assert store.takes(where="style = 'calm'").height == 10
    assert store.takes(where="mass > 70")["name"].to_list() == ["bb_new"]
    assert not [finding for finding in verify(store) if finding.fault]


@pytest.mark.parametrize(
    ("name", "column", "problem"),
    [
        ("frames", STYLE, "every store has a column of this name"),
        ("Frames", STYLE, "every store has a column of this name"),
        ("Style", STYLE, "does not distinguish"),
        ("style", MASS, "has a column of this name already"),
        ("a\nb", STYLE, "must be printable"),
        (" ", STYLE, "must be printable"),
        ("x", TakeColumn("BLOB", "pattern"), "must be one of VARCHAR"),
    ],
)
def test_columns_that_cannot_be_declared(tmp_path: Path, name: str, column: TakeColumn, problem: str) -> None:
    assert problem in str(column_problem(name, column, COLUMNS))
    with StoreWriter.open(tmp_path, BODY) as writer:
        writer.declare_columns(COLUMNS)
        with pytest.raises(StoreError, match=problem):
            writer.declare_columns({name: column})


def test_an_undeclared_column_is_refused(tmp_path: Path) -> None:
    with StoreWriter.open(tmp_path, BODY) as writer:
        rows = pa.Table.from_pylist([take_row(1, "a", 5)], schema=takes_schema())
        with pytest.raises(StoreError, match="no column 'style'"):
            writer.add_takes(rows.append_column("style", pa.array(["x"])), [])


@pytest.mark.parametrize("indexed", [True, False])
def test_results_that_lack_a_new_column_have_nulls_in_sql_and_in_tables(tmp_path: Path, indexed: bool) -> None:
    path = make_store(tmp_path / "store", {"aa_old": 30})
    if indexed:
        build_index(open_store(path, at="newest"))
    schema = result_schema("annotations")
    value = {"run": "r", "take": "aa_old", "start": 1, "stop": 5, "cost": 0.25, "method": "best"}
    rows = pa.Table.from_pylist([value], schema=schema)
    with StoreWriter.open(path, BODY) as writer:
        writer.put_results("annotations", rows, stage="p/annotate", run="r")
        writer.commit()
    narrow = rows.select(schema.names[: schema.names.index("method")])
    part = write_part(path, "results/annotations", narrow)
    old = ResultPart(part.path, part.rows, part.bytes, part.sha256, "p/older", "r", part.xxh3, len(narrow.column_names))
    manifest = read_newest(path)
    both = {"annotations": (*manifest.results["annotations"], old)}
    publish(path, replace(manifest, version=manifest.version + 1, results=both))
    assert schema.names[-1] not in pq.read_schema(path / part.path).names
    store = open_store(path, at="newest")
    expected = [{"cost": 0.25, "method": None}, {"cost": 0.25, "method": "best"}]
    assert store.sql("SELECT cost, method FROM annotations ORDER BY method NULLS FIRST").to_pylist() == expected
    table = store.result("annotations")
    assert table.schema.names == schema.names
    assert sorted(table.column("method").to_pylist(), key=str) == [None, "best"]
    pieces = list(store.result_pieces("annotations", both["annotations"]))
    assert {name for piece in pieces for name in piece.schema.names} == set(schema.names)
    assert verify(store) == []
