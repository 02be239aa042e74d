"""Write the database file of a store, which gives other DuckDB clients all views and macros over one version.

`kinedex.duckdb` holds views, macros and small tables. Its views name the index and each Parquet file of the version by
absolute paths, so that no file of another version is ever read with them. Commands that change the store rewrite the
database file if it exists; its view `store_version` compares its version with the newest version of the store.
"""

from __future__ import annotations

import glob
import os
from contextlib import suppress
from pathlib import Path

import pyarrow as pa

from kinedex.catalog.sql.views import MACROS, VIEWS
from kinedex.ops.errors import KinedexError, StoreError
from kinedex.storage import duckdb_sql
from kinedex.storage.durable_files import replace_file, write_errors
from kinedex.storage.index.generations import read_generation
from kinedex.storage.index.index_views import features_table, help_table, index_statements
from kinedex.storage.snapshot.manifest_files import FOLDER
from kinedex.storage.snapshot.parts import part_file
from kinedex.storage.snapshot.schemas import DATABASE, RESULT_KINDS, frames_schema
from kinedex.storage.snapshot.visible_results import pipeline_runs
from kinedex.storage.sql.result_scans import ALL_VIEWS, result_select, shown_labels
from kinedex.storage.store.store import Store, open_store


def write_database(store: Store) -> Path:
    """Write the database file of a version of a store, replacing an earlier one.

    Parameters
    ----------
    store : Store
        The version that the views of the file show.

    Returns
    -------
    Path
        The absolute path of the file.

    Raises
    ------
    StoreError
        The index or a part is missing, or the file cannot be written.
    """
    index = store.index_path().absolute()
    path = store.path.absolute() / DATABASE
    connection = duckdb_sql.connect()
    try:
        with write_errors(path):
            replace_file(path, lambda unfinished: _write(connection, store, index, unfinished))
    except duckdb_sql.Error as fault:
        raise StoreError(f"{path}: the database file cannot be written: {duckdb_sql.first_line(fault)}") from None
    finally:
        connection.close()
    return path


def _write(connection: duckdb_sql.Connection, store: Store, index: Path, path: Path) -> None:
    connection.execute(f"ATTACH {duckdb_sql.quote(str(path))} AS made (STORAGE_VERSION 'v1.5.0')")
    connection.execute("USE made")
    _fill(connection, store, index)
    connection.execute("USE memory")
    connection.execute("DETACH made")


def refresh_database(path: Path) -> None:
    """Rewrite the database file of a store if it exists; on failure, the earlier file is kept."""
    if (path / DATABASE).is_file():
        with suppress(KinedexError, OSError), open_store(path) as store:
            write_database(store)


def _fill(connection: duckdb_sql.Connection, store: Store, index: Path) -> None:
    connection.execute(f"ATTACH IF NOT EXISTS {duckdb_sql.quote(str(index))} AS idx (READ_ONLY)")
    listed = duckdb_sql.rows(connection, "SELECT table_name FROM duckdb_tables() WHERE database_name = 'idx'")
    record = read_generation(index.parent)
    copied = {"features", "help"}
    if record is None or record.takes != store.manifest.takes_digest():
        # rows or columns of takes have changed since the index was built
        copied.add("takes")
        _table(connection, "takes", store.take_rows)
    for name in listed.column(0).to_pylist():
        if name not in copied:
            rows = f"read_duckdb({duckdb_sql.quote(glob.escape(str(index)))}, table_name := {duckdb_sql.quote(name)})"
            _view(connection, duckdb_sql.identifier(name), f"SELECT * FROM {rows}")
    _table(connection, "features", features_table(store.feature_set))
    _table(connection, "help", help_table())
    for statement in index_statements(store.feature_set, store.rate_hz):
        connection.execute(statement)
    frames = [(part_file(store.path, part.path), part.dropped) for part in store.manifest.frames]
    _view(connection, "frames", duckdb_sql.parquet_rows(frames_schema(store.feature_set, store.rate_hz), frames))
    for kind in (*RESULT_KINDS, *ALL_VIEWS):
        _view(connection, kind, result_select(store, kind))
    _table(connection, "pipeline_runs", pipeline_runs(store.manifest))
    _table(connection, "label_history", shown_labels(store))
    for view in VIEWS:
        if view.origin != "index" and view.body:
            _view(connection, view.name, view.body)
    for macro in MACROS:
        if macro.needs != "index":
            connection.execute(macro.sql())
    _view(connection, "store_version", _version(store))


def _version(store: Store) -> str:
    """Return the SELECT of the view `store_version`, which reads the store's manifests when it is queried."""
    manifests = os.path.join(glob.escape(str((store.path / FOLDER).absolute())), "*.json")
    newest = (
        f"SELECT max(regexp_extract(m.file, '(\\d+)\\.json$', 1)::BIGINT) FROM glob({duckdb_sql.quote(manifests)}) AS m"
    )
    return (
        f"SELECT {store.manifest.version}::BIGINT AS version, {duckdb_sql.quote(store.manifest.created)} AS created, "
        f"({newest}) AS newest_version"
    )


def _view(connection: duckdb_sql.Connection, name: str, query: str) -> None:
    connection.execute(f"CREATE VIEW {name} AS {query}")


def _table(connection: duckdb_sql.Connection, name: str, rows: pa.Table) -> None:
    connection.register("source", rows)
    connection.execute(f"CREATE TABLE {name} AS SELECT * FROM source")
    connection.unregister("source")
