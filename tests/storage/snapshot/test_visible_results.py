"""A view of results shows one pipeline, and `all_` before its name shows all."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import polars as pl
import pyarrow as pa
import pytest
from typer.testing import CliRunner

from kinedex.commands.cli import app
from kinedex.console.sql_prompt import hidden_rows_hints
from kinedex.ops.errors import StoreError
from kinedex.storage.snapshot.manifest import Source, StageRecord
from kinedex.storage.snapshot.schemas import result_schema
from kinedex.storage.snapshot.visible_results import (
    PIPELINE_KINDS,
    current_pipeline,
    result_pipelines,
    shown_parts,
    shown_pipeline,
)
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.writer import StoreWriter
from tests.storage.made_up import BODY, make_store


def put(writer: StoreWriter, kind: str, stage: str, uses: str, count: int, finished: str = "2026-01-01") -> None:
    """Put rows of a kind of results of a stage, as a run of it does."""
    run = f"{stage}-{finished}"
    table = pa.Table.from_pylist([{"run": run}] * count, schema=result_schema(kind))
    writer.put_results(kind, table, stage=stage, run=run)
    summary = {"uses": uses}
    record = StageRecord(stage, "f", run, f"{finished}T00:00:00Z", 1.5, summary, f"run of {stage}", f"do {stage}", "9")
    writer.record_stage(record)


@pytest.fixture
def store(tmp_path: Path) -> Store:
    """A store with results of three pipelines: two that annotate, and one that ranks and was run last."""
    with StoreWriter.open(make_store(tmp_path / "store", {"a": 9}), BODY) as writer:
        put(writer, "annotations", "first/annotate", "annotate", 3, "2026-01-01")
        put(writer, "metrics", "first/evaluate", "evaluate", 1, "2026-01-01")
        put(writer, "annotations", "second/annotate", "annotate", 2, "2026-01-02")
        put(writer, "metrics", "second/evaluate", "evaluate", 0, "2026-01-02")
        put(writer, "ranked_hits", "third/rank", "rank", 4, "2026-01-03")
        for name in ("first", "second", "third"):
            writer.record_run(name)
        writer.commit()
    return open_store(tmp_path / "store")


def change(store: Store, name: str | None) -> Store:
    with StoreWriter.open(store.path, BODY) as writer:
        writer.choose_pipeline(name)
        writer.commit()
    return open_store(store.path)


def counts(store: Store, view: str) -> dict[str | None, int]:
    rows = store.sql(f"SELECT pipeline, count(*) AS n FROM {view} GROUP BY pipeline").to_pylist()
    return {row["pipeline"]: row["n"] for row in rows}


def test_a_view_never_adds_up_two_pipelines(store: Store) -> None:
    # the current pipeline has no stage that annotates: of the others the one run last is shown
    assert current_pipeline(store.manifest) == "third"
    assert counts(store, "annotations") == {"second": 2}
    assert counts(store, "ranked_hits") == {"third": 4}
    assert counts(store, "all_annotations") == {"first": 3, "second": 2}
    # what the shown pipeline has looked for and not found is not taken from another one
    assert counts(store, "metrics") == {}
    assert counts(change(store, "first"), "annotations") == {"first": 3}
    assert counts(change(store, "first"), "metrics") == {"first": 1}


def test_python_shows_what_sql_shows(store: Store) -> None:
    assert store.result("annotations").num_rows == 2
    assert store.result("annotations", pipeline="first").num_rows == 3
    for every, view in ((False, "annotations"), (True, "all_annotations")):
        table = store.result_view("annotations", every=every)
        found = pl.DataFrame(store.sql(f"FROM {view}"))
        assert pl.DataFrame(table).sort("run").equals(found.sort("run"))
    assert store.result_view("metrics").schema.names == store.sql("FROM metrics").schema.names
    assert set(store.result_view("annotations", "first").column("pipeline_run").to_pylist()) == {
        "run of first/annotate"
    }


def test_pipeline_runs_says_what_each_is(store: Store) -> None:
    rows = {row["pipeline_run"]: row for row in store.sql("FROM pipeline_runs").to_pylist()}
    ranked = rows["run of third/rank"]
    assert (ranked["pipeline"], ranked["stages"], ranked["views"]) == ("third", ["rank"], ["ranked_hits"])
    assert (ranked["command"], ranked["kinedex"], ranked["seconds"]) == ("do third/rank", "9", 1.5)
    assert [name for name, row in rows.items() if row["current"]] == ["run of third/rank"]
    assert rows["run of second/annotate"]["views"] == ["annotations"]
    assert rows["run of first/annotate"]["views"] == []
    joined = "SELECT DISTINCT command FROM annotations JOIN pipeline_runs USING (pipeline, pipeline_run)"
    assert store.sql(joined).to_pylist() == [{"command": "do second/annotate"}]


def test_a_pipeline_is_one_row_of_those_to_choose_from_however_often_it_ran(store: Store) -> None:
    with StoreWriter.open(store.path, BODY) as writer:
        put(writer, "source_files", "ingest/ingest", "ingest", 1)  # makes no results of a pipeline
        put(writer, "metrics", "third/evaluate", "evaluate", 1, "2026-01-04")  # another run than that of third/rank
        manifest = writer.commit()
    rows = result_pipelines(manifest).to_pylist()
    assert [(row["pipeline"], row["current"]) for row in rows] == [("third", True), ("second", False), ("first", False)]
    assert (rows[0]["stages"], rows[0]["views"]) == (["rank", "evaluate"], ["metrics", "ranked_hits"])
    assert rows[0]["finished"].day == 4


def test_a_view_without_rows_of_its_pipeline_names_those_that_have_some(store: Store) -> None:
    hints = hidden_rows_hints(store, "SELECT count(*) FROM metrics  -- annotations", 1)
    assert hints == [
        f"metrics shows 0 rows of pipeline second; all_metrics has those of first (1 row), too, and "
        f"`kinedex use {store.path} NAME` shows another pipeline"
    ]
    assert hidden_rows_hints(store, "FROM annotations", 2) == []
    assert len(hidden_rows_hints(store, "FROM annotations WHERE class = 'metrics'", 0)) == 1
    assert hidden_rows_hints(store, "FROM all_metrics", 0) == hidden_rows_hints(store, "FROM takes", 0) == []
    shown = CliRunner().invoke(app, ["sql", str(store.path), "FROM metrics"])
    assert (shown.exit_code, shown.stderr) == (0, hidden_rows_hints(store, "FROM metrics", 0)[0] + "\n")


def test_the_chosen_pipeline_stays_until_the_choice_ends(store: Store) -> None:
    assert current_pipeline(change(store, "first").manifest) == "first"
    with StoreWriter.open(store.path, BODY) as writer:
        writer.record_run("second")
        assert current_pipeline(writer.commit()) == "first"
    latest = change(store, None).manifest
    assert current_pipeline(latest) == "second"
    assert latest.changes == {"current_pipeline": ["second"]}
    with pytest.raises(StoreError, match=r"no pipeline 'frist'; it has results of .*did you mean 'first'"):
        change(store, "frist")


def test_a_store_of_an_older_kinedex_shows_the_pipeline_that_finished_last(store: Store) -> None:
    old = replace(store.manifest, recent_pipelines=(), pipelines={})
    assert current_pipeline(old) == "third"
    assert shown_pipeline(old, "annotations") == "second"
    nothing = replace(old, results={}, stages={})
    assert [shown_pipeline(nothing, kind) for kind in PIPELINE_KINDS] == [None] * len(PIPELINE_KINDS)


def test_what_is_known_of_files_is_shown_as_the_last_ingest_of_a_folder_left_it(store: Store) -> None:
    with StoreWriter.open(store.path, BODY) as writer:
        put(writer, "source_files", "first/ingest", "ingest", 5)
        put(writer, "source_files", "second/ingest", "ingest", 6)
        put(writer, "source_files", "other/ingest", "ingest", 7)
        put(writer, "hits", "search/kicks", "", 2)
        put(writer, "hits", "search/jumps", "", 3)
        manifest = writer.commit()
    assert len(shown_parts(manifest, "source_files")) == 3  # where no folder is on record, as in an old store
    sources = {"/a": Source("second/ingest", {}, ""), "/b": Source("other/ingest", {}, "")}
    shown = shown_parts(replace(manifest, sources=sources), "source_files")
    assert {part.stage for part in shown} == {"second/ingest", "other/ingest"}
    assert counts(open_store(store.path), "hits") == counts(open_store(store.path), "all_hits") == {None: 5}


def test_every_view_of_results_has_a_twin_with_all_rows(store: Store) -> None:
    with store.connect() as connection:
        names = {row[0] for row in connection.execute("SELECT view_name FROM duckdb_views()").fetchall()}
        assert {f"all_{kind}" for kind in PIPELINE_KINDS} <= names
    listed = store.sql("SELECT DISTINCT table_name AS name FROM information_schema.columns").column("name")
    assert {"all_annotations", "all_hits", "pipeline_runs"} <= set(listed.to_pylist())
    plan = store.sql("EXPLAIN FROM all_annotations WHERE pipeline = 'first'").column(1)[0].as_py()
    assert plan.count("READ_PARQUET") == 1  # the parts of other pipelines are not opened
