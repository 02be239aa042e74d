"""Runs of pipelines: the list of pipelines, the plan of a run, its start, the history, its reports, and the metrics.

`GET /api/pipelines` → {pipelines: [{id, name, description, path, shipped, problem, settings}]}, with settings as
{name, default, last};
`POST /api/runs/plan {pipeline, settings}` → {stages: [{stage, uses, inputs, reason, what, finished,
seconds}], problem}, where `problem` is null or {setting, message}; `POST /api/runs` with the same body starts a job;
`GET /api/runs` → {runs, total}, the newest first; `GET /api/runs/metrics` → {rows}. `pipeline` is an `id` of the list.

A pipeline is a shipped one, or one that the store has run and whose file still exists. Settings are the texts of
`--set`; the code that reads pipeline files checks them before a job begins, and they are words of an argument list.

`GET /api/reports/NAME` answers with a file that a stage wrote. A report is a page with inline scripts and with names
that anybody may have chosen. Its content policy gives it a separate origin, so that its scripts can read neither the
cookie of the explorer nor answers of the server.
"""

from __future__ import annotations

import re
from collections import defaultdict
from pathlib import Path
from typing import Annotated, Any

import yaml
from pydantic import Field
from starlette.requests import Request
from starlette.responses import FileResponse

from kinedex.catalog.configs import config_names, config_path, load_yaml, shipped_configs
from kinedex.explorer.answers import NotFoundError, command_line, equivalent_query
from kinedex.explorer.endpoints import RequestBody, get, post
from kinedex.explorer.jobs import Job, jobs_of, run_command
from kinedex.explorer.open_archive import Archive
from kinedex.ops.errors import ConfigError, KinedexError
from kinedex.pipelines.engine.config import Pipeline, load_pipeline
from kinedex.pipelines.engine.plan import Step, make_plan
from kinedex.storage.snapshot.visible_results import pipeline_runs
from kinedex.storage.store.history import PipelineRun, list_runs, refuse_damaged_report

Row = dict[str, Any]

MAX_RUNS = 200
"""Maximum number of runs of an answer, the newest first; `total` counts all."""

METRICS = (
    "SELECT pipeline, stage, evaluation, f1, p1, r1, f2, p2, r2 FROM all_metrics WHERE scope = 'pooled' "
    "ORDER BY f1 DESC NULLS LAST, pipeline, stage, evaluation"
)
"""The SQL query for the metrics of all evaluations."""

REPORTS = "results/reports"
"""The folder of the store with the files that stages write beside their results."""

