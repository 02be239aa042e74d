"""Labels of people: read those of a take or of the store with their history, and record edits of a take at once.

`GET /api/labels` answers with `label_facts`, `GET /api/takes/ID/labels` with `take_labels`, and `POST /api/labels/list`
with rows of the view `labels` or `label_history`.

`POST /api/labels/decide {take, annotator?, changes: [change]}` records edits of the labels of one take; all of them or
none of them. A change is one of

    {do: "draw", id, class, start, stop, verdict?, limb?, note?}
    {do: "change", id, label, class?, start?, stop?, verdict?}       another class, other edges, another verdict
    {do: "split", ids: [id, id], label, at}
    {do: "join", ids: [id, …], labels: [label, …]}                  as many ids as labels
    {do: "withdraw", id, label}
    {do: "accept" or "reject", id, stage, class, subclass, start, stop, seen?}
    {do: "restore", ids: [id, …], made: [id, …], back: [id, …]}     undo an edit that made rows, or redo it

An id is 32 hexadecimal digits that the page makes, and `label` is the id of a label. The answer is sent only after the
journal is on disk; a request that is sent again records nothing twice. If a label was changed meanwhile, the answer is
a `ConflictError` with status 409, and nothing is recorded. `command` and `python` of the answer make the same
decisions, one line each.
"""

from __future__ import annotations

import getpass
import threading
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal

import pyarrow as pa
import pyarrow.compute as pc
from pydantic import Field

from kinedex.explorer.answers import command_line, python_lines
from kinedex.explorer.endpoints import RequestBody, get, post, take_of
from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.pipelines.annotation.annotation_tables import annotation_stage
from kinedex.pipelines.labels.label_edits import LabelEdits, label_edits, record_edits
from kinedex.pipelines.labels.row_selection import RowSelection, selected_rows
from kinedex.storage.duckdb_sql import quote
from kinedex.storage.sql.result_scans import shown_labels

if TYPE_CHECKING:
    from starlette.requests import Request

    from kinedex.explorer.open_archive import Archive
    from kinedex.storage.store.store import Store

Row = dict[str, Any]

MAX_CHANGES = 1000
"""Maximum number of changes of one request."""

BLOCK = 500
"""Maximum number of rows of one answer about the labels of a store."""

Id = Annotated[str, Field(pattern="^[0-9a-f]{32}$")]
Name = Annotated[str, Field(min_length=1, max_length=1000)]
Frame = Annotated[int, Field(ge=0)]

_DECIDING = threading.Lock()
"""Held while a request is checked against the labels and recorded, so that requests of two tabs follow each other."""


class Draw(RequestBody):
    """Add a label."""

    do: Literal["draw"]
    id: Id
    label: Annotated[Name, Field(alias="class")]
    start: Frame
    stop: Frame
    verdict: Literal["positive", "negative"] = "positive"
    limb: str | None = None
    note: str | None = None

    def apply(self, edits: LabelEdits, take: str, _store: Store) -> None:
        """Add this change to the edits of the take."""
        more = {"verdict": self.verdict, "limb": self.limb, "note": self.note}
        edits.draw(self.id, take, self.label, self.start, self.stop, **more)


class Change(RequestBody):
    """Give a label another class, other edges or another verdict."""

    do: Literal["change"]
    id: Id
    of: Annotated[Id, Field(alias="label")]
    label: Annotated[Name | None, Field(alias="class")] = None
    start: Frame | None = None
    stop: Frame | None = None
    verdict: Literal["positive", "negative"] | None = None

    def apply(self, edits: LabelEdits, _take: str, _store: Store) -> None:
        """Add this change to the edits of the take."""
        values = {"class": self.label, "start": self.start, "stop": self.stop, "verdict": self.verdict}
        edits.change(self.id, self.of, **values)


class Split(RequestBody):
    """Divide a label at a frame."""

    do: Literal["split"]
    ids: Annotated[tuple[Id, ...], Field(min_length=2, max_length=2)]
    label: Id
    at: Frame

    def apply(self, edits: LabelEdits, _take: str, _store: Store) -> None:
        """Add this change to the edits of the take."""
        edits.split(self.ids, self.label, self.at)


class Join(RequestBody):
    """Merge several labels into one."""

    do: Literal["join"]
    ids: Annotated[tuple[Id, ...], Field(min_length=2, max_length=MAX_CHANGES)]
    labels: Annotated[tuple[Id, ...], Field(min_length=2, max_length=MAX_CHANGES)]

    def apply(self, edits: LabelEdits, _take: str, _store: Store) -> None:
        """Add this change to the edits of the take."""
        edits.join(self.ids, self.labels)


