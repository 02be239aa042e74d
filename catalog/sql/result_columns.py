"""Columns that several views of results share, and the description of one such view."""

from __future__ import annotations

from kinedex.catalog.sql.columns import View, columns

TAKE = """take_id    BIGINT    id of the take
take    VARCHAR    name of the take"""
RANGE = """start    INTEGER    first frame, from 0
stop    INTEGER    frame after the last"""
SECONDS = f"""{RANGE}
start_seconds    DOUBLE    start as time
stop_seconds    DOUBLE    stop as time"""

_RUN = "run    VARCHAR    the run of a stage that wrote the row"
_ORIGIN = columns("""
pipeline    VARCHAR    the pipeline that wrote the row; NULL for what a command has stored
stage    VARCHAR    its stage
pipeline_run    VARCHAR    the run of the pipeline, as in `pipeline_runs`; NULL while the stage runs again
""")
ORIGIN = tuple(column.name for column in _ORIGIN)
"""The last columns of every view of results, which are not in the Parquet parts but in the manifest, once a part."""


def result_view(name: str, summary: str, text: str, example: str, stages: str = "") -> View:
    """Return the view of a kind of results, with the columns of its parts and of their origin.

    Parameters
    ----------
    name : str
        The kind of results, which is the name of the view.
    summary : str
        Its purpose in one sentence.
    text : str
        Its columns, a line for each: name, DuckDB type and meaning, with two spaces or more between them. The column
        `run`, which comes first, is added.
    example : str
        A query that runs on any store.
    stages : str, optional
        The kinds of stages that make the rows, separated by spaces; none for what a command stores.
    """
    stored = columns(f"{_RUN}\n{text}")
    shown = (*(column for column in stored if column.name not in ORIGIN), *_ORIGIN)
    return View(name, "results", summary, shown, example, stored=stored, stages=tuple(stages.split()))
