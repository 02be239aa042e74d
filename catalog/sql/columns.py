"""Define classes that describe SQL views, with the types and meanings of columns and an example query."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Column:
    """A column of a view: its name, DuckDB type and meaning."""

    name: str
    type: str
    meaning: str


@dataclass(frozen=True)
class View:
    """A relation that analysts query by name.

    Attributes
    ----------
    name : str
        The name of the view.
    origin : str
        The source of its rows: "index" (a table of the published index), "parts" (the store's Parquet files), "results"
        (Parquet files of the current pipeline), "pipelines" (the manifest), "labels" (labels given by people) or
        "derived" (other views, selected by `body`).
    summary : str
        The purpose of the view in one sentence.
    columns : tuple of Column
        The columns of the view.
    example : str
        A query that runs on any store.
    body : str
        The SELECT statement of a view that is derived from other views.
    stored : tuple of Column
        For a view of results, the columns of its Parquet files.
    stages : tuple of str
        For a view of results, the kinds of stages that write its rows.
    """

    name: str
    origin: Literal["index", "parts", "labels", "results", "pipelines", "derived"]
    summary: str
    columns: tuple[Column, ...]
    example: str
    body: str = ""
    stored: tuple[Column, ...] = ()
    stages: tuple[str, ...] = ()


def columns(text: str) -> tuple[Column, ...]:
    """Parse columns from lines of name, type and meaning, separated by two spaces or more."""
    rows = (re.split(r"\s{2,}", line.strip(), maxsplit=2) for line in text.strip().splitlines())
    return tuple(Column(name, kind, meaning) for name, kind, meaning in rows)


TAKE = """take_id    BIGINT    id of the take
take    VARCHAR    name of the take"""
RANGE = """start    INTEGER    first frame, counted from 0
stop    INTEGER    frame after the last"""
SECONDS = f"""{RANGE}
start_seconds    DOUBLE    time of the start in seconds
stop_seconds    DOUBLE    time of the stop in seconds"""

_RUN = "run    VARCHAR    the run of a stage that wrote the row"
_ORIGIN = columns("""
pipeline    VARCHAR    the pipeline that wrote the row; NULL for rows that a command has stored
stage    VARCHAR    the stage of the pipeline that wrote the row
pipeline_run    VARCHAR    the run of the pipeline, as in `pipeline_runs`; NULL while the stage runs again
""")
ORIGIN = tuple(column.name for column in _ORIGIN)
"""The last columns of every view of results; their values are in the manifest, once for each Parquet part."""


def result_view(name: str, summary: str, text: str, example: str, stages: str = "") -> View:
    """Describe the view of a kind of results: the columns of its Parquet parts, followed by those of `ORIGIN`.

    Parameters
    ----------
    name : str
        The kind of results, which is the name of the view.
    summary : str
        The purpose of the view in one sentence.
    text : str
        Its columns, a line for each: name, DuckDB type and meaning, with two spaces or more between them. The column
        `run`, which comes first, is added.
    example : str
        A query that runs on any store.
    stages : str, optional
        The kinds of stages that write the rows, separated by spaces; empty for results that a command stores.
    """
    stored = columns(f"{_RUN}\n{text}")
    shown = (*(column for column in stored if column.name not in ORIGIN), *_ORIGIN)
    return View(name, "results", summary, shown, example, stored=stored, stages=tuple(stages.split()))
