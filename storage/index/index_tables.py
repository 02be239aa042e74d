"""Make the content of an index file: the tables with the rows of shards, and the views and macros over them.

`stored_word_runs_<set>`, `stored_feature_runs`, `stored_valid_runs` and `stored_vocabulary` hold the rows of all
shards, one after the other; the rows of each shard are sorted. Every take is in one shard, so that the take of a run
determines the run's shard; the vocabulary has a column for the shard. A run is stored with its length, which takes a
third of the space that its end would take, and with the id of its take in 32 bits. If some features of a set are
unknown for a take, the take has no words of this set: the inverted lists and the vocabulary of the set do not contain
the take, and its valid frames are only in `stored_valid_runs`. The views `word_runs`, `feature_runs` and `vocabulary`
show the tables as `catalog.sql.views` describes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from itertools import chain
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from kinedex.catalog.feature_definitions import WordSet
from kinedex.catalog.features import FeatureSet
from kinedex.catalog.sql.views import VIEWS
from kinedex.ops.errors import StoreError
from kinedex.ops.search.inverted_lists import MAX_COUNTED, InvertedLists, inverted_lists
from kinedex.ops.search.runs import FeatureRuns, WordRuns, feature_runs, word_runs
from kinedex.ops.words import I64, NO_WORD, U64, TakeWords
from kinedex.storage import duckdb_sql
from kinedex.storage.index.index_views import features_table, help_table, index_statements, lists_table
from kinedex.storage.snapshot.snapshot import Snapshot

BATCH = 122_880
"""The number of rows of a DuckDB row group; several threads compress batches of this size."""


class ShardRows(NamedTuple):
    """The rows of a shard before they are stored.

    Attributes
    ----------
    take_ids : int64 array (T,)
        Ids of the takes; runs refer to a take by its index here.
    lists : dict of str to InvertedLists
        Feature set → its inverted lists.
    features : FeatureRuns
        The runs of all features.
    valid : WordRuns
        The runs of frames that have a word.
    frames : int
        Number of frames of all takes.
    """

    take_ids: I64
    lists: dict[str, InvertedLists]
    features: FeatureRuns
    valid: WordRuns
    frames: int


def make_shard(words: TakeWords, feature_set: FeatureSet) -> ShardRows:
    """Make the rows of a shard from the words of its takes; the function is thread-safe.

    Parameters
    ----------
    words : TakeWords
        The words of the takes.
    feature_set : FeatureSet
        The feature set of the words.

    Raises
    ------
    StoreError
        The id of a take does not fit into 32 bits.
    """
    if len(words) and words.take_ids[-1] > np.iinfo(np.int32).max:
        raise StoreError(f"take {words.take_ids[-1]}: the index holds takes up to {np.iinfo(np.int32).max}")
    lists = {
        name: inverted_lists(_words_of_set(words, home), words.offsets, home.first, home.count)
        for name, home in feature_set.sets.items()
    }
    features = feature_runs(words.words, words.offsets, len(feature_set.features))
    valid = word_runs(np.where(words.words == NO_WORD, NO_WORD, np.uint64(0)), words.offsets)
    return ShardRows(words.take_ids, lists, features, valid, len(words.words))


def _words_of_set(words: TakeWords, home: WordSet) -> U64:
    """Return the words, with `NO_WORD` in all frames of takes that have unknown features of a set."""
    if words.known is None:
        return words.words
    mask = np.uint64(home.mask)
    return np.where(np.repeat((words.known & mask) == mask, words.frames), words.words, NO_WORD)


def create(connection: duckdb_sql.Connection, feature_set: FeatureSet) -> None:
    """Create the tables for the rows of shards."""
    # by itself DuckDB would try all compressions and choose the same, which takes a third of the time for storing rows
    packed, repeated = "USING COMPRESSION bitpacking", "USING COMPRESSION rle"
    run = f"take_id INTEGER {packed}, start INTEGER {packed}, frames INTEGER {packed}"
    for name, home in feature_set.sets.items():
        # few features give few distinct words, each with many runs in a shard
        column = "UBIGINT" if home.count > MAX_COUNTED else f"UBIGINT {repeated}"
        connection.execute(f"CREATE TABLE {lists_table(name)} (word {column}, {run})")
    connection.execute(f"CREATE TABLE stored_feature_runs (feature UTINYINT {repeated}, {run})")
    connection.execute(f"CREATE TABLE stored_valid_runs ({run})")
    seen = "feature_set VARCHAR, word UBIGINT, runs BIGINT, frames BIGINT"
    connection.execute(f"CREATE TABLE stored_vocabulary (shard INTEGER, {seen})")


def insert(connection: duckdb_sql.Connection, number: int, rows: ShardRows) -> None:
    """Store the rows of a shard."""
    take_ids = rows.take_ids.astype(np.int32)
    for name, lists in rows.lists.items():
        columns = {
            "word": np.repeat(lists.words, lists.runs),
            "take_id": take_ids[lists.take],
            "start": lists.start,
            "frames": lists.length,
        }
        _insert(connection, lists_table(name), "*", columns)
        seen = {"word": lists.words, "runs": lists.runs, "frames": lists.frames}
        _insert(connection, "stored_vocabulary", f"{number}, {duckdb_sql.quote(name)}, *", seen)
    runs = rows.features
    columns = {
        "feature": runs.feature,
        "take_id": take_ids[runs.take],
        "start": runs.start,
        "frames": runs.stop - runs.start,
    }
    _insert(connection, "stored_feature_runs", "*", columns)
    valid = rows.valid
    ends = {"start": valid.start.astype(np.int32), "frames": (valid.stop - valid.start).astype(np.int32)}
    _insert(connection, "stored_valid_runs", "*", {"take_id": take_ids[valid.take], **ends})


def delete(
    connection: duckdb_sql.Connection,
    feature_set: FeatureSet,
    removed: Mapping[int, Iterable[int]],
    dropped: Mapping[int, tuple[Iterable[int], Iterable[int]]],
) -> None:
    """Delete all rows of removed shards, and the rows of takes that other shards lose.

    Parameters
    ----------
    connection : Connection
        A connection to the index file.
    feature_set : FeatureSet
        The feature set of the words.
    removed : mapping of int to iterable of int
        Number of a removed shard → the ids of its takes.
    dropped : mapping of int to pair of iterables of int
        Number of a shard → the ids of the takes that it loses, and the ids of the takes that it keeps.
    """
    gone = [*removed.values(), *(lost for lost, _ in dropped.values())]
    if not gone:
        return
    with _takes(connection, "gone", chain.from_iterable(gone)):
        for table in (*map(lists_table, feature_set.sets), "stored_feature_runs", "stored_valid_runs"):
            connection.execute(f"DELETE FROM {table} WHERE take_id IN (SELECT take_id FROM gone)")
    numbers = ", ".join(map(str, (*removed, *dropped)))
    connection.execute(f"DELETE FROM stored_vocabulary WHERE shard IN ({numbers})")
    for number, (_, kept) in dropped.items():
        with _takes(connection, "kept", kept):
            for name in feature_set.sets:
                connection.execute(
                    f"INSERT INTO stored_vocabulary SELECT {number}, {duckdb_sql.quote(name)}, word, count(*), "
                    "sum(frames) "
                    f"FROM {lists_table(name)} WHERE take_id IN (SELECT take_id FROM kept) GROUP BY word ORDER BY word"
                )


@contextmanager
def _takes(connection: duckdb_sql.Connection, name: str, take_ids: Iterable[int]) -> Iterator[None]:
    """Provide take ids as a temporary table with this name."""
    connection.register(name, pa.table({"take_id": np.fromiter(take_ids, np.int32)}))
    yield
    connection.unregister(name)


def describe(connection: duckdb_sql.Connection, store: Snapshot, *, anew: bool) -> None:
    """Create the tables takes and vocabulary, and if `anew` also the tables features and help, the views and macros.

    Tables are replaced if they exist. The views and macros must not exist yet; `clear` removes them.
    """
    if anew:
        _create_as(connection, "features", features_table(store.feature_set))
        _create_as(connection, "help", help_table(index_only=True))
    _create_as(connection, "takes", store.take_rows)
    connection.execute(
        "CREATE OR REPLACE TABLE vocabulary AS "
        "SELECT feature_set, word, sum(runs)::BIGINT AS runs, sum(frames)::BIGINT AS frames "
        "FROM stored_vocabulary GROUP BY feature_set, word ORDER BY feature_set, word"
    )
    if anew:
        for statement in index_statements(store.feature_set, store.rate_hz):
            connection.execute(statement)


def count(connection: duckdb_sql.Connection) -> dict[str, int]:
    """Return the number of rows of every view of the index."""
    tables = [view.name for view in VIEWS if view.origin == "index"]
    counted = ((table, duckdb_sql.rows(connection, f"SELECT count(*) FROM {table}")) for table in tables)
    return {table: int(found.column(0)[0].as_py()) for table, found in counted}


def valid_frames(connection: duckdb_sql.Connection) -> int:
    """Return the number of frames that have a word."""
    query = "SELECT coalesce(sum(frames), 0)::BIGINT FROM stored_valid_runs"
    return int(duckdb_sql.rows(connection, query).column(0)[0].as_py())


def valid_frames_of(connection: duckdb_sql.Connection, home: WordSet) -> int:
    """Return the number of frames with a word, in takes for which all features of a set are known."""
    query = f"""SELECT coalesce(sum(r.frames), 0)::BIGINT FROM stored_valid_runs AS r
        JOIN takes AS t ON t.take_id = r.take_id
        WHERE t.known IS NULL OR (t.known & {home.mask}::UBIGINT) = {home.mask}::UBIGINT"""
    return int(duckdb_sql.rows(connection, query).column(0)[0].as_py())


def clear(connection: duckdb_sql.Connection) -> None:
    """Drop the views, macros and tables of an earlier generation, except those of its shards."""
    for source, kind, where in (
        ("duckdb_views()", "view_name, 'VIEW'", ""),
        ("duckdb_functions()", "function_name, IF(function_type = 'table_macro', 'MACRO TABLE', 'MACRO')", ""),
        ("duckdb_tables()", "table_name, 'TABLE'", "AND table_name NOT LIKE 'stored!_%' ESCAPE '!'"),
    ):
        found = duckdb_sql.rows(
            connection,
            f"SELECT DISTINCT {kind} FROM {source} "
            f"WHERE database_name = current_database() AND schema_name = 'main' AND NOT internal {where}",
        )
        for name, what in zip(*(column.to_pylist() for column in found.columns), strict=True):
            connection.execute(f"DROP {what} {duckdb_sql.identifier(name)}")


def _create_as(connection: duckdb_sql.Connection, table: str, source: pa.Table) -> None:
    connection.register("source", source)
    connection.execute(f"CREATE OR REPLACE TABLE {table} AS SELECT * FROM source")
    connection.unregister("source")


def _insert(connection: duckdb_sql.Connection, table: str, values: str, columns: Mapping[str, object]) -> None:
    source = pa.table(dict(columns))
    if source.num_rows:
        connection.register("source", pa.Table.from_batches(source.to_batches(max_chunksize=BATCH)))
        connection.execute(f"INSERT INTO {table} SELECT {values} FROM source")
        connection.unregister("source")
