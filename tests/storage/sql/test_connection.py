"""SQL over a store: it reads, it cannot write, and its errors list what is there."""

from __future__ import annotations

import os
import pickle
import shutil
import signal
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import duckdb
import pyarrow as pa
import pytest

from kinedex.catalog.sql.columns import ORIGIN
from kinedex.ops.errors import KinedexError, StoreError
from kinedex.storage.index.builder import build_index
from kinedex.storage.index.generations import current_generation
from kinedex.storage.snapshot.manifest import Manifest
from kinedex.storage.snapshot.schemas import RESULT_KINDS, result_schema
from kinedex.storage.sql.queries import split_statements
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.writer import StoreWriter
from tests.storage.made_up import BODY, add, arrays, make_store


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    path = tmp_path_factory.mktemp("sql")
    make_store(path, {"a_one": 60, "b_two": 30})
    with StoreWriter.open(path, BODY) as writer:
        add(writer, {"a_one": 45}, edition=1)
        writer.commit()
    store = open_store(path)
    build_index(store)
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
        "PRAGMA table_info('takes');",
        "EXPLAIN (FORMAT json) SELECT 1",
        "EXPLAIN ANALYZE (SELECT 1)",
        'SELECT sum(copy) AS ü FROM (SELECT 1 AS copy, 2 AS "insert") WHERE (copy) < 2 -- (delete)',
        "SELECT ')copy (insert'",
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
        "-- nothing but a comment",
        "WITH x AS (COPY (SELECT 1) TO '{file}') SELECT * FROM x",
        "WITH ü AS (SELECT 'ü'), x AS MATERIALIZED (/* ü */ COPY (SELECT 1) TO '{file}') SELECT * FROM x",
        "EXPLAIN ANALYZE WITH x AS (COPY (SELECT 1) TO '{file}') SELECT * FROM x",
        "WITH x AS (INSERT INTO takes SELECT * FROM takes) SELECT 1",
        "WITH x AS (WITH y AS (SELECT 1) DELETE FROM takes) SELECT 1",
        "WITH x AS (UPDATE takes SET name = '') SELECT 1",
        "WITH x AS (TRUNCATE takes) SELECT 1",
        "PRAGMA import_database('{file}')",
        "PRAGMA copy_database(idx, memory)",
        "PRAGMA disable_optimizer",
        "PRAGMA database_size = 1",
        "CALL enable_logging(storage = 'file', storage_path = '{file}')",
        "FROM enable_logging(storage = 'file', storage_path = '{file}')",
        "FROM system.main.\"Enable_Logging\" /* ( */ (storage = 'file', storage_path = '{file}')",
        "FROM query('FROM enable_logging(storage = ''file'', storage_path = ''{file}'')')",
        "CALL enable_profiling(save_location = '{file}')",
        "FROM enable_profiling(save_location = '{file}')",
    ],
)
def test_what_would_write_is_refused(store: Store, tmp_path: Path, query: str) -> None:
    file = tmp_path / "written"
    with pytest.raises(KinedexError, match=r"only queries that read|only these PRAGMAs|one SQL statement"):
        store.sql(query.format(file=file))
    store.sql("SELECT 1")
    assert not file.exists()


def test_settings_of_queries_are_locked_whatever_gets_around_the_words(store: Store, tmp_path: Path) -> None:
    with open_store(store.path) as other, other._connection() as first, other._connection() as second:
        for connection in (first.connection, second.connection):
            with pytest.raises(duckdb.Error, match="locked"):
                connection.execute(f"CALL enable_logging(storage = 'file', storage_path = '{tmp_path / 'log'}')")
    assert not (tmp_path / "log").exists()


def test_queries_read_other_files_only_in_folders_that_were_opened(store: Store, tmp_path: Path) -> None:
    opened, closed = tmp_path / "opened", tmp_path / "closed"
    for folder in (opened, closed):
        folder.mkdir()
        (folder / "actors.csv").write_text("actor,age\nbd,31\n")
    wanted = [{"actor": "bd", "age": 31}]
    for query in ("FROM read_csv('{}/actors.csv')", "FROM '{}/actors.csv'", "FROM read_csv('{}/*.csv')"):
        with pytest.raises(KinedexError, match=r"--allow-files DIR.*files=\[…\]"):
            store.sql(query.format(opened))
        with open_store(store.path, files=[opened]) as other:
            assert other.sql(query.format(opened)).to_pylist() == wanted
            with pytest.raises(KinedexError, match=r"closed.*--allow-files DIR"):
                other.sql(query.format(closed))
            assert pickle.loads(pickle.dumps(other)).sql(query.format(opened)).to_pylist() == wanted