POLICY = (
    "sandbox allow-scripts; default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src data: blob:; font-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""The content policy of a report: inline scripts run in a separate origin, and nothing is loaded from elsewhere."""

TYPES = {
    ".html": "text/html",
    ".json": "application/json",
    ".csv": "text/csv",
    ".md": "text/plain",
    ".txt": "text/plain",
}
"""A dict from file extension to media type; files with other extensions are sent as downloads."""

_SETTING = re.compile(r"\$\{([A-Za-z_][A-Za-z0-9_]*)\}")

Text = Annotated[str, Field(max_length=10_000, pattern=r"^[^\x00]*$")]
"""A text that can be an argument of a command: limited in length, and without NUL."""


class RunRequest(RequestBody):
    """A request with a pipeline, and texts for its settings and stage parameters, as `--set` takes them."""

    pipeline: Text
    settings: dict[Text, Text] = Field(default_factory=dict)


def list_pipelines(archive: Archive, _request: Request) -> Row:
    """Return the pipelines that can be run, the shipped ones first."""
    last = {run.pipeline: run for run in list_runs(archive.path)}
    return {
        "pipelines": [_described(id, path, last) for id, path in _files(archive).items()],
        "command": command_line("kinedex", "history", "list", archive.path),
    }


def _files(archive: Archive) -> dict[str, Path]:
    """Return a dict from id to file of pipelines: shipped ones by name, and others that the store has run by path."""
    found = {name: config_path("pipelines", name) for name in config_names("pipelines")}
    for run in list_runs(archive.path):
        path = Path(run.path)
        is_own = path.is_absolute() and path.suffix == ".yaml" and path.parent != shipped_configs() / "pipelines"
        if is_own and path.is_file():
            found[str(path)] = path
    return found


def _described(id: str, path: Path, last: dict[str, PipelineRun]) -> Row:
    """Return a pipeline with the settings of its last run; `problem` has the error if its file is invalid."""
    row = {"id": id, "name": path.stem, "description": "", "path": str(path), "shipped": id != str(path)}
    try:
        content = load_yaml(path).mapping()
    except KinedexError as fault:
        return row | {"settings": [], "problem": str(fault)}
    name = str(content.get("name") or path.stem)
    before = last[name].settings if name in last else {}
    settings = content.get("settings")
    known = settings if isinstance(settings, dict) else {}
    shown = [
        {"name": str(key), "default": _text(value), "last": _text(before.get(key))} for key, value in known.items()
    ]
    return row | {
        "name": name,
        "description": str(content.get("description") or ""),
        "settings": shown,
        "problem": None,
    }


def _text(value: object) -> str | None:
    """Format a value as text for the option `--set`; None stays None."""
    if value is None or isinstance(value, str):
        return value
    return (
        yaml.safe_dump(value, default_flow_style=True, allow_unicode=True, width=10_000).removesuffix("...\n").strip()
    )


def plan(archive: Archive, asked: RunRequest, _request: Request) -> Row:
    """Return the stages of a pipeline with the reasons for which they would run, or the setting that is invalid."""
    path = _file(archive, asked.pipeline)
    words = [word for one in _assignments(asked) for word in ("--set", one)]
    same = {"command": command_line("kinedex", "plan", asked.pipeline, "--store", archive.path, *words)}
    try:
        steps = make_plan(_load(path, asked), archive.path)
    except KinedexError as fault:
        return {"stages": [], "problem": {"setting": _wrong_setting(path, asked, fault), "message": str(fault)}, **same}
    return {"stages": [_step_row(step) for step in steps], "problem": None, **same}


def _file(archive: Archive, id: str) -> Path:
    path = _files(archive).get(id)
    if path is None:
        raise NotFoundError(f"no pipeline {id} is shipped, and this store has run none with such a file")
    return path


def _assignments(asked: RunRequest) -> list[str]:
    for name in asked.settings:
        if not re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.-]*", name):
            raise KinedexError(f"settings: {name!r} is no name of a setting; expected NAME or STAGE.PARAMETER")
    return [f"{name}={text}" for name, text in asked.settings.items()]


def _load(path: Path, asked: RunRequest) -> Pipeline:
    """Return the pipeline with the settings filled in and checked."""
    _assignments(asked)
    return load_pipeline(path, asked.settings)


def _wrong_setting(path: Path, asked: RunRequest, fault: KinedexError) -> str | None:
    """Return the setting that an error is about; None where it is about something else."""
    given = re.match(r"--set ([A-Za-z0-9_.-]+)", str(fault))
    if given is not None:
        return str(given[1]) if given[1] in asked.settings else None
    if not isinstance(fault, ConfigError) or not fault.key:
        return next((name for name, text in asked.settings.items() if str(fault).startswith(f"{name} '{text}'")), None)
    keys: list[str] = re.findall(r"[^.\[\]]+", fault.key)
    if keys[0] == "settings" and len(keys) > 1:
        return keys[1]
    value: Any = load_yaml(path).data
    for key in keys:
        value = value.get(key) if isinstance(value, dict) else value
    names = _SETTING.findall(value) if isinstance(value, str) else []
    return str(names[0]) if names else None


def _step_row(step: Step) -> Row:
    return {
        "stage": step.stage.name,
        "uses": step.stage.uses,
        "inputs": sorted(set(step.stage.inputs.values())),
        "reason": step.reason,
        "what": step.what,
        "finished": step.record and step.record.finished,
        "seconds": step.record and step.record.seconds,
    }


