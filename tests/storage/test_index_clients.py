"""Other clients: the file of an index is all that they need, wherever it lies, whatever is attached beside it.

KINEDEX_OTHER_DUCKDB names a Python that has another DuckDB (1.5), to try the file with it too.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import duckdb
import pytest

from kinedex.catalog.sql.views import MACROS, VIEWS
from kinedex.storage.index.builder import build_index
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.writer import StoreWriter
from tests.storage.made_up import BODY, add, make_store

INDEX_VIEWS = [view.name for view in VIEWS if view.origin == "index"]
EXAMPLES = {
    macro.name: macro.example
    for macro in MACROS
    if macro.needs == "index"
    and not any(f"FROM {view.name}" in macro.example for view in VIEWS if view.origin != "index")
}
CLIENT = """
import duckdb, json, sys
with duckdb.connect(sys.argv[1], read_only=True) as client:
    print(json.dumps([repr(client.execute(query).fetchall()) for query in json.loads(sys.argv[2])]))
"""


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """A store whose index has several shards and has lost takes."""
    path = make_store(tmp_path_factory.mktemp("clients") / "store", {"a_walk": 90, "b_kick": 40, "c_none": 0})
    build_index(open_store(path, at="newest"), shard_frames=50)
    with StoreWriter.open(path, BODY) as writer:
        add(writer, {"a_walk": 55, "d_jump": 30}, edition=1)
        writer.commit()
    build_index(open_store(path, at="newest"), shard_frames=50)
    return open_store(path, at="newest")


def queries() -> list[str]:
    return [f"SELECT * FROM {view} ORDER BY ALL" for view in INDEX_VIEWS] + list(EXAMPLES.values())


@pytest.mark.parametrize("python", [sys.executable, os.environ.get("KINEDEX_OTHER_DUCKDB", "")])
def test_another_process_gets_the_same_answers(store: Store, tmp_path: Path, python: str) -> None:
    if not python:
        pytest.skip("KINEDEX_OTHER_DUCKDB names no Python with another DuckDB")
    file = tmp_path / "moved.duckdb"
    shutil.copyfile(store.index_path(), file)
    done = subprocess.run(
        [python, "-c", CLIENT, str(file), json.dumps(queries())],
        check=True,
        capture_output=True,
        text=True,
        cwd=tmp_path,
        timeout=240,
    )
    with duckdb.connect(str(store.index_path()), read_only=True) as here:
        assert json.loads(done.stdout) == [repr(here.execute(query).fetchall()) for query in queries()]


def test_the_file_says_what_the_store_says(store: Store) -> None:
    with duckdb.connect(str(store.index_path()), read_only=True) as client:
        for view in INDEX_VIEWS:
            if view != "help":
                ours = store.sql(f"SELECT * FROM {view} ORDER BY ALL")
                theirs = client.sql(f"SELECT * FROM {view} ORDER BY ALL").to_arrow_table()
                assert theirs.to_pylist() == ours.to_pylist(), view
                assert theirs.schema.names == ours.schema.names
        for name, example in EXAMPLES.items():
            assert client.sql(example).to_arrow_table().to_pylist() == store.sql(example).to_pylist(), name


def test_the_file_can_be_attached_under_any_name(store: Store) -> None:
    with duckdb.connect() as client:
        client.execute(f"ATTACH '{store.index_path()}' AS other (READ_ONLY)")
        count = client.execute("SELECT count(*) FROM other.word_runs").fetchall()
        assert count == [(store.sql("SELECT count(*) AS n FROM word_runs").column(0)[0].as_py(),)]
        client.execute("USE other")
        assert client.execute(EXAMPLES["rarest_words"]).fetchall()


def test_columns_have_the_types_that_are_documented(store: Store) -> None:
    with duckdb.connect(str(store.index_path()), read_only=True) as client:
        for view in VIEWS:
            if view.origin == "index":
                found = [(name, kind) for name, kind, *_ in client.execute(f"DESCRIBE {view.name}").fetchall()]
                assert found == [(column.name, column.type) for column in view.columns]