def test_a_folder_of_the_store_that_is_a_link_is_opened_by_name(store: Store, tmp_path: Path) -> None:
    copy, moved = tmp_path / "store", tmp_path / "other-disk"
    shutil.copytree(store.path, copy)
    shutil.move(copy / "frames", moved)
    (copy / "frames").symlink_to(moved)
    with open_store(copy) as other, pytest.raises(KinedexError, match=r"other-disk.*--allow-files DIR"):
        other.sql("SELECT count(*) FROM frames")
    with open_store(copy, files=[moved]) as other:
        assert other.sql("SELECT count(*) AS n FROM frames").to_pylist()[0]["n"] > 0


def test_a_name_is_never_a_variable_of_the_program(store: Store) -> None:
    secrets = pa.table({"key": [1]})
    with store._connection() as first, store._connection() as second:
        for connection in (first.connection, second.connection, store.connect()):
            with pytest.raises(duckdb.CatalogException, match="secrets"):
                connection.sql("SELECT * FROM secrets")
    with pytest.raises(KinedexError, match="no view or macro is named 'secrets'"):
        store.sql("SELECT * FROM secrets")
    assert secrets.num_rows == 1


def test_parameters_fill_a_query(store: Store) -> None:
    assert store.sql("SELECT name FROM takes WHERE frames > ?", [40]).to_pylist() == [{"name": "a_one"}]
    assert store.sql("SELECT name FROM takes WHERE frames < $n", {"n": 40}).to_pylist() == [{"name": "b_two"}]


def test_a_misspelt_view_is_answered_with_the_nearest_and_all(store: Store) -> None:
    with pytest.raises(KinedexError, match=r"did you mean 'word_runs'\?\n.*annotations, archive_poses, cameras"):
        store.sql("FROM word_run")
    with pytest.raises(KinedexError, match="did you mean 'runs_where'"):
        store.sql("FROM runs_were(1)")
    for call in ("SELECT getenv('HOME')", "FROM getenv('HOME')"):
        with pytest.raises(KinedexError, match=r"^no function or macro is named 'getenv'\n"):
            store.sql(call)
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
    stored = [field for field in result_schema(kind) if field.name not in ORIGIN]
    assert found.schema.names == [*(field.name for field in stored), *ORIGIN]
    types = [*(field.type for field in stored), *(pa.string() for _ in ORIGIN)]
    assert [kind for kind in found.schema.types if not pa.types.is_timestamp(kind)] == [
        kind for kind in types if not pa.types.is_timestamp(kind)
    ]


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
            connection.execute("DELETE FROM stored_feature_runs")
    assert {path: path.stat().st_mtime_ns for path in store.path.rglob("*") if path.is_file()} == before


def test_sql_works_wherever_the_store_is_moved(store: Store, tmp_path: Path) -> None:
    moved = tmp_path / "it's here"
    shutil.copytree(store.path, moved)
    assert open_store(moved).sql("SELECT count(*) AS n FROM frames JOIN takes USING (take_id)").to_pylist() == [
        {"n": 75}
    ]


@pytest.mark.parametrize("folder", ["class=walk", "take_id=7", "[ab]", "st*r", "word=ü"])
def test_nothing_is_read_out_of_the_path_of_a_store(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, folder: str
) -> None:
    monkeypatch.chdir(tmp_path)
    for other in ("a", "star"):
        make_store(tmp_path / other / "store", {"b_take": 9})
    path = make_store(Path(folder) / "store", {"b_take": 9})
    with StoreWriter.open(path, BODY) as writer:
        row = {"take_id": 1, "take": "b_take", "class": "own", "start": 2, "stop": 5}
        table = pa.Table.from_pylist(
            [dict.fromkeys(result_schema("annotations").names[1:]) | row],
            schema=result_schema("annotations").remove(0),
        )
        writer.put_results("annotations", table, stage="p/annotate", run="r")
        writer.commit()
    store = open_store(path)
    for index_too in (False, True):
        if index_too:
            build_index(store)
            store.close()
        assert store.sql("SELECT class FROM annotations").to_pylist() == [{"class": "own"}]
        assert store.sql("SELECT name, class FROM takes").to_pylist() == [{"name": "b_take", "class": None}]
        found = store.sql("SELECT take_id, word FROM frames ORDER BY frame")
        assert found.column("word").to_pylist() == arrays("b_take", 9)[2].tolist()
        assert set(found.column("take_id").to_pylist()) == {1}


