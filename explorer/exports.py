"""Export: the plan of a data set with its splits and sizes, and the job that writes it.

    GET /api/export → {forms: [{name, meaning}], job: the last export of this server or null}
    POST /api/export/plan {what, how, filters?, hits?, folder?} → the plan (`plan_export`); nothing stays on disk
    POST /api/export {the same, folder, planned?} → a job, whose command is that of the plan
    GET /api/export/ID → what a job has written: {folder, files, bytes, excluded, command}

`what` and `how` have the fields of `IntervalSource` and `ClipOptions` of `pipelines.export.request`. A server that is
read only shows plans and refuses to write: an export writes files, although none into the store.
"""

from __future__ import annotations

import os
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field
from starlette.requests import Request

from kinedex.explorer.answers import NotFoundError, command_line, python_lines
from kinedex.explorer.endpoints import RequestBody, get, post
from kinedex.explorer.hits import take_condition
from kinedex.explorer.jobs import Job, jobs_of
from kinedex.explorer.open_archive import Archive
from kinedex.explorer.selections import SQL_SECONDS, Filter, Selection
from kinedex.ops.errors import ConflictError, KinedexError
from kinedex.ops.local_paths import refuse_addresses
from kinedex.pipelines.engine.display import no_progress
from kinedex.pipelines.export.clip_batches import Done
from kinedex.pipelines.export.data_set_record import Facts, data_set_text, metadata_rows, metadata_text, split_facts
from kinedex.pipelines.export.export_plan import Plan, estimated_bytes, plan_clips
from kinedex.pipelines.export.request import FILE_FORMATS, ClipOptions, IntervalSource
from kinedex.storage.duckdb_sql import quote
from kinedex.storage.formats.data_set_folder import (
    CLIPS,
    DATA_SET,
    METADATA,
    SPLITS,
    WrittenFile,
    require_own,
    written_by,
)
from kinedex.storage.store.store import Store

Row = dict[str, Any]

TITLE = "Export"

MAX_HITS = 1000
"""Maximum number of hits of a request, because they are written into the command line, whose length systems limit."""

NAMES = {"hits": "name the saved hits", "ranges": "name the file", "sql": "write a query"}
"""A dict from each source of clips that needs a name to the error message if the name is missing."""

Name = Annotated[str, Field(min_length=1, max_length=500)]
Frame = Annotated[int, Field(ge=0)]


class ExportedHit(RequestBody):
    """An interval that another page passes on; `mirrored` if it matches the mirror image of a template or query."""

    take: Name
    start: Frame
    stop: Frame
    label: Name | None = Field(None, alias="class")
    mirrored: bool = False


class ExportRequest(RequestBody):
    """A request to plan or write an export.

    `what` and `how` are the selection and the form of the data set, `filters` restrict its takes further, `hits`
    replace the source of `what`, and `folder` is written to. `planned` is the `state` of the plan that the page has
    shown: if the store has changed since then, nothing is written.
    """

    what: IntervalSource = IntervalSource()
    how: ClipOptions = ClipOptions()
    filters: tuple[Filter, ...] = ()
    hits: Annotated[tuple[ExportedHit, ...], Field(max_length=MAX_HITS)] = ()
    folder: Annotated[str, Field(max_length=4000)] | None = None
    planned: str | None = None


def export_facts(archive: Archive, _request: Request) -> Row:
    """Return the formats of exports, and the job of the last export of this server."""
    last = [job for job in jobs_of(archive).every() if job.title == TITLE]
    return {
        "forms": [{"name": name, "meaning": form.meaning} for name, form in FILE_FORMATS.items()],
        "job": last[-1].shown() if last else None,
    }


def request_of(store: Store, asked: ExportRequest) -> IntervalSource:
    """Return the intervals that a request of the page exports, in the form that pipelines use."""
    kind, name = asked.what.kind, asked.what.name
    if asked.hits:
        kind, name = "sql", _hits_query(asked.hits)
    if kind in NAMES and not str(name or "").strip():
        raise KinedexError(NAMES[kind])
    chosen = Selection(where=asked.what.where, filters=asked.filters)
    where = take_condition(store, chosen)
    given = Path(str(name)).expanduser() if kind == "ranges" else name if kind in NAMES else None
    return replace(asked.what, kind=kind, name=given, where=where, pipeline=asked.what.pipeline or None)


