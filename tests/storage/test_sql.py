"""SQL over a store: it reads, it cannot write, and its errors say what is there."""

from __future__ import annotations

import pickle
import shutil
from pathlib import Path

import pyarrow as pa
import pytest

from ops.errors import KinedexError
from storage import index
from storage.schemas import RESULT_KINDS, result_schema
from storage.store import Store, open_store
from storage.writer import StoreWriter
from tests.storage.made_up import BODY, add, arrays, make_store


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    path = tmp_path_factory.mktemp("sql")
    make_store(path, {"a_one": 60, "b_two": 30})
    with StoreWriter.open(path, BODY) as writer:
        add(writer, {"a_one": 45}, edition=1)
        writer.commit()
    store = open_store(path)
    index.build(store)
    return store


@pytest.mark.parametrize(
    "query",
    [
        "SELECT 1",
        "-- a comment\n/* another */ FROM takes;",
        "WITH a AS (SELECT 1) FROM a",
        "VALUES (1)",
        "(SELECT 1)",
        "PIVOT features ON feature_set USING count(*)",
        "DESCRIBE frames",
        "SUMMARIZE vocabulary",
        "SHOW TABLES",
        "EXPLAIN SELECT 1",
        "EXPLAIN ANALYZE SELECT 1",
        "PRAGMA version",
    ],
)
def test_what_reads_is_run(store: Store, query: str) -> None:
    assert store.sql(query).num_rows > 0


@pytest.mark.parametrize(
    "query",
    [
        "INSERT INTO takes SELECT * FROM takes",
        "DELETE FROM word_runs",
        "CREATE TABLE memory.t AS SELECT 1",
        "DROP VIEW frames",
        "COPY (SELECT 1) TO '{file}'",
        "COPY (PIVOT features ON feature_set USING count(*)) TO '{file}'",
        "EXPLAIN ANALYZE COPY (SELECT 1) TO '{file}'",
        "EXPLAIN ANALYZE /* or so */ COPY (SELECT 1) TO '{file}'",
        "EXPLAIN (ANALYZE, FORMAT json) COPY (SELECT 1) TO '{file}'",
        "ATTACH '{file}' AS other",
        "SET threads = 1",
        "USE memory",
        "SELECT 1; DROP VIEW frames",
        "",
    ],
)
def test_what_would_write_is_refused(store: Store, tmp_path: Path, query: str) -> None:
    file = tmp_path / "written"
    with pytest.raises(KinedexError):
        store.sql(query.format(file=file))
    assert not file.exists()


def test_parameters_fill_a_query(store: Store) -> None:
    assert store.sql("SELECT name FROM takes WHERE frames > ?", [40]).to_pylist() == [{"name": "a_one"}]
    assert store.sql("SELECT name FROM takes WHERE frames < $n", {"n": 40}).to_pylist() == [{"name": "b_two"}]


def test_a_misspelt_view_is_answered_with_the_nearest_and_all(store: Store) -> None:
    with pytest.raises(KinedexError, match=r"did you mean 'word_runs'\?\n.*annotations, cooccurrence"):
        store.sql("FROM word_run")
    with pytest.raises(KinedexError, match="did you mean 'runs_where'"):
        store.sql("FROM runs_were(1)")
    with pytest.raises(KinedexError, match='Referenced column "nam" not found'):
        store.sql("SELECT nam FROM takes")
    with pytest.raises(KinedexError, match="syntax error"):
        store.sql("SELEC 1")


def test_frames_show_live_rows_only(store: Store) -> None:
    found = store.sql(
        "SELECT word, rwrist.y AS y, root_orientation.w AS w FROM frames WHERE take_id = 1 ORDER BY frame"
    )
    positions, _, words = arrays("a_one", 45, 1)
    assert found.column("word").to_pylist() == words.tolist()
    assert found.column("y")[3].as_py() == pytest.approx(positions[BODY.joints.index("rwrist"), 1, 3], rel=1e-6)


@pytest.mark.parametrize("kind", RESULT_KINDS)
def test_a_kind_without_results_is_an_empty_view_of_the_right_types(store: Store, kind: str) -> None:
    found = store.sql(f"FROM {kind}")
    assert found.num_rows == 0
    assert [field.type for field in found.schema if not pa.types.is_timestamp(field.type)] == [
        field.type for field in result_schema(kind) if not pa.types.is_timestamp(field.type)
    ]
    assert found.schema.names == result_schema(kind).names


def test_results_stand_in_their_view(tmp_path: Path) -> None:
    make_store(tmp_path, {"a": 9})
    row = {"query": "q", "take_id": 1, "take": "a", "start": 2, "stop": 5, "start_seconds": 0.1, "stop_seconds": 0.2}
    with StoreWriter.open(tmp_path, BODY) as writer:
        for run, stage in (("r1", "p/s"), ("r2", "p/s"), ("r3", "q/s")):
            table = pa.Table.from_pylist([row], schema=result_schema("hits").remove(0))
            writer.put_results("hits", table, stage=stage, run=run)
        writer.commit()
    assert open_store(tmp_path).sql("SELECT run FROM hits ORDER BY run").column(0).to_pylist() == ["r2", "r3"]


def test_nothing_run_on_a_connection_changes_the_store(store: Store) -> None:
    before = {path: path.stat().st_mtime_ns for path in store.path.rglob("*") if path.is_file()}
    with store.connect(threads=1, memory_mb=256) as connection:
        connection.execute("CREATE TEMP TABLE mine AS SELECT * FROM word_runs LIMIT 3")
        with pytest.raises(Exception, match="read-only"):
            connection.execute("DELETE FROM word_runs")
    assert {path: path.stat().st_mtime_ns for path in store.path.rglob("*") if path.is_file()} == before


def test_sql_works_wherever_the_store_is_moved(store: Store, tmp_path: Path) -> None:
    moved = tmp_path / "it's here"
    shutil.copytree(store.path, moved)
    assert open_store(moved).sql("SELECT count(*) AS n FROM frames JOIN takes USING (take_id)").to_pylist() == [
        {"n": 75}
    ]


def test_a_store_travels_to_a_worker(store: Store) -> None:
    store.sql("SELECT 1")
    there = pickle.loads(pickle.dumps(store))
    assert there.manifest == store.manifest
    assert there.sql("SELECT count(*) AS n FROM takes").to_pylist() == [{"n": 2}]


def test_a_broken_part_is_named(tmp_path: Path) -> None:
    store = open_store(make_store(tmp_path, {"a": 9}))
    part = tmp_path / store.manifest.frames[0].path
    part.write_bytes(part.read_bytes()[:-9])
    with pytest.raises(KinedexError, match=f"parts of frames cannot be read: .*{part.name}.* see `kinedex verify`"):
        store.sql("FROM takes")


def test_a_closed_store_opens_again(store: Store) -> None:
    with open_store(store.path) as other:
        other.sql("SELECT 1")
    assert other.sql("SELECT 1 AS one").to_pylist() == [{"one": 1}]