def test_replaced_and_dropped_takes_are_gone_from_every_part_in_one_scan(tmp_path: Path) -> None:
    path = make_store(tmp_path / "store", {"whole": 5})
    for part in range(6):
        with StoreWriter.open(path, BODY) as writer:
            add(writer, {f"{part}_replaced": 4, f"{part}_dropped": 3, f"{part}_kept": 2})
            writer.commit()
    with StoreWriter.open(path, BODY) as writer:
        add(writer, {f"{part}_replaced": 6 for part in range(6)}, edition=1)
        ids = writer.assign_take_ids([f"{part}_dropped" for part in range(6)])
        writer.drop_takes(ids.values())
        writer.commit()
    store = open_store(path)
    names = {f"{part}_{what}": frames for part in range(6) for what, frames in (("replaced", 6), ("kept", 2))}
    expected = {store.take_id(name): frames for name, frames in (names | {"whole": 5}).items()}
    found = store.sql("SELECT take_id, count(*) AS n, count(DISTINCT frame) AS d FROM frames GROUP BY 1").to_pylist()
    assert {row["take_id"]: (row["n"], row["d"]) for row in found} == {k: (n, n) for k, n in expected.items()}
    words = store.sql("SELECT word FROM frames WHERE take_id = ? ORDER BY frame", [store.take_id("3_replaced")])
    assert words.column(0).to_pylist() == arrays("3_replaced", 6, 1)[2].tolist()
    assert store.sql("SELECT name FROM takes ORDER BY 1").column(0).to_pylist() == sorted([*names, "whole"])
    plan = store.sql("EXPLAIN SELECT count(*) FROM frames").column(1)[0].as_py()
    assert plan.count("READ_PARQUET") == 2  # the parts with tombstones, and those without
    assert open_store(path).sql("DESCRIBE frames").column(0).to_pylist()[:2] == ["take_id", "frame"]


def test_an_index_that_is_damaged_is_named_with_the_way_out(tmp_path: Path) -> None:
    store = open_store(make_store(tmp_path / "store", {"a_one": 600}))
    file = build_index(store) / "index.duckdb"
    whole = file.read_bytes()
    file.write_bytes(b"\0" * len(whole))
    with pytest.raises(StoreError, match=r"index\.duckdb: the index cannot be read: .*kinedex repair"):
        store.sql("SELECT 1")
    file.write_bytes(whole[:12288] + bytes(255 - byte for byte in whole[12288:]))
    with pytest.raises(KinedexError, match="kinedex repair"):
        store.sql("SELECT count(word), max(start) FROM word_runs")


def test_an_index_that_is_replaced_while_it_is_opened_is_found_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = open_store(make_store(tmp_path / "store", {"a_one": 60}))
    generation = build_index(store)
    current = current_generation
    asked: list[Path | None] = []

    def removed_once(path: Path, manifest: Manifest) -> Path | None:
        asked.append(current(path, manifest))
        if len(asked) == 1:
            generation.rename(generation.with_name("gen-000009"))
        return asked[-1]

    monkeypatch.setattr("kinedex.storage.sql.connection.current_generation", removed_once)
    assert store.sql("SELECT count(*) AS n FROM vocabulary").column(0)[0].as_py() > 0
    assert [path and path.name for path in asked] == ["gen-000002", "gen-000009"]


def test_a_store_travels_to_a_worker(store: Store) -> None:
    store.sql("SELECT 1")
    there = pickle.loads(pickle.dumps(store))
    assert there.manifest == store.manifest
    assert there.sql("SELECT count(*) AS n FROM takes").to_pylist() == [{"n": 2}]


def test_a_broken_part_is_named(tmp_path: Path) -> None:
    store = open_store(make_store(tmp_path, {"a": 9}))
    part = tmp_path / store.manifest.frames[0].path
    part.write_bytes(part.read_bytes()[:-9])
    with pytest.raises(StoreError, match=f"{part.name}: the part is damaged.* `kinedex repair"):
        store.sql("FROM frames")
    assert store.sql("FROM takes").num_rows == 1, "a statement that does not read the part"


