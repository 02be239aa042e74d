"""Learn again from labels in the background: the settings, the run, the list of its changes, and undo.

`GET /api/learn` answers with `learning_facts`, `POST /api/learn {examples?, method?, where?}` starts a job,
`GET /api/learn/changes` lists the changes by the last such job, and `POST /api/learn/undo` starts a job that restores
the annotations from before it. Once the page has asked for the facts, a process is kept ready (`jobs.WarmProcess`).

The results belong to a separate pipeline, `learn-again`, which has the settings of the current annotation and the
labels of people as further examples. So the results of other pipelines remain, and former results of `learn-again` can
be restored by their version (`kinedex use STORE learn-again --at VERSION`).
"""

from __future__ import annotations

import fnmatch
import glob
import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import Field
from starlette.requests import Request

from kinedex.catalog.classes import OWN, class_files
from kinedex.catalog.configs import load_yaml
from kinedex.explorer.answers import command_line
from kinedex.explorer.endpoints import RequestBody, get, post
from kinedex.explorer.jobs import FOLDER, Job, NoRequest, jobs_of, run_command
from kinedex.explorer.labels import stage_of
from kinedex.explorer.open_archive import Archive
from kinedex.ops.errors import ConflictError, KinedexError, StoreError
from kinedex.pipelines.annotation.annotation_tables import annotation_stage
from kinedex.pipelines.annotation.methods import annotation_method
from kinedex.pipelines.labels.file_segments import SegmentDifference, segment_differences, segment_of
from kinedex.pipelines.templates.examples import CLIPS, LABELS
from kinedex.storage.durable_files import replace_file, write_errors
from kinedex.storage.formats.labels.file_labels import ManualSegment
from kinedex.storage.snapshot.visible_results import current_pipeline
from kinedex.storage.store.store import Store, open_store

Row = dict[str, Any]

PIPELINE = "learn-again"

MAX_CHANGES = 1000
"""Maximum number of changes of an answer; the numbers count all of them."""


class LearnRequest(RequestBody):
    """The settings of a run that learns again; defaults are the settings of the current annotation."""

    examples: Literal["labels", "clips and labels"] | None = None
    method: Literal["best", "numeric", "thesis"] | None = None
    where: Annotated[str, Field(max_length=10_000)] | None = None


def learning_facts(archive: Archive, _request: Request) -> Row:
    """Return the settings that learning again would use, and the versions before and after its last run.

    Returns
    -------
    dict
        `based_on`, the stage whose settings are taken (None where nothing was annotated); `examples`, `method` and
        `where`; `last`, None or the versions `before` and `after` the last run, with `undone`; and `command`, once
        there is a file of the pipeline.
    """
    store = archive.store()
    if not archive.read_only:
        jobs_of(archive).prepare()
    stages = learning_stages(store, LearnRequest())
    examples = stages["learn_templates"]["params"]["examples"]
    file = _file(archive)
    return {
        "based_on": stage_of(store, None),
        "examples": "clips and labels" if CLIPS in examples else "labels",
        "method": stages["annotate"]["params"].get("method", "thesis"),
        "where": stages["annotate"]["params"].get("where", ""),
        "last": _last(archive),
        **({"command": command_line("kinedex", *run_command(archive, file))} if file.is_file() else {}),
    }


