"""The database file: a plain DuckDB client sees in it what kinedex shows, and polars in its scans."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import duckdb
import polars as pl
import pyarrow as pa
import pytest

from kinedex.catalog.sql.views import VIEWS, help_rows
from kinedex.ops.errors import KinedexError
from kinedex.storage.index.builder import build_index
from kinedex.storage.snapshot.schemas import result_schema
from kinedex.storage.store.database_file import write_database
from kinedex.storage.store.lazy_frames import SCANNED, scan
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.writer import StoreWriter
from tests.storage.made_up import BODY, add, make_store

CLIENT = """
import duckdb, sys
with duckdb.connect(sys.argv[1], read_only=True) as client:
    print(client.execute("SELECT count(*), max(rwrist.y) > 0 FROM frames JOIN takes USING (take_id)").fetchall())
    print(client.execute("SELECT count(*) > 0 FROM runs_where('relbow_bent')").fetchall())
    print(client.execute("SELECT pipeline, count(*) FROM annotations GROUP BY pipeline").fetchall())
"""


def annotate(writer: StoreWriter, pipeline: str, count: int) -> None:
    rows = [{"run": pipeline, "take_id": 1, "take": "a_walk", "class": "walk", "start": 3, "stop": 9}] * count
    table = pa.Table.from_pylist(rows, schema=result_schema("annotations"))
    writer.put_results("annotations", table, stage=f"{pipeline}/annotate", run=pipeline)


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """A store with replaced and removed takes, and with annotations of two pipelines."""
    path = make_store(tmp_path_factory.mktemp("files") / "it's [a] store", {"a_walk": 90, "b_kick": 40, "c_run": 20})
    with StoreWriter.open(path, BODY) as writer:
        add(writer, {"a_walk": 55}, edition=1)
        writer.drop_takes([writer.assign_take_ids(["c_run"])["c_run"]])
        annotate(writer, "first", 3)
        annotate(writer, "second", 2)
        writer.record_run("first")
        writer.commit()
    build_index(open_store(path, at="newest"))
    return open_store(path)


def test_all_views_and_macros_answer_as_kinedex_does(store: Store) -> None:
    with duckdb.connect(str(write_database(store)), read_only=True) as client:
        for view in VIEWS:
            ours = store.sql(f"FROM {view.name} ORDER BY ALL")
            theirs = client.sql(f"FROM {view.name} ORDER BY ALL").to_arrow_table()
            assert theirs.to_pylist() == ours.to_pylist(), view.name
            assert theirs.schema.names == ours.schema.names
        for name, _, _, example in help_rows():
            assert client.sql(example).to_arrow_table().num_rows == store.sql(example).num_rows, name
        assert client.execute("SELECT count(*) FROM all_annotations").fetchall() == [(5,)]


@pytest.mark.parametrize("python", [sys.executable, os.environ.get("KINEDEX_OTHER_DUCKDB", "")])
def test_another_process_opens_it_from_anywhere(store: Store, tmp_path: Path, python: str) -> None:
    if not python:
        pytest.skip("KINEDEX_OTHER_DUCKDB names no Python with another DuckDB")
    command = [python, "-c", CLIENT, str(write_database(store))]
    done = subprocess.run(command, check=True, capture_output=True, text=True, cwd=tmp_path, timeout=120)
    assert done.stdout.split("\n")[:3] == ["[(95, True)]", "[(True,)]", "[('first', 3)]"]


def test_it_follows_the_store_and_tells_where_it_does_not(store: Store, tmp_path: Path) -> None:
    path = tmp_path / "moved"
    shutil.copytree(store.path, path)
    file = write_database(open_store(path))

    def answer(query: str) -> list[tuple[object, ...]]:
        with duckdb.connect(str(file), read_only=True) as client:
            return client.execute(query).fetchall()

    with StoreWriter.open(path, BODY) as writer:
        annotate(writer, "first", 7)
        version = writer.commit().version
    assert answer("SELECT version, newest_version FROM store_version") == [(version, version)]
    assert answer("SELECT count(*) FROM annotations") == [(7,)]
    # written for a version that has its index, as kinedex shows it
    with StoreWriter.open(path, BODY) as writer:
        add(writer, {"d_jump": 30})
        newest = writer.commit().version
    assert answer("SELECT version, newest_version FROM store_version") == [(version, newest)]
    assert answer("SELECT count(*) FROM frames") == [(95,)]


def test_polars_scans_the_rows_that_count(store: Store) -> None:
    for view in SCANNED:
        ours = store.sql(f"FROM {view} ORDER BY ALL", polars=True)
        found = scan(store, view).collect()
        assert found.columns == ours.columns, view
        assert found.height == ours.height, view
    frames = scan(store, "frames").group_by("take_id").len().sort("take_id").collect()
    assert frames["len"].to_list() == [55, 40]
    assert set(scan(store, "annotations").collect()["pipeline"]) == {"first"}
    assert pl.read_parquet(str(next((store.path / "frames").iterdir())), glob=False).height > 95
    with pytest.raises(KinedexError, match="did you mean 'frames'"):
        scan(store, "frame")
