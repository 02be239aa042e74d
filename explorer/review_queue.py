"""The queue of doubtful annotations: `POST /api/labels/queue`, the least confident first, with nearest examples.

{stage?, classes?: [name], takes?: [name], where?: SQL over annotations, decided?: false, offset, limit ≤ 100}
→ {stage, total, open, accepted, rejected, offset, command, python, rows: [{take_id, take, class, subclass, start, stop,
   cost, confidence, verdict, label, nearest: {take_id, take, start, stop} or null}]}
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import polars as pl
from pydantic import Field

from kinedex.explorer.answers import command_line, python_lines
from kinedex.explorer.endpoints import RequestBody, post
from kinedex.explorer.labels import stage_of
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.labels.row_selection import RowSelection, least_confident_first, selected_rows
from kinedex.pipelines.templates.stored_clips import nearest_examples
from kinedex.pipelines.templates.template_learning import read_templates
from kinedex.storage.duckdb_sql import quote
from kinedex.storage.store.store import Store, data_frame

if TYPE_CHECKING:
    from starlette.requests import Request

    from kinedex.explorer.open_archive import Archive

Row = dict[str, Any]

BLOCK = 100
"""Maximum number of annotations of one answer."""

_PLACE = ["take", "start", "stop"]


class QueueRequest(RequestBody):
    """A request for a block of the queue."""

    stage: str | None = None
    classes: tuple[str, ...] = ()
    takes: tuple[str, ...] = ()
    where: str | None = None
    decided: bool = False
    offset: Annotated[int, Field(ge=0)] = 0
    limit: Annotated[int, Field(ge=0, le=BLOCK)] = 20


def review_queue(archive: Archive, asked: QueueRequest, _request: Request) -> Row:
    """Return a block of the queue; annotations with a decision of a person are in it only if `decided` is true."""
    store = archive.store()
    stage = stage_of(store, asked.stage)
    if stage is None:
        return {"stage": None, "total": 0, "open": 0, "accepted": 0, "rejected": 0, "offset": 0, "rows": []}
    where = (asked.where or "").strip() or None
    chosen = RowSelection(asked.takes, asked.classes, where=where, every=True)
    annotations = store.result("annotations", run=store.manifest.stages[stage].run)
    found = with_verdicts(store, least_confident_first(selected_rows(annotations, chosen, "annotation")))
    counts = dict(found.group_by("verdict").len().iter_rows())
    shown = found if asked.decided else found.filter(pl.col("verdict").is_null())
    rows = shown.slice(asked.offset, asked.limit).to_dicts()
    with archive.kernels:
        nearest = _nearest(store, stage, rows)
    keys = ("take", "class", "subclass", "start", "stop", "cost", "confidence", "verdict", "label")
    ordered = f"SELECT * FROM annotations{_clause(asked, where)} ORDER BY confidence, take, start"
    return {
        "stage": stage,
        "total": found.height,
        "open": counts.get(None, 0),
        "accepted": counts.get("positive", 0),
        "rejected": counts.get("negative", 0),
        "offset": asked.offset,
        "rows": [
            {key: row[key] for key in keys}
            | {
                "take_id": store.take_ids.get(row["take"]),
                "nearest": nearest.get((row["take"], row["class"], row["start"], row["stop"])),
            }
            for row in rows
        ],
        "command": command_line("kinedex", "sql", archive.path, ordered),
        "python": python_lines(archive.path, f"store.sql({ordered!r})"),
    }


def _clause(asked: QueueRequest, where: str | None) -> str:
    """Return the filters of a request as a WHERE clause that begins with a space; empty without filters."""
    takes, classes = (", ".join(map(quote, names)) for names in (asked.takes, asked.classes))
    parts = [f"({where}\n)" if "--" in where else f"({where})"] if where else []
    parts += [f"take IN ({takes})"] if takes else []
    parts += [f'("class" IN ({classes}) OR subclass IN ({classes}))'] if classes else []
    return f" WHERE {' AND '.join(parts)}" if parts else ""


def with_verdicts(store: Store, annotations: pl.DataFrame) -> pl.DataFrame:
    """Return annotations with the verdict of the label that decides on each, and its id as `label`.

    A label decides on an annotation of its class or subclass that has the same start and stop. A corrected label also
    decides on all annotations that it overlaps, and any other positive label on those with which its intersection over
    union is at least 0.5, because annotations of newly learned templates begin and end at slightly other frames.
    """
    labels = data_frame(store.labels()).filter(pl.col("limb").is_null())
    labels = labels.select("take", "start", "stop", pl.col("class").alias("named"), "verdict", "id", "origin")
    known = annotations.with_row_index("row")
    same = known.join(labels, on=_PLACE).filter(_has_name())
    others = labels.filter((pl.col("origin") == "corrected") | (pl.col("verdict") == "positive"))
    moved = known.join(others, on="take", suffix="_label").filter(_has_name())
    common = pl.min_horizontal("stop", "stop_label") - pl.max_horizontal("start", "start_label")
    whole = pl.max_horizontal("stop", "stop_label") - pl.min_horizontal("start", "start_label")
    moved = moved.filter((common > 0) & ((pl.col("origin") == "corrected") | (2 * common >= whole)))
    columns = ["row", "verdict", pl.col("id").alias("label")]
    decided = pl.concat([same.select(columns), moved.select(columns)]).unique("row", keep="first", maintain_order=True)
    return known.join(decided, on="row", how="left", maintain_order="left").drop("row")


def _has_name() -> pl.Expr:
    return (pl.col("named") == pl.col("class")) | (pl.col("named") == pl.col("subclass")).fill_null(False)


def _nearest(store: Store, stage: str, rows: list[Row]) -> dict[tuple[str, str, int, int], Row]:
    """Return the nearest example of each annotation; an empty dict if the templates no longer exist."""
    record = store.manifest.stages[stage]
    name = record.summary.get("inputs", {}).get("templates")
    if name is None or not rows:
        return {}
    kind = record.summary.get("params", {}).get("templates", "soft")
    try:
        templates = read_templates(store, f"{stage.partition('/')[0]}/{name}", kind)
    except KinedexError:
        return {}
    hits = {
        (row["take"], row["class"], row["start"], row["stop"]): row["subclass"]
        for row in rows
        if row["take"] in store.take_ids
    }
    found = nearest_examples(store, hits, templates)
    return {
        key: {"take_id": store.take_ids[one.take], "take": one.take, "start": one.start, "stop": one.stop}
        for key, one in found.items()
    }


routes = [post("/api/labels/queue", review_queue, QueueRequest)]