def learning_stages(store: Store, asked: LearnRequest) -> Row:
    """Return the stages of the pipeline that learns again, as a pipeline file has them.

    Parameters
    ----------
    store : Store
        The store; the settings are those of its current annotation, if it has one.
    asked : LearnRequest
        Settings that a person has chosen.
    """
    stage = stage_of(store, None)
    templates: Row = {"examples": [LABELS]}
    annotate: Row = {"where": "true", "method": "best"}
    stages: Row = {}
    if stage is not None:
        pipeline = stage.partition("/")[0]
        record = store.manifest.stages[stage]
        inputs = record.summary.get("inputs", {})
        annotate = _given(store, stage)
        templates = _given(store, f"{pipeline}/{inputs.get('templates', '')}")
        known = templates.get("examples", [CLIPS])
        templates["examples"] = [*known, *([LABELS] if LABELS not in known else [])]
        if "keyframes" in inputs:
            keyframes = _given(store, f"{pipeline}/{inputs['keyframes']}")
            stages["learn_keyframes"] = {"params": keyframes | {"examples": templates["examples"]}}
    if asked.examples is not None:
        others = [one for one in templates["examples"] if one not in (CLIPS, LABELS)]
        templates["examples"] = [*([CLIPS] if "clips" in asked.examples else []), LABELS, *others]
    chosen = {"method": asked.method, "where": (asked.where or "").strip() or None}
    annotate |= {key: value for key, value in chosen.items() if value is not None}
    templates["methods"] = [annotate.get("templates", "soft")]  # soft or hard, whichever the annotation uses
    # few labels do not represent an archive, so each of them, rejected ones too, counts as an example of its own
    method = annotation_method(annotate.get("method", "thesis"))
    annotate["each_example"] = CLIPS not in templates["examples"] and bool(method.offers.each_example)
    if annotate["each_example"] or method.needs.templates == "none":
        annotate["store_curves"] = False  # the curves are of averaged templates, which are not used then
    return {"learn_templates": {"params": templates}, **stages, "annotate": {"params": annotate}}


def _given(store: Store, stage: str) -> Row:
    """Return the parameters that were given for the last run of a stage, without defaults."""
    record = store.manifest.stages.get(stage)
    summary = record.summary if record is not None else {}
    found: Row = dict(summary.get("given", summary.get("params", {})))
    if "${" in json.dumps(found):
        raise KinedexError(
            f"a parameter of {stage} has '${{' in it, which a pipeline file cannot repeat: run it by hand"
        )
    return found


def _file(archive: Archive) -> Path:
    return archive.path / FOLDER / f"{PIPELINE}.yaml"


def _record_file(archive: Archive) -> Path:
    return archive.path / FOLDER / f"{PIPELINE}.json"


def _last(archive: Archive) -> Row | None:
    path = _record_file(archive)
    if not path.is_file():
        return None
    try:
        found: Row = json.loads(path.read_text(encoding="utf-8"))
        return found if {"before", "after", "undone"} <= found.keys() else None
    except (ValueError, AttributeError):
        return None


def _write(path: Path, text: str) -> None:
    with write_errors(path.parent):
        path.parent.mkdir(exist_ok=True)
        replace_file(path, lambda unfinished: unfinished.write_text(text, encoding="utf-8"))


def learn(archive: Archive, asked: LearnRequest, _request: Request) -> Row:
    """Start a job that learns from labels and annotates again, and return the job as a JSON object."""
    store = archive.store()
    if any(job.title == TITLE and job.state in ("waiting", "running") for job in jobs_of(archive).every()):
        raise ConflictError("it is being learned again already; stop that job first, or wait for it")
    stages = learning_stages(store, asked)
    _put_classes(archive, store, stages)
    document = {
        "name": PIPELINE,
        "description": "Templates from the labels of people too, and annotations with them.",
        "stages": stages,
    }
    _write(_file(archive), yaml.safe_dump(document, sort_keys=False, allow_unicode=True))
    stage = stage_of(store, None)
    before = {"before": open_store(archive.path, at="newest").manifest.version, "stage": stage}

    def note(job: Job) -> None:
        after = open_store(archive.path, at="newest").manifest.version
        record = {**before, "after": after, "undone": False, "job": job.id}
        if after != before["before"]:
            _write(_record_file(archive), json.dumps(record))
        jobs_of(archive).prepare()  # somebody who has learned once is likely to learn again

    words = run_command(archive, _file(archive))
    weights = tuple(_WEIGHTS[name] for name in stages)
    return jobs_of(archive).add(Job(TITLE, words, len(stages), note, weights=weights, learns=True)).shown()


TITLE = "Learn again"

_WEIGHTS = {"learn_templates": 1.0, "learn_keyframes": 5.0, "annotate": 20.0}
"""The approximate relative durations of the stages for a large archive."""


