"""A query is answered only from parts whose checksums are right, and asks for no others."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

import pyarrow as pa
import pytest

from kinedex.catalog.sql.views import MACROS, VIEWS
from kinedex.ops.errors import StoreError
from kinedex.storage import duckdb_sql
from kinedex.storage.snapshot.schemas import RESULT_KINDS, result_schema
from kinedex.storage.sql.read_parts import _reached
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.writer import StoreWriter
from tests.storage.flipped import flip_bit
from tests.storage.made_up import BODY, make_store


@pytest.fixture
def damaged(tmp_path: Path) -> Store:
    """A store with a flipped bit amid its frames, which nothing but the checksum shows."""
    store = open_store(make_store(tmp_path / "store", {"a": 60, "b": 50}))
    part = store.path / store.manifest.frames[0].path
    flip_bit(part, part.stat().st_size // 3)
    return store


@pytest.mark.parametrize(
    "query",
    [
        "FROM frames",
        "SELECT count(*) FROM FRAMES",
        'SELECT word FROM "frames" LIMIT 1',
        "WITH frames AS (SELECT 1), a AS (SELECT * FROM temp.frames) FROM a",
        "SELECT (SELECT max(rwrist.y) FROM frames) FROM takes",
        "SELECT name FROM takes WHERE take_id IN (SELECT take_id FROM frames)",
        "SUMMARIZE frames",
        "DESCRIBE frames",
        "SHOW frames",
        "SHOW ALL TABLES",
        "FROM duckdb_columns()",
        "FROM information_schema.columns",
        "PRAGMA table_info('frames')",
        "EXPLAIN FROM frames",
        "EXPLAIN ANALYZE FROM frames",
        "PIVOT frames ON take_id USING count(*)",
        "PIVOT frames ON take_id IN (1) USING count(*)",
    ],
)
def test_no_query_reads_a_damaged_part(damaged: Store, query: str) -> None:
    with pytest.raises(StoreError, match=r"frames/part-\w+\.parquet: the part is damaged"):
        damaged.sql(query)


@pytest.mark.parametrize("query", ["FROM takes", "SELECT frames FROM takes", "FROM annotations", "FROM help"])
def test_a_query_over_other_views_is_answered(damaged: Store, query: str) -> None:
    assert damaged.sql(query) is not None


def test_a_raw_connection_is_only_opened_over_sound_parts(damaged: Store) -> None:
    with pytest.raises(StoreError, match="the part is damaged"):
        damaged.connect()


def test_views_and_macros_lead_to_every_view_in_their_bodies() -> None:
    """Names in the bodies that stand behind FROM or JOIN are those of the parsed tree."""
    with duckdb_sql.connect() as connection:
        for name, body in [(view.name, view.body) for view in VIEWS] + [(macro.name, macro.body) for macro in MACROS]:
            words = body.replace("(", " ").replace(")", " ").replace(",", " ").split()
            named = {after for before, after in pairwise(words) if before in ("FROM", "JOIN")}
            assert named & {"frames", "takes", *RESULT_KINDS} <= set(_reached(connection, [name])), name


def test_a_damaged_name_of_a_column_is_an_error_that_names_the_part(tmp_path: Path) -> None:
    path = make_store(tmp_path / "store", {"a": 30})
    row = {"run": "r", "take_id": 1, "take": "a", "class": "walk", "start": 3, "stop": 9, "confidence": 0.5}
    with StoreWriter.open(path, BODY) as writer:
        table = pa.Table.from_pylist([row], schema=result_schema("annotations"))
        writer.put_results("annotations", table, stage="study/annotate", run="r")
        writer.commit()
        part = path / writer.manifest.results["annotations"][0].path
    for place in re.finditer(b"confidence", part.read_bytes()):
        flip_bit(part, place.start(), 7)
        with pytest.raises(StoreError, match=f"{part.name}: the part is damaged"):
            open_store(path).sql("FROM annotations")
        flip_bit(part, place.start(), 7)
