"""Verify a published index: compare its content with its record and with the store that it indexes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa

from kinedex.catalog.features import FeatureSet
from kinedex.ops.search.bit_slices import slice_words
from kinedex.storage import duckdb_sql
from kinedex.storage.index import index_tables
from kinedex.storage.index.generations import FILE, Generation, Shard, slices_name
from kinedex.storage.index.index_views import lists_table
from kinedex.storage.index.slice_files import ShardSlices, open_slices
from kinedex.storage.snapshot.snapshot import Snapshot


def index_problems(
    store: Snapshot, generation: Path, record: Generation, *, words: bool = True
) -> Iterator[tuple[str, str]]:
    """Yield file and problem for every fault in the content of an index whose files have the recorded checksums.

    In a valid index, every live take is in exactly one shard, and the tables have the recorded numbers of rows. In
    every shard, the inverted lists of a feature set have as many runs and frames as its vocabulary counts. In takes for
    which all features of a set are known, the runs of the set's words cover all frames with a word. The bit slices
    agree with the words of the takes.

    Parameters
    ----------
    store : Snapshot
        The store that is indexed.
    generation : Path
        Folder of the index.
    record : Generation
        The record of the index.
    words : bool, optional
        True to compare the bit slices with the words of the store, whose parts must then be undamaged.
    """
    for problem in _tables(store, generation, record):
        yield FILE, problem
    for shard, found in zip(record.shards, open_slices(store.checked, generation, record), strict=True):
        for problem in _slices(store, shard, found, words):
            yield slices_name(shard.number), problem


def _slices(store: Snapshot, shard: Shard, found: ShardSlices, against_words: bool) -> Iterator[str]:
    wanted = sorted(shard.take_ids)
    if not against_words:
        return
    if not np.array_equal(found.take_ids[found.live], wanted):
        yield "it holds other takes than its shard"
        return
    words = store.words(wanted)
    expected = slice_words(words.words, words.offsets, len(store.feature_set.features))
    slices, lengths, granules = found.slices, np.diff(found.slices.first), found.slices.granules
    blocks = np.repeat(found.live, lengths)
    same = {
        "bits": np.array_equal(slices.rows[:, blocks], expected.rows),
        "frames": np.array_equal(slices.frames[found.live], expected.frames),
        "first": np.array_equal(lengths[found.live], np.diff(expected.first)),
        "left": np.array_equal(slices.left[blocks], expected.left),
        "coarse": np.array_equal(granules[:, : len(blocks)][:, blocks], expected.granules[:, : len(expected.left)])
        and not granules[:, len(blocks) :].any(),
    }
    for name, is_same in same.items():
        if not is_same:
            yield f"its slices ({name}) are not those of the takes' words"


def _tables(store: Snapshot, generation: Path, record: Generation) -> Iterator[str]:
    # compare takes, not parts: compaction moves takes to other parts, and the index stays valid
    held = sorted(take for shard in record.shards for take in shard.take_ids)
    if held != list(store.manifest.live_takes):
        yield "its shards do not hold every live take once"
    with duckdb_sql.connect() as connection:
        connection.execute(f"ATTACH {duckdb_sql.quote(str((generation / FILE).absolute()))} AS idx (READ_ONLY)")
        connection.execute("USE idx")
        for view, count in index_tables.count(connection).items():
            if count != record.rows.get(view):
                yield f"{view} has {count} rows, not {record.rows.get(view)}"
        yield from _frames(connection, store.feature_set, record)
        yield from _shards(connection, store.feature_set, record)


def _frames(connection: duckdb_sql.Connection, feature_set: FeatureSet, record: Generation) -> Iterator[str]:
    total = duckdb_sql.rows(connection, "SELECT coalesce(sum(frames), 0)::BIGINT FROM takes").column(0)[0].as_py()
    if total != record.frames:
        yield f"its shards have {record.frames} frames, the takes have {total}"
    if record.valid_frames > record.frames:
        yield f"{record.valid_frames} of {record.frames} frames have a word"
    if (valid := index_tables.valid_frames(connection)) != record.valid_frames:
        yield f"its valid runs fill {valid} frames, {record.valid_frames} have a word"
    for name, home in feature_set.sets.items():
        query = "SELECT coalesce(sum(frames), 0)::BIGINT FROM vocabulary WHERE feature_set = ?"
        frames = duckdb_sql.rows(connection, query, [name]).column(0)[0].as_py()
        expected = index_tables.valid_frames_of(connection, home)
        if frames != expected:
            yield f"the words of {name} fill {frames} frames, {expected} have a word"


def _shards(connection: duckdb_sql.Connection, feature_set: FeatureSet, record: Generation) -> Iterator[str]:
    numbers = {shard.number for shard in record.shards}
    homes = [(take, shard.number) for shard in record.shards for take in shard.take_ids]
    columns = np.array(homes, np.int64).reshape(-1, 2).T
    connection.register("homes", pa.table({"take_id": columns[0], "shard": columns[1]}))
    for name in sorted(feature_set.sets):
        counted = duckdb_sql.rows(
            connection,
            f"""SELECT coalesce(r.shard, v.shard) AS shard, r.runs IS NOT DISTINCT FROM v.runs
                AND r.frames IS NOT DISTINCT FROM v.frames AS same
            FROM (SELECT homes.shard, count(*) AS runs, sum(frames) AS frames FROM {lists_table(name)} AS runs
                LEFT JOIN homes ON homes.take_id = runs.take_id GROUP BY 1) AS r
            FULL JOIN (SELECT shard, sum(runs) AS runs, sum(frames) AS frames FROM stored_vocabulary
                WHERE feature_set = {duckdb_sql.quote(name)} GROUP BY 1) AS v ON r.shard = v.shard ORDER BY 1""",
        )
        for shard, same in zip(*(column.to_pylist() for column in counted.columns), strict=True):
            if shard is None:
                yield f"{name} has rows of takes that are in no shard"
            elif shard not in numbers:
                yield f"{name} has rows of a shard {shard} that is none"
            elif not same:
                yield f"the lists of {name} in shard {shard} are not those that its vocabulary counts"