class Withdraw(RequestBody):
    """Withdraw a label."""

    do: Literal["withdraw"]
    id: Id
    label: Id

    def apply(self, edits: LabelEdits, _take: str, _store: Store) -> None:
        """Add this change to the edits of the take."""
        edits.withdraw(self.id, self.label)


class Decide(RequestBody):
    """Accept or reject an annotation; `seen` is the id of the label of this class and edges that the page showed."""

    do: Literal["accept", "reject"]
    id: Id
    stage: Name
    label: Annotated[Name, Field(alias="class")]
    subclass: str | None = None
    start: Frame
    stop: Frame
    seen: Id | None = None

    def apply(self, edits: LabelEdits, take: str, store: Store) -> None:
        """Add this change to the edits; annotations that no longer exist are taken from the page's request."""
        row: Row = {"take": take, "class": self.label, "subclass": self.subclass or ""}
        row |= {"start": self.start, "stop": self.stop, "confidence": None}
        keys = ("class", "subclass", "start", "stop")
        known = _annotations_of(store, self.stage, take)
        found = next((one for one in known if all((one[key] or "") == (row[key] or "") for key in keys)), row)
        edits.decide(self.id, found, self.stage, self.seen, accept=self.do == "accept")


class Restore(RequestBody):
    """Undo an edit, or redo it."""

    do: Literal["restore"]
    ids: Annotated[tuple[Id, ...], Field(min_length=1, max_length=2 * MAX_CHANGES)]
    made: Annotated[tuple[Id, ...], Field(min_length=1, max_length=MAX_CHANGES)]
    back: Annotated[tuple[Id, ...], Field(max_length=MAX_CHANGES)] = ()

    def apply(self, edits: LabelEdits, _take: str, _store: Store) -> None:
        """Add this change to the edits of the take."""
        edits.restore(self.ids, self.made, self.back)


AnyChange = Annotated[Draw | Change | Split | Join | Withdraw | Decide | Restore, Field(discriminator="do")]


class Decisions(RequestBody):
    """A request to edit the labels of a take."""

    take: Name
    annotator: Annotated[str, Field(max_length=200)] | None = None
    changes: Annotated[tuple[AnyChange, ...], Field(min_length=1, max_length=MAX_CHANGES)]


def decide(archive: Archive, asked: Decisions, _request: Request) -> Row:
    """Record edits of a take's labels, and return the recorded rows, which are on disk before the answer is sent."""
    with _DECIDING:
        store = archive.store()
        if asked.take not in store.take_ids:
            raise KinedexError(f"no take is named '{asked.take}'{did_you_mean(asked.take, store.take_ids)}")
        edits = label_edits(store, asked.take, (asked.annotator or "").strip() or None)
        for change in asked.changes:
            change.apply(edits, asked.take, store)
        recorded = record_edits(store, edits).rows
    if recorded.num_rows:
        archive.labels_changed()
    return {
        "made": [row["id"] for row in edits.rows],
        "restored": edits.restored,
        "rows": [_shown(row) for row in recorded.to_pylist()],
        **label_commands(archive, edits.rows, edits.known),
    }


def _annotations_of(store: Store, stage: str, take: str) -> list[Row]:
    record = store.manifest.stages.get(stage)
    if record is None:
        return []
    rows = store.result("annotations", run=record.run)
    found: list[Row] = rows.filter(pc.equal(rows.column("take"), take)).to_pylist()
    return found


def _shown(row: Row) -> Row:
    """Return a row of labels as a JSON object for pages."""
    return {**row, "created": row["created"].isoformat(timespec="seconds")}


