"""A hit has one form: one class for few of them, and one table for many, wherever they come from."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

import kinedex
from kinedex.catalog.queries.keyframe_query import Keyframe, KeyframeQuery
from kinedex.explorer.hits import shown_hits
from kinedex.pipelines.keyframes.store_search import save_hits, search_store
from kinedex.pipelines.templates.store_ranking import RankingQuestion, rank_store
from kinedex.pipelines.templates.stored_templates import template_from_clip
from kinedex.storage.index.builder import build_index
from kinedex.storage.snapshot.schemas import hits_of, ranking_schema, result_schema
from kinedex.storage.store.store import Store, open_store
from tests.pipelines.labelled import long_take, write_store
from tests.test_rooms import FILES

PLACE = ("take_id", "take", "start", "stop", "start_seconds", "stop_seconds")
"""The columns of the interval of a hit, in every table."""


def test_each_form_has_one_definition() -> None:
    names = [
        node.name
        for path in FILES
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ClassDef)
    ]
    assert [names.count(name) for name in ("Interval", "Hit", "Hits", "Example", "Ranking")] == [1] * 5


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    takes = [long_take(f"take_{i}", "ann", "walk", "rest", "kick", "wave") for i in range(3)]
    path: Path = write_store(tmp_path_factory.mktemp("hits") / "store", takes)
    build_index(open_store(path, at="newest"), threads=1)
    return open_store(path)


@pytest.fixture(scope="module")
def ranked(store: Store) -> pa.Table:
    example = template_from_clip(store, "take_0", 25, 50, "kick")
    return rank_store(store, [example], RankingQuestion(tau=0.5, mirror=True)).table()


@pytest.fixture(scope="module")
def found(store: Store) -> pa.Table:
    name = next(iter(store.feature_set.sets))
    return search_store(store, [KeyframeQuery("any", "any", (Keyframe(name, 0, 0),), ())], run="run")


def place(schema: pa.Schema) -> list[tuple[str, pa.DataType]]:
    return [(field.name, field.type) for field in schema if field.name in PLACE]


def test_all_tables_of_hits_have_the_columns_of_an_interval(store: Store, ranked: pa.Table, found: pa.Table) -> None:
    expected = place(result_schema("ranked_hits"))
    assert tuple(name for name, _ in expected) == PLACE
    assert ranked.num_rows > 2
    assert found.num_rows > 2
    for schema in (ranking_schema(), result_schema("hits"), ranked.schema, found.schema):
        assert place(schema) == expected
    assert ranked.schema == ranking_schema()
    assert found.schema == result_schema("hits")
    save_hits(store, found, "mine", "run")
    saved = open_store(store.path).sql("FROM hits ORDER BY take, start")
    python = kinedex.open_store(store.path)
    example = kinedex.Template.from_clip(python["take_0"], 25, 50, name="kick")
    for table in (saved, python.rank(example, tau=0.5).to_arrow()):
        assert [name for name, _ in place(table.schema)] == list(PLACE)
    assert saved.select(PLACE).to_pylist() == found.select(PLACE).to_pylist()


def test_a_row_a_hit_and_an_answer_of_the_explorer_say_the_same(
    store: Store, ranked: pa.Table, found: pa.Table
) -> None:
    for table, named in ((ranked, "template"), (found, "query")):
        shown = shown_hits(store, hits_of(table, named))
        for row, one in zip(table.to_pylist(), shown, strict=True):
            assert one == {
                **{key: row[key] for key in PLACE[:4]},
                "cost": row.get("cost"),
                "mirrored": row.get("mirrored", False),
                "similarity": None,
                "probable": None,
                "name": row[named],
            }
    seconds = np.array(ranked.column("start").to_pylist()) / store.rate_hz
    assert ranked.column("start_seconds").to_pylist() == seconds.tolist()