def _hits_query(hits: tuple[ExportedHit, ...]) -> str:
    """Return a SQL query whose rows are the hits; it has a column `mirror_image` if some hits are mirrored."""
    mirrored = any(one.mirrored for one in hits)
    rows = ", ".join(
        f"({quote(one.take)}, {one.start}, {one.stop}, {'NULL' if one.label is None else quote(one.label)}"
        f"{f', {one.mirrored}'.lower() if mirrored else ''})"
        for one in hits
    )
    more = ", mirror_image" if mirrored else ""
    query = f'SELECT * FROM (VALUES {rows}) AS hits(take, "start", stop, "class"{more})'
    if len(query.encode()) > 100_000:
        raise KinedexError("these hits are too many for a command line; save them as ranges.csv and export that file")
    return query


def folder_of(archive: Archive, text: str) -> Path:
    """Return the path of the folder that the user has typed, after checks.

    Raises
    ------
    KinedexError
        The path is not absolute, lies in the store or around it, or is a folder with files that no export has written.
    """
    refuse_addresses(text.strip())
    folder = Path(text.strip()).expanduser()
    if not folder.is_absolute() or "\0" in text:
        raise KinedexError(f"folder {text.strip()!r}: expected an absolute path, such as {Path.home() / 'clips'}")
    there, store = folder.resolve(), archive.path.resolve()
    if there == store or store in there.parents or there in store.parents:
        raise KinedexError(f"{folder}: lies in the store or around it; choose a folder beside {archive.path}")
    require_own(folder)
    return folder


def export_command(archive: Archive, what: IntervalSource, how: ClipOptions, folder: str) -> tuple[str, ...]:
    """Return the arguments of the `kinedex export` command that performs a request."""
    plain = ClipOptions()
    words = [
        "export",
        str(archive.path),
        f"--output={folder.rstrip(os.sep)}{os.sep}",
        f"--format={how.form}",
    ]
    words += {"takes": [], "annotations": ["--annotations"], "labels": ["--labels"]}.get(
        what.kind, [f"--{what.kind}={what.name}"]
    )
    words += [f"--where={what.where}"] if what.where else []
    words += [f"--class={name}" for name in what.classes]
    words += [f"--pipeline={what.pipeline}"] if what.pipeline else []
    words += [f"--min-confidence={what.min_confidence!r}"] if what.min_confidence is not None else []
    for name, unit in (("margin", "s"), ("context", "s"), ("min_length", "s"), ("distinct", "m")):
        value = getattr(how, name)
        words += [f"--{name.replace('_', '-')}={_decimal(value)}{unit}"] if value else []
    words += [
        f"--{name.replace('_', '-')}" for name in ("joints", "mirror", "in_place", "balance") if getattr(how, name)
    ]
    words += [f"--resample={how.rate_hz!r}"] if how.rate_hz is not None else []
    words += [f"--split={how.split}"] if how.split else []
    words += [f"--shares={','.join(map(repr, how.shares))}"] if how.shares != plain.shares else []
    words += [f"--seed={how.seed}"] if how.seed else []
    words += [f"--per-class={how.per_class}"] if how.per_class is not None else []
    return (*words, *(["--", *what.takes] if what.takes else []))


_ARGUMENTS = {"form": "format", "rate_hz": "resample"}
"""A dict from fields of `ClipOptions` to their names as arguments of `Store.export`, where these differ."""


def python_line(what: IntervalSource, how: ClipOptions, folder: str) -> str:
    """Return the line of Python that performs a request."""
    named: Row = {} if what.kind == "takes" else {what.kind: True if what.kind not in NAMES else str(what.name)}
    parts = {"where": what.where, "classes": what.classes, "pipeline": what.pipeline}
    named |= {key: value for key, value in parts.items() if value}
    named |= {} if what.min_confidence is None else {"min_confidence": what.min_confidence}
    changed = {key: value for key, value in vars(how).items() if value != getattr(ClipOptions(), key)}
    named |= {"format": how.form} | {_ARGUMENTS.get(key, key): value for key, value in changed.items()}
    takes = [repr(list(what.takes))] if what.takes else []
    return f"store.export({', '.join([repr(folder), *takes, *(f'{key}={value!r}' for key, value in named.items())])})"


def _decimal(value: float) -> str:
    return f"{value:.9f}".rstrip("0").rstrip(".")