def take_labels(archive: Archive, request: Request) -> Row:
    """Return the labels of a take with their history, and the annotations that a person can decide on.

    Returns
    -------
    dict
        `rows`, all rows of labels of the take, each with `current`, which is false if another row replaces it or if it
        only withdraws another; `stage`, the stage that the request names, otherwise the one that the view `annotations`
        shows, None if nothing was annotated; and `annotations`, those of this stage. Also `take_id`, `take` (its name),
        `frames`, `rate_hz`, `version` of the store, `command` and `python`.
    """
    store, take_id = take_of(archive, request)
    name = store.take_names[take_id]
    rows = shown_labels(store)
    rows = rows.filter(pc.equal(rows.column("take"), name)).to_pylist()
    stage = stage_of(store, request.query_params.get("stage"))
    columns = ("class", "subclass", "start", "stop", "cost", "confidence")
    annotations = [{key: row[key] for key in columns} for row in (_annotations_of(store, stage, name) if stage else ())]
    return {
        "take_id": take_id,
        "take": name,
        "frames": store.take_frames[take_id],
        "rate_hz": store.rate_hz,
        "version": store.manifest.version,
        "rows": [_shown(row) for row in rows],
        "stage": stage,
        "annotations": annotations,
        "command": command_line("kinedex", "labels", "list", archive.path, "--take", name),
        "python": python_lines(archive.path, f"store.labels.table({f'take = {quote(name)}'!r}, history=True)"),
    }


def stage_of(store: Store, asked: str | None) -> str | None:
    """Return the stage whose annotations a page asks for; None where no stage is named and none has annotated."""
    annotating = {part.stage for part in store.manifest.results.get("annotated_takes", ())}
    if asked is None and not annotating & store.manifest.stages.keys():  # a run that was killed has no record
        return None
    return annotation_stage(store, asked)


def label_facts(archive: Archive, _request: Request) -> Row:
    """Return counts and names that pages about labels need.

    Returns
    -------
    dict
        `labels`, the number of current labels; `decisions`, the number of all rows; `classes` of the store (of takes,
        labels and annotations), each with `name` and the number of `positive` and `negative` labels; `annotator`, the
        name that new labels get unless a person gives another; `annotators`; `takes`, the number of takes with labels;
        and `learned`, with the stage of the current annotations, the time when its templates were learned, and the
        number of decisions `since`.
    """
    store = archive.store()
    labels = store.labels()
    counts: dict[str, Row] = {}
    names = set(store.take_rows.column("class").unique().to_pylist())
    stage = stage_of(store, None)
    if stage is not None:
        found = store.result("annotations", run=store.manifest.stages[stage].run)
        names |= {*found.column("class").unique().to_pylist(), *found.column("subclass").unique().to_pylist()}
    for name in sorted(filter(None, names | set(labels.column("class").unique().to_pylist()))):
        counts[name] = {"name": name, "positive": 0, "negative": 0}
    for one in labels.group_by(["class", "verdict"]).aggregate([([], "count_all")]).to_pylist():
        counts[one["class"]][one["verdict"]] = one["count_all"]
    people = sorted(filter(None, labels.column("annotator").unique().to_pylist()))
    return {
        "labels": labels.num_rows,
        "decisions": store.labels(history=True).num_rows,
        "classes": list(counts.values()),
        "annotator": default_annotator(),
        "annotators": people,
        "takes": len(labels.column("take").unique()),
        "learned": _learned(store, stage),
        "command": command_line("kinedex", "labels", "list", archive.path),
        "python": python_lines(archive.path, "store.labels.table()"),
    }


def default_annotator() -> str:
    """Return the name of the user of this machine; empty where the system knows none."""
    try:
        return getpass.getuser()
    except (OSError, KeyError, ImportError):
        return ""


def _learned(store: Store, stage: str | None) -> Row:
    """Return when the templates of the annotations were learned, and how many decisions were made since."""
    rows = store.labels(history=True)
    if stage is None:
        return {"stage": None, "finished": None, "since": rows.num_rows}
    record = store.manifest.stages[stage]
    pipeline = stage.partition("/")[0]
    templates = store.manifest.stages.get(f"{pipeline}/{record.summary.get('inputs', {}).get('templates', '')}", record)
    moment = pa.scalar(templates.finished).cast(rows.schema.field("created").type)
    since = pc.sum(pc.greater(rows.column("created"), moment)).as_py() or 0
    return {"stage": stage, "finished": templates.finished, "since": since}


class LabelsRequest(RequestBody):
    """A request for a block of the labels of a store."""

    where: str | None = None
    history: bool = False
    offset: Frame = 0
    limit: Annotated[int, Field(ge=0, le=BLOCK)] = 100


