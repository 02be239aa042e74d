"""The index: word runs, feature runs and vocabulary of a store's takes, built aside, published as a generation."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import time
import uuid
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from catalog.views import MACROS, VIEWS, help_rows
from ops.errors import StoreError
from ops.runs import feature_runs, word_runs
from ops.words import TakeWords, cut
from storage import duck
from storage.disk import sync_folder, writing
from storage.lock import Lock
from storage.manifest import Manifest, now

if TYPE_CHECKING:
    from storage.store import Store

INDEX_VERSION = 1
"""Version of the index's tables and macros; an index of another version is stale."""

BUILD = "run the stage `index` of its pipeline (`kinedex run … --force index`)"

BUILDING, GENERATION = ".building-", "gen-"
"""How the folders of unfinished and of published indexes are named."""


@dataclass(frozen=True)
class Generation:
    """What a published index says of itself (`generation.json`).

    content: `Manifest.content_digest` of the takes that it indexes. rows: of each table.
    """

    index_version: int
    manifest_version: int
    content: str
    feature_set_digest: str
    rows: dict[str, int]
    bytes: int
    sha256: str
    built: str
    build_seconds: float


def build(store: Store, threads: int | None = None, memory_mb: int | None = None) -> Path:
    """Build and publish the index of a store's live takes, unless it stands already; the newest two are kept.

    Parameters
    ----------
    store: the version to index.
    threads, memory_mb: what DuckDB may use; None leaves it to DuckDB.

    Returns
    -------
    The generation's folder. Readers that have an older generation open keep it.

    Raises
    ------
    StoreError: another process builds an index of this store, a part cannot be read, or there is no space for the
        index; the generation before stays.
    """
    folder = store.path / "index"
    folder.mkdir(exist_ok=True)
    with Lock(folder / "lock", "this build"):
        standing = current(store.path, store.manifest)
        if standing is not None and _is_whole(standing):
            return standing
        for leftover in folder.glob(f"{BUILDING}*"):
            shutil.rmtree(leftover)
        building = folder / f"{BUILDING}{uuid.uuid4().hex}"
        building.mkdir()
        try:
            with writing(building):
                _build(store, building, threads, memory_mb)
            generation = folder / f"{GENERATION}{store.manifest.version:06d}"
            if generation.exists():
                # not current, or it would have been returned: damaged, or of another version of the index
                shutil.rmtree(generation)
            os.rename(building, generation)
        finally:
            shutil.rmtree(building, ignore_errors=True)
        sync_folder(folder)
        for old in _generations(store.path)[2:]:
            shutil.rmtree(old)
        return generation


def current(store: Path, manifest: Manifest) -> Path | None:
    """The newest generation that indexes exactly the live takes of this version; None where there is none."""
    content = manifest.content_digest()
    for generation in _generations(store):
        says = read_generation(generation)
        if says is not None and says.index_version == INDEX_VERSION and says.content == content:
            file = generation / "index.duckdb"
            if file.is_file() and file.stat().st_size == says.bytes:
                return generation
    return None