def start(archive: Archive, asked: RunRequest, _request: Request) -> Row:
    """Check the settings of a pipeline, start a job that runs it, and return the job as a JSON object."""
    pipeline = _load(_file(archive, asked.pipeline), asked)
    words = run_command(archive, asked.pipeline, _assignments(asked))
    return jobs_of(archive).add(Job(f"Run {pipeline.name}", words, len(pipeline.stages))).shown()


def list_history(archive: Archive, _request: Request) -> Row:
    """Return the runs of pipelines, the newest first, each with what ran, what was skipped, and why."""
    store = archive.store()
    shown = {row["pipeline_run"]: row for row in pipeline_runs(store.manifest).to_pylist()}
    reports = report_names(archive)
    runs = list_runs(archive.path)[::-1]
    return {
        "runs": [_run_row(run, shown.get(run.run), reports) for run in runs[:MAX_RUNS]],
        "total": len(runs),
        "command": command_line("kinedex", "history", "list", archive.path),
    }


def _run_row(run: PipelineRun, results: Row | None, reports: dict[tuple[str, str], list[str]]) -> Row:
    """Return a run as a JSON object, with the reports of stages whose current results are of this run."""
    stages = [
        {"stage": one.stage, "state": one.state, "reason": one.reason, "seconds": one.seconds} for one in run.stages
    ]
    own = [name for one in run.ran for name in reports.get((f"{run.pipeline}/{one.stage}", one.run), [])]
    return {
        "run": run.run, "pipeline": run.pipeline, "state": run.state, "begun": run.begun or run.finished,
        "seconds": run.seconds, "version": run.version or None, "problem": run.problem or None,
        "kinedex": run.kinedex, "written_by": run.command, "settings": run.settings, "stages": stages,
        "reports": own, "views": results["views"] if results else [], "current": bool(results and results["current"]),
    }  # fmt: skip


def compare(archive: Archive, _request: Request) -> Row:
    """Return precision, recall and F of every evaluation that the store holds, the best F (frames) first."""
    return {"rows": archive.store().sql(METRICS).to_pylist(), **equivalent_query(archive, METRICS)}


def report_names(archive: Archive) -> dict[tuple[str, str], list[str]]:
    """Return a dict from (stage, stage run) to the files that it wrote, relative to the folder of reports."""
    found: dict[tuple[str, str], list[str]] = defaultdict(list)
    for key, record in archive.store().manifest.stages.items():
        for name in record.summary.get("files", ()):
            if isinstance(name, str) and name.startswith(f"{REPORTS}/"):
                found[key, record.run].append(name.removeprefix(f"{REPORTS}/"))
    return dict(found)


def report_file(archive: Archive, name: str) -> Path:
    """Return the path of a report.

    Raises
    ------
    NotFoundError
        No stage of the store has written a file of this name, or the file no longer exists, or lies outside of the
        folder.
    StoreError
        The file has changed since its stage wrote it.
    """
    folder = (archive.path / REPORTS).resolve()
    path = (folder / name).resolve()
    is_known = any(name in names for names in report_names(archive).values())
    if not is_known or not path.is_relative_to(folder) or not path.is_file():
        raise NotFoundError(f"no report of this store has the name {name}; the page Runs lists those that there are")
    refuse_damaged_report(path)
    return path


def send_report(archive: Archive, request: Request) -> FileResponse:
    """Return the response with the file of a report."""
    path = report_file(archive, request.path_params["name"])
    kind = TYPES.get(path.suffix.lower())
    headers = {
        "content-security-policy": POLICY,
        "cross-origin-opener-policy": "unsafe-none",  # browsers block a sandboxed page with any other
        "cache-control": "no-store",
    }
    saved_as = None if kind else path.name
    return FileResponse(path, headers=headers, media_type=kind or "application/octet-stream", filename=saved_as)


routes = [
    get("/api/pipelines", list_pipelines),
    get("/api/runs", list_history),
    get("/api/runs/metrics", compare),
    get("/api/reports/{name:path}", send_report),
    post("/api/runs/plan", plan, RunRequest),
    post("/api/runs", start, RunRequest, writes=True),
]