def list_labels(archive: Archive, asked: LabelsRequest, _request: Request) -> Row:
    """Return a block of the labels of the store, the latest first."""
    store = archive.store()
    table = shown_labels(store)
    if not asked.history:
        table = table.filter(table.column("current"))
    where = (asked.where or "").strip() or None
    found = selected_rows(table, RowSelection(where=where, every=True), "label", keep_order=True).reverse()
    block = found.slice(asked.offset, asked.limit)
    given = ["--where", where] if where else []
    return {
        "total": found.height,
        "offset": asked.offset,
        "rows": [_shown(row) for row in block.iter_rows(named=True)],
        "command": command_line("kinedex", "labels", "list", archive.path, *given),
        "python": python_lines(archive.path, f"store.labels.table({where!r}, history={asked.history})"),
    }


_ID = 12
"""Number of digits of a label's id in a command."""


def label_commands(archive: Archive, rows: Iterable[Row], known: Mapping[str, Row]) -> dict[str, str]:
    """Return the commands and the Python lines that make decisions, one line for each.

    Parameters
    ----------
    archive : Archive
        The open store.
    rows : iterable of mapping
        Rows of labels, as they were recorded.
    known : mapping of str to mapping
        Rows by their ids: those that `rows` replace.
    """
    lines = []
    gone: set[str] = set()  # when a label is split, the first part replaces it, and the second is a new label
    for row in rows:
        before = row.get("replaces") or ""
        lines.append(_line(archive, row, None if before in gone else known.get(before)))
        gone.add(before)
    if not lines:
        return {}
    return {
        "command": "\n".join(command for command, _ in lines),
        "python": python_lines(archive.path, *(python for _, python in lines)),
    }


def _line(archive: Archive, row: Row, before: Row | None) -> tuple[str, str]:
    """Return the shell command and the line of Python that record the decision `row`; `before` is what it replaces."""
    person = row.get("annotator")
    by, by_person = (["--annotator", person], f", annotator={person!r}") if person else ([], "")

    def command(name: str, *words: str) -> str:
        return command_line("kinedex", "labels", name, archive.path, *words, *by)

    if row["verdict"] == "withdrawn":
        id = str(row["replaces"])[:_ID]
        return command("remove", id), f"store.labels.remove([{id!r}]{by_person})"
    is_moved = before is not None and any(row[key] != before[key] for key in ("class", "start", "stop"))
    if before is not None and before["verdict"] != "withdrawn" and (is_moved or row["origin"] == "corrected"):
        return _change(command, row, before, by_person)
    if row["origin"] == "accepted" and row.get("source"):
        return _decide(command, row, by_person)
    keys = ("verdict", "limb", "note", "confidence")
    content = {key: row[key] for key in ("take", "class", "start", "stop")}
    content |= {key: row[key] for key in keys if row.get(key) not in (None, "positive")}
    options = ["--not"] if row["verdict"] == "negative" else []
    options += [word for key in keys[1:] if row.get(key) is not None for word in (f"--{key}", str(row[key]))]
    words = (row["take"], row["class"], str(row["start"]), str(row["stop"]), *options)
    return command("add", *words), f"store.labels.add([{content!r}]{by_person})"


def _change(command: Any, row: Row, before: Row, by_person: str) -> tuple[str, str]:
    """Return the shell command and the line of Python that change the label `before` into `row`."""
    id = str(before["id"])[:_ID]
    given = {key: row[key] for key in ("class", "start", "stop", "verdict") if row[key] != before[key]}
    options = [word for key, value in given.items() for word in (f"--{key}", str(value))]
    names = {"class": "label"}
    arguments = "".join(f", {names.get(key, key)}={value!r}" for key, value in given.items())
    return command("change", id, *options), f"store.labels.change({id!r}{arguments}{by_person})"


def _decide(command: Any, row: Row, by_person: str) -> tuple[str, str]:
    """Return the shell command and the line of Python that accept or reject an annotation."""
    name = "accept" if row["verdict"] == "positive" else "reject"
    edges = f"start = {row['start']} AND stop = {row['stop']}"
    take, label = quote(row["take"]), quote(row["class"])
    where = f"SELECT * FROM annotations WHERE take = {take} AND {edges} AND {label} IN (class, subclass)"
    words = ("--take", row["take"], "--class", row["class"], "--where", edges, "--stage", row["source"])
    return command(name, *words), f"store.labels.{name}(store.sql({where!r}, polars=True){by_person})"


routes = [
    get("/api/labels", label_facts),
    get("/api/takes/{take:int}/labels", take_labels),
    post("/api/labels/list", list_labels, LabelsRequest),
    post("/api/labels/decide", decide, Decisions, writes=True),
]