def plan_export(archive: Archive, asked: ExportRequest, _request: Request) -> Row:
    """Return the plan of an export: its clips, splits and sizes.

    Returns
    -------
    dict
        `clips`, `takes`, `files`, `seconds` and `bytes` of the whole (bytes None where no clip of the sample can be
        written), `splits` as in dataset.json, `rows` with clips, seconds and bytes of each class of each split,
        `remarks` about what is left out, `estimate`, which describes the sample, `earlier`, which is True if the folder
        has an earlier export that would be replaced, `state`, that of the store, and `command` and `python`.
    """
    state = archive.state()
    store = archive.store()
    what, how = request_of(store, asked), asked.how
    folder = folder_of(archive, asked.folder) if asked.folder and asked.folder.strip() else None
    if what.kind == "sql":
        store.answer(str(what.name), timeout=SQL_SECONDS)
    plan = plan_clips(store, what, how, no_progress)
    with archive.kernels:
        sizes = estimated_bytes(store, how, plan)
    rows, record = _records(store, what, how, plan)
    known = None if sizes.clips is None else sum(sizes.clips) + record
    return {
        "clips": len(plan.jobs),
        "takes": len({job.clip.take for job in plan.jobs}),
        "files": sum(len(job.files) for job in plan.jobs) + 2,
        "seconds": sum(row["seconds"] for row in rows),
        "bytes": known,
        "estimate": sizes.remark,
        "splits": split_facts(rows, how),
        "rows": _by_class(rows, sizes.clips),
        "remarks": list(plan.remarks),
        "earlier": folder is not None and folder.is_dir() and bool(os.listdir(folder)),
        "state": state["labels"],
        "version": state["version"],
        "command": command_line("kinedex", *export_command(archive, what, how, str(folder or "FOLDER"))),
        "python": python_lines(archive.path, python_line(what, how, str(folder or "FOLDER"))),
    }


def _records(store: Store, what: IntervalSource, how: ClipOptions, plan: Plan) -> tuple[list[Row], int]:
    """Return the rows of metadata.csv, and the size in bytes of metadata.csv and dataset.json together, by the plan."""
    done = [Done(job, tuple(WrittenFile(file, job.fingerprint, "0" * 64) for file in job.files)) for job in plan.jobs]
    facts = Facts(store, what, how, {}, plan.remarks)
    rows = metadata_rows(facts, done)
    return rows, len(metadata_text(rows).encode()) + len(data_set_text(facts, rows, done).encode())


_ORDER = (*SPLITS, CLIPS)


def _by_class(rows: list[Row], sizes: list[int] | None) -> list[Row]:
    """Return clips, seconds and bytes of each class of each split; bytes are None without `sizes`."""
    groups: dict[tuple[str, str], list[int]] = defaultdict(list)
    for number, row in enumerate(rows):
        groups[row["split"] or CLIPS, row["class"] or ""].append(number)
    return [
        {
            "split": split,
            "class": label or None,
            "clips": len(numbers),
            "seconds": float(np.sum([rows[number]["seconds"] for number in numbers])),
            "bytes": None if sizes is None else sum(sizes[number] for number in numbers),
        }
        for (split, label), numbers in sorted(groups.items(), key=lambda one: (_ORDER.index(one[0][0]), one[0][1]))
    ]


def write_export(archive: Archive, asked: ExportRequest, _request: Request) -> Row:
    """Start a job that writes an export, and return it as a JSON object."""
    if not asked.folder or not asked.folder.strip():
        raise KinedexError("the folder is missing: name one that does not exist yet, or is empty")
    folder = folder_of(archive, asked.folder)

    def check() -> None:
        if asked.planned is not None and archive.state(look=True)["labels"] != asked.planned:
            raise ConflictError("the store has changed since this was planned; look at the plan and write again")

    check()
    words = export_command(archive, request_of(archive.store(), asked), asked.how, str(folder))
    return jobs_of(archive).add(Job(TITLE, words, check=check)).shown()


def written_export(archive: Archive, request: Request) -> Row:
    """Return what an export of this server has written."""
    job = jobs_of(archive).find(request.path_params["job"])
    if job.title != TITLE:
        raise NotFoundError(f"the job {job.id} is no export")
    folder = Path(next(word for word in job.words if word.startswith("--output=")).removeprefix("--output="))
    files, excluded = written_by(folder)
    paths = [folder / name for name in (*files, DATA_SET, METADATA)]
    there = [path for path in paths if path.is_file()]
    return {
        "folder": str(folder),
        "files": len(there),
        "bytes": sum(path.stat().st_size for path in there),
        "excluded": excluded,
        "command": command_line("kinedex", *job.words),
    }


routes = [
    get("/api/export", export_facts),
    post("/api/export/plan", plan_export, ExportRequest),
    post("/api/export", write_export, ExportRequest, writes=True),
    get("/api/export/{job}", written_export),
]