def _put_classes(archive: Archive, store: Store, stages: Row) -> None:
    """Extend the class file of the stages by classes that people have labelled and that it lacks.

    The extended file is written beside the file of the pipeline. Without clips as examples, a class file cannot be
    used, since it names subclasses that only clips have; the classes of the labels are then used as they are.
    """
    annotate = stages["annotate"]["params"]
    files = class_files(annotate.get("classes", OWN))
    if not files:
        return
    if CLIPS not in stages["learn_templates"]["params"]["examples"]:
        annotate["classes"] = OWN
        return
    labels = store.labels().to_pylist()
    names = sorted({row["class"] for row in labels if row["verdict"] == "positive" and row["limb"] is None})
    added = classes_with(load_yaml(files[0]).mapping(), names)
    if added is not None:
        _write(path := archive.path / FOLDER / f"{PIPELINE}-classes.yaml", added)
        annotate["classes"] = str(path.absolute())


def classes_with(classes: Row, names: Sequence[str]) -> str | None:
    """Return the text of a class file with further subclasses; None if the file has all of them.

    Parameters
    ----------
    classes : dict
        Class → its subclasses, or an entry with `subclasses`, as in a class file.
    names : sequence of str
        The subclasses. A subclass that no entry contains joins the class of the same name, or becomes a new class.
    """
    entries = {
        str(name): entry if isinstance(entry, dict) else {"subclasses": entry} for name, entry in classes.items()
    }
    taken = [pattern for entry in entries.values() for pattern in entry.get("subclasses", ())]
    missing = [name for name in names if not any(fnmatch.fnmatchcase(name, pattern) for pattern in taken)]
    for name in missing:
        entry = entries.setdefault(name, {"description": "labelled by people", "subclasses": []})
        entry["subclasses"] = [*entry["subclasses"], glob.escape(name)]
    return yaml.safe_dump(entries, sort_keys=False, allow_unicode=True) if missing else None


def changes(archive: Archive, _request: Request) -> Row:
    """Return the changes by the last run: annotations that were added, removed, moved or renamed."""
    last = _last(archive)
    if last is None:
        return {"last": None, "counts": {}, "takes": 0, "total": 0, "rows": []}
    try:
        sides = [open_store(archive.path, at=last[key]) for key in ("before", "after")]
    except StoreError as fault:
        raise KinedexError(f"what was learned last cannot be compared any more: {fault}") from None
    old = _segments(sides[0], last["stage"]) if last["stage"] is not None else []
    found = [
        one for one in segment_differences(old, _segments(sides[1], f"{PIPELINE}/annotate")) if one.change != "same"
    ]
    ids = archive.store().take_ids
    rows = [_row(one, ids) for one in found[:MAX_CHANGES]]
    return {
        "last": last,
        "counts": dict(Counter(one.change for one in found)),
        "takes": len({one.shown.take for one in found}),
        "total": len(found),
        "rows": rows,
        "current": current_pipeline(archive.store().manifest),
    }


def _row(one: SegmentDifference, ids: dict[str, int]) -> Row:
    def place(segment: ManualSegment) -> Row:
        return {"class": segment.label, "start": int(segment.start), "stop": int(segment.stop)}

    take = one.shown.take
    named = {"take": take, **place(one.shown), "take_id": ids.get(take), "change": one.change}
    return {**named, "before": one.before and place(one.before)}


def _segments(store: Store, stage: str) -> list[ManualSegment]:
    rows = store.result("annotations", run=store.manifest.stages[annotation_stage(store, stage)].run)
    return list(map(segment_of, rows.to_pylist()))


def undo(archive: Archive, _asked: NoRequest, _request: Request) -> Row:
    """Start a job that restores the annotations from before the last run, and return it as a JSON object."""
    last = _last(archive)
    if last is None or last["undone"]:
        raise KinedexError("nothing was learned again that could be undone")
    open_store(archive.path, at=last["before"])

    def note(_job: Job) -> None:
        _write(_record_file(archive), json.dumps({**last, "undone": True}))

    words = ("use", str(archive.path), PIPELINE, "--at", str(last["before"]), "--wait", "10m")
    return jobs_of(archive).add(Job("Undo what was learned", words, then=note)).shown()


routes = [
    get("/api/learn", learning_facts),
    post("/api/learn", learn, LearnRequest, writes=True),
    get("/api/learn/changes", changes),
    post("/api/learn/undo", undo, NoRequest, writes=True),
]