def test_views_are_made_when_statements_need_them(store: Store) -> None:
    def made() -> set[str]:
        with other._connection() as lent:
            rows = lent.connection.execute("SELECT view_name FROM duckdb_views() WHERE temporary AND NOT internal")
            return {name for (name,) in rows.fetchall()}

    with open_store(store.path) as other:
        other.sql("SELECT count(*) FROM takes")
        assert not made()
        other.sql("SELECT count(*) FROM annotated_takes")
        assert "annotated_takes" in made()
        assert "metrics" not in made()
        shown = {row["name"] for row in other.sql("SHOW TABLES").to_pylist()}
        assert shown == {row["name"] for row in other.connect().sql("SHOW TABLES").to_arrow_table().to_pylist()}


def test_ctrl_c_stops_a_query_and_the_store_goes_on(store: Store) -> None:
    # a shell that runs the tests in the background has it ignored
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    timer = threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        store.sql("SELECT count(*) FROM range(1000000) AS a, range(40000) AS b WHERE a.range % 7 = b.range % 5")
    timer.join()
    signal.signal(signal.SIGINT, before)
    assert store.sql("SELECT 1 AS one").to_pylist() == [{"one": 1}]


def test_a_thread_asks_as_well(store: Store) -> None:
    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(store.sql, "SELECT 1 AS one").result().to_pylist() == [{"one": 1}]


def test_many_threads_ask_one_store_and_are_refused_what_would_write(store: Store) -> None:
    build_index(store)
    queries = ["SELECT count(*) AS n FROM word_runs", "FROM timeline('a_one')", "SELECT count(*) AS n FROM frames"] * 8
    expected = [open_store(store.path).sql(query) for query in queries]
    secrets = pa.table({"key": [1]})
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(store.sql, queries)) == expected
        for refused in pool.map(
            lambda query: _refusal(store, query), ["CREATE TABLE t AS SELECT 1", "FROM secrets"] * 8
        ):
            assert "only queries that read" in refused or "no view or macro is named 'secrets'" in refused
        assert list(pool.map(lambda _: _closed(store).sql(queries[0]), range(8))) == expected[:1] * 8
    assert secrets.num_rows == 1


def _closed(store: Store) -> Store:
    store.close()
    return store


def _refusal(store: Store, query: str) -> str:
    with pytest.raises(KinedexError) as refused:
        store.sql(query)
    return str(refused.value)


def test_ctrl_c_stops_the_query_of_its_thread_only(store: Store) -> None:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    timer = threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT))
    long = "SELECT count(*) AS n FROM range(20000) AS a, range({}) AS b WHERE a.range % 7 = b.range % 5"
    with ThreadPoolExecutor(1) as pool:
        other = pool.submit(store.sql, long.format(20_000))
        store.sql("SELECT 1")  # the views of this thread's connection are there when the signal comes
        timer.start()
        with pytest.raises(KeyboardInterrupt):
            store.sql(long.format(10_000_000))
        timer.join()
        signal.signal(signal.SIGINT, before)
        assert other.result().num_rows == 1


@pytest.mark.parametrize(
    ("typed", "whole", "rest"),
    [
        ("", [], ""),
        ("SELECT 1", [], "SELECT 1"),
        ("SELECT ';' ; SELECT 2;", ["SELECT ';' ;", "SELECT 2;"], ""),
        ('SELECT "a;b", $$;$$; -- done;', ['SELECT "a;b", $$;$$;'], ""),
        ("SELECT 'ü; -- open", [], "SELECT 'ü; -- open"),
        ("SELECT 'ü'; FROM", ["SELECT 'ü';"], " FROM"),
        ("/* open ;", [], "/* open ;"),
        ("; /* closed */ ;", [], ""),
    ],
)
def test_statements_end_at_semicolons_outside_of_texts(typed: str, whole: list[str], rest: str) -> None:
    assert split_statements(typed) == (whole, rest)


def test_a_closed_store_opens_again(store: Store) -> None:
    with open_store(store.path) as other:
        other.sql("SELECT 1")
    assert other.sql("SELECT 1 AS one").to_pylist() == [{"one": 1}]