def read_generation(generation: Path) -> Generation | None:
    """What a generation says of itself; None where that cannot be read."""
    try:
        return Generation(**json.loads((generation / "generation.json").read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return None


def _is_whole(generation: Path) -> bool:
    """Whether the file is, byte by byte, the one that was published."""
    says = read_generation(generation)
    try:
        with open(generation / "index.duckdb", "rb") as content:
            return says is not None and hashlib.file_digest(content, "sha256").hexdigest() == says.sha256
    except OSError:
        return False


def missing(store: Path) -> StoreError:
    """The error for a store whose index is missing or does not fit its takes."""
    state = "stale: the takes have changed since it was built" if _generations(store) else "missing"
    return StoreError(f"{store}: the index is {state}; {BUILD}")


def _generations(store: Path) -> list[Path]:
    return sorted((store / "index").glob(f"{GENERATION}*"), reverse=True)


def _build(store: Store, folder: Path, threads: int | None, memory_mb: int | None) -> None:
    began = time.perf_counter()
    file = folder / "index.duckdb"
    connection = duck.connect(threads, memory_mb)
    try:
        # this storage version is read by DuckDB 1.5 as well as by 2.x
        connection.execute(f"ATTACH {duck.quote(str(file))} AS building (STORAGE_VERSION 'v1.5.0')")
        connection.execute("USE building")
        for view in VIEWS:
            if view.columns:
                columns = ", ".join(f"{column.name} {column.type} NOT NULL" for column in view.columns)
                connection.execute(f"CREATE TABLE {view.name} ({columns})")
        _insert(connection, "features", features_table(store), "SELECT * FROM source ORDER BY number")
        _insert(connection, "help", help_table(index_only=True), "SELECT * FROM source")
        takes = store.takes().to_arrow()
        connection.register("source", takes)
        connection.execute("CREATE TABLE takes AS SELECT * FROM source ORDER BY name")
        connection.unregister("source")
        _insert_runs(connection, store)
        for macro in MACROS:
            if macro.needs == "index":
                connection.execute(macro.sql())
        tables = [view.name for view in VIEWS if view.origin == "index"]
        counted = ((table, duck.query(connection, f"SELECT count(*) FROM {table}")) for table in tables)
        rows = {table: int(count.column(0)[0].as_py()) for table, count in counted}
        connection.execute("USE memory")
        connection.execute("DETACH building")
    except duck.Error as fault:
        raise StoreError(
            f"{file}: the index cannot be built: {duck.first_line(fault)}; where space on disk or memory is short, "
            "make room (`kinedex gc` removes what only old versions need) or set `memory_mb` of the stage `index`"
        ) from None
    finally:
        connection.close()
    with open(file, "rb") as content:
        os.fsync(content.fileno())
        digest = hashlib.file_digest(content, "sha256").hexdigest()
    generation = Generation(
        index_version=INDEX_VERSION,
        manifest_version=store.manifest.version,
        content=store.manifest.content_digest(),
        feature_set_digest=store.feature_set.digest,
        rows=rows,
        bytes=file.stat().st_size,
        sha256=digest,
        built=now(),
        build_seconds=round(time.perf_counter() - began, 3),
    )
    with open(folder / "generation.json", "w", encoding="utf-8") as said:
        json.dump(asdict(generation), said, indent=1)
        said.flush()
        os.fsync(said.fileno())
    sync_folder(folder)


def features_table(store: Store) -> pa.Table:
    """The rows of the view `features`."""
    rows = []
    for feature in store.feature_set.features:
        home = store.feature_set.set_of(feature.number)
        rows.append(
            {
                "number": feature.number,
                "name": feature.name,
                "description": feature.description,
                "feature_set": home.name,
                "bit": feature.number - home.first,
            }
        )
    small = {"number": pa.uint8(), "bit": pa.uint8()}
    fields = [(name, small.get(name, pa.string())) for name in ("number", "name", "description", "feature_set", "bit")]
    return pa.Table.from_pylist(rows, schema=pa.schema(fields))


def help_table(*, index_only: bool = False) -> pa.Table:
    """The rows of the view `help`."""
    columns = ("name", "call", "summary", "example")
    rows = help_rows(index_only=index_only)
    return pa.Table.from_pylist([dict(zip(columns, row, strict=True)) for row in rows])


def _insert_runs(connection: duck.Connection, store: Store) -> None:
    words = store.words()
    for name in sorted(store.feature_set.sets):
        home = store.feature_set.sets[name]
        table = _word_runs(words, cut(words.words, home.first, home.count))
        ordered = "SELECT word, take_id, start, stop FROM source ORDER BY word, take_id, start"
        _insert(connection, "word_runs", table, f"SELECT {duck.quote(name)}, * FROM ({ordered})")
    runs = feature_runs(words.words, words.offsets, len(store.feature_set.features))
    table = pa.table(
        {
            "feature": runs.feature.astype(np.uint8),
            "take_id": words.take_ids[runs.take],
            "start": runs.start.astype(np.int32),
            "stop": runs.stop.astype(np.int32),
            "seconds": (runs.stop - runs.start) / store.rate_hz,
        }
    )
    # take ids ascend with the takes' positions, so these come sorted
    _insert(connection, "feature_runs", table, "SELECT * FROM source")
    connection.execute(
        "INSERT INTO vocabulary SELECT feature_set, word, count(*), sum(stop - start) FROM word_runs "
        "GROUP BY feature_set, word ORDER BY feature_set, word"
    )


def _word_runs(words: TakeWords, cut_words: np.ndarray[tuple[int], np.dtype[np.uint64]]) -> pa.Table:
    runs = word_runs(cut_words, words.offsets)
    return pa.table(
        {
            "word": runs.word,
            "take_id": words.take_ids[runs.take],
            "start": runs.start.astype(np.int32),
            "stop": runs.stop.astype(np.int32),
        }
    )


def _insert(connection: duck.Connection, table: str, source: pa.Table, query: str) -> None:
    connection.register("source", source)
    connection.execute(f"INSERT INTO {table} {query}")
    connection.unregister("source")
