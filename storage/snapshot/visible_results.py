"""Choose the results that a store shows under the plain names of views: those of the latest run of one pipeline.

Each kind of results is shown for one pipeline only, so that no query adds up the rows of two pipelines. This is the
current pipeline or, if none of its stages makes the kind, the latest pipeline with a stage that does. Results about
source files are those of the last ingest of each folder, by any pipeline, and saved hits are always shown. Views with
the prefix `all_` show the rows of every pipeline.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from contextlib import suppress
from datetime import UTC, datetime
from typing import Any

import pyarrow as pa

from kinedex.catalog.sql.result_views import RESULT_VIEWS, SAVED_KINDS, SOURCE_KINDS
from kinedex.catalog.sql.views import VIEWS
from kinedex.storage.snapshot.manifest import Manifest, ResultPart, StageRecord
from kinedex.storage.snapshot.schemas import arrow_type

PIPELINE_KINDS = tuple(view.name for view in RESULT_VIEWS if view.name not in (*SAVED_KINDS, *SOURCE_KINDS))
"""The kinds of results that belong to a pipeline."""

READER_OF_SENSORS = "read_imu"
"""The kind of stage that reads sensors; its rejected files are shown beside those of ingests, which make takes."""

_STAGES_OF = {view.name: frozenset(view.stages) for view in RESULT_VIEWS}
_STAGE_KINDS = frozenset(stage for kind in PIPELINE_KINDS for stage in _STAGES_OF[kind])
_RUN_COLUMNS = [(column.name, column.type) for view in VIEWS if view.name == "pipeline_runs" for column in view.columns]


def makes_results(stage_kinds: Iterable[str]) -> bool:
    """Return whether a pipeline with stages of these kinds makes results, so that it can be the current one."""
    return not _STAGE_KINDS.isdisjoint(stage_kinds)


def pipelines_by_use(manifest: Manifest) -> tuple[str, ...]:
    """Return the pipelines with results: first the current one, then the others from the latest to the earliest."""
    finished: dict[str, str] = {}
    for key, record in manifest.stages.items():
        if record.summary.get("uses") in _STAGE_KINDS:
            name = pipeline_of(key)
            finished[name] = max(finished.get(name, ""), record.finished)
    for kind in PIPELINE_KINDS:
        for part in manifest.results.get(kind, ()):
            finished.setdefault(pipeline_of(part.stage), "")
    others = sorted(finished, key=lambda name: (finished[name], name), reverse=True)
    ordered = dict.fromkeys((manifest.chosen_pipeline, *manifest.recent_pipelines, *others))
    return tuple(name for name in ordered if name in finished)


def current_pipeline(manifest: Manifest) -> str | None:
    """Return the pipeline whose results the views show; None if no pipeline has results."""
    return next(iter(pipelines_by_use(manifest)), None)


def shown_pipeline(manifest: Manifest, kind: str) -> str | None:
    """Return the pipeline whose rows of a kind of `PIPELINE_KINDS` are shown; None if no pipeline makes the kind."""
    making = {pipeline_of(part.stage) for part in manifest.results.get(kind, ())}
    making |= {pipeline_of(key) for key, one in manifest.stages.items() if one.summary.get("uses") in _STAGES_OF[kind]}
    return next((name for name in pipelines_by_use(manifest) if name in making), None)


def shown_parts(manifest: Manifest, kind: str) -> tuple[ResultPart, ...]:
    """Return the parts of a kind of results that the view with its plain name shows."""
    parts = manifest.results.get(kind, ())
    if kind in SAVED_KINDS:
        return parts
    if kind in SOURCE_KINDS:
        last = {source.stage for source in manifest.sources.values()}
        readers = {key for key, one in manifest.stages.items() if one.summary.get("uses") == READER_OF_SENSORS}
        return tuple(part for part in parts if not last or part.stage in last | readers)
    shown = shown_pipeline(manifest, kind)
    return tuple(part for part in parts if pipeline_of(part.stage) == shown)


def all_parts(manifest: Manifest, kind: str) -> tuple[ResultPart, ...]:
    """Return the parts of a kind of results, of all pipelines."""
    return manifest.results.get(kind, ())


def pipeline_of(stage: str) -> str:
    """Return the pipeline of a stage, "<pipeline>/<stage>"."""
    return stage.partition("/")[0]


def origin_of(manifest: Manifest, kind: str, part: ResultPart) -> dict[str, str | None]:
    """Return the values of the columns pipeline, stage and pipeline_run for the rows of a part."""
    if kind in SAVED_KINDS:
        return {"pipeline": None, "stage": None, "pipeline_run": None}
    pipeline, _, stage = part.stage.partition("/")
    record = manifest.stages.get(part.stage)
    run = None if record is None else pipeline_run_of(manifest, record)
    return {"pipeline": pipeline, "stage": stage, "pipeline_run": run}


def pipeline_run_of(manifest: Manifest, record: StageRecord) -> str:
    """Return the pipeline run of a stage's last run; records of an older kinedex give only the pipeline's last run."""
    known = manifest.pipelines.get(pipeline_of(record.stage))
    return record.pipeline_run or (record.run if known is None else known.run)


def pipeline_runs(manifest: Manifest) -> pa.Table:
    """Return the rows of the view `pipeline_runs`, oldest first."""
    runs: dict[tuple[str, str], list[StageRecord]] = defaultdict(list)
    for key, record in manifest.stages.items():
        runs[pipeline_of(key), pipeline_run_of(manifest, record)].append(record)
    views: dict[str, list[str]] = defaultdict(list)
    for kind in sorted((*PIPELINE_KINDS, *SOURCE_KINDS)):
        for stage in dict.fromkeys(part.stage for part in shown_parts(manifest, kind)):
            views[stage].append(kind)
    current = current_pipeline(manifest)
    ordered = sorted(runs.items(), key=lambda one: (max(record.finished for record in one[1]), one[0]))
    rows = [_run_row(manifest, run, records, views, current) for run, records in ordered]
    schema = pa.schema([(name, arrow_type(kind)) for name, kind in _RUN_COLUMNS])
    return pa.Table.from_pylist(rows, schema=schema)


def result_pipelines(manifest: Manifest) -> pa.Table:
    """Return a row for each pipeline that has made results, the current one first.

    Columns: pipeline, finished, stages, views (which show its results under their plain names), current.
    """
    runs = pipeline_runs(manifest).to_pylist()
    rows: list[dict[str, Any]] = []
    for name in pipelines_by_use(manifest):
        own = [run for run in runs if run["pipeline"] == name]
        rows.append(
            {
                "pipeline": name,
                "finished": max((run["finished"] for run in own if run["finished"] is not None), default=None),
                "stages": [key.partition("/")[2] for key in manifest.stages if pipeline_of(key) == name],
                "views": sorted({view for run in own for view in run["views"]}),
                "current": name == current_pipeline(manifest),
            }
        )
    types = {**dict(_RUN_COLUMNS), "stages": "VARCHAR[]", "views": "VARCHAR[]"}
    columns = ("pipeline", "finished", "stages", "views", "current")
    return pa.Table.from_pylist(rows, schema=pa.schema([(name, arrow_type(types[name])) for name in columns]))


def _moment(text: str) -> datetime | None:
    """Return the time of a record; None if it is not valid, so that the other records can still be shown."""
    with suppress(ValueError):
        found = datetime.fromisoformat(text)
        return found if found.tzinfo else found.replace(tzinfo=UTC)
    return None


def _run_row(
    manifest: Manifest,
    run: tuple[str, str],
    records: list[StageRecord],
    views: dict[str, list[str]],
    current: str | None,
) -> dict[str, Any]:
    pipeline, pipeline_run = run
    known = manifest.pipelines.get(pipeline)
    same = known if known is not None and known.run == pipeline_run else None
    return {
        "pipeline": pipeline,
        "pipeline_run": pipeline_run,
        "finished": _moment(max(record.finished for record in records)),
        "seconds": sum(record.seconds for record in records),
        "stages": [record.stage.partition("/")[2] for record in records],
        "views": sorted({view for record in records for view in views[record.stage]}),
        "command": next((one.command for one in records if one.command), same.command if same else None) or None,
        "kinedex": next((one.kinedex for one in records if one.kinedex), same.kinedex if same else None) or None,
        "current": pipeline == current,
    }
