"""Commands about the labels that a store keeps: labels import, add, change, remove, list, accept, reject."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinedex.commands.app import LEFT_OUT, command
from kinedex.commands.labels import labels
from kinedex.commands.options import AtOption, FormatOption, JsonOption, OutputOption, StorePath
from kinedex.commands.output import print_json, print_message, show_table
from kinedex.commands.store_access import open_for_reading

if TYPE_CHECKING:
    from kinedex.pipelines.labels.decisions import Recorded
    from kinedex.pipelines.labels.selection import Selection
    from kinedex.storage.store.store import Store

AnnotatorOption = Annotated[str | None, typer.Option("--annotator", metavar="NAME", help="Person who decides.")]
NoteOption = Annotated[str | None, typer.Option("--note", metavar="TEXT", help="Remark on these labels.")]
TakeOption = Annotated[list[str] | None, typer.Option("--take", help="Only this take; may be given several times.")]
ClassOption = Annotated[
    list[str] | None, typer.Option("--class", help="Only this class or subclass; may be given several times.")
]
StartOption = Annotated[
    str | None, typer.Option("--start", help="Only what ends after this frame (45) or time (1.5s) of the take.")
]
StopOption = Annotated[str | None, typer.Option("--stop", help="Only what begins before this frame or time.")]
RowsOption = Annotated[
    Path | None,
    typer.Option(
        "--rows", metavar="FILE", help="Only rows of this file (.csv, .json, .parquet): take, class, start, stop."
    ),
]
FilterOption = Annotated[str | None, typer.Option("--where", help="SQL filter over their columns.")]
AllOption = Annotated[bool, typer.Option("--all", help="All of them, where nothing else is chosen.")]
AnnotatedBy = Annotated[
    str | None,
    typer.Option(
        "--stage",
        "--pipeline",
        metavar="STAGE",
        help="PIPELINE, PIPELINE/STAGE or run; the current pipeline unless given.",
    ),
]


@command(of=labels, name="import")
def import_(
    store: StorePath,
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE...", help="Label files (.csv, .json, .eaf, .vtt, .txt), or folders.")
    ],
    corrects: Annotated[
        str | None,
        typer.Option(
            "--corrects",
            metavar="WHAT",
            help="annotations or labels: the files are those that export wrote, corrected; what is missing in them "
            "was rejected.",
        ),
    ] = None,
    stage: AnnotatedBy = None,
    annotator: AnnotatorOption = None,
    note: NoteOption = None,
    as_json: JsonOption = False,
) -> None:
    """Keep the segments of label files as labels."""
    from kinedex.pipelines.labels.decisions import import_corrected_labels, import_corrections, import_labels
    from kinedex.pipelines.labels.label_files import label_files

    if corrects not in (None, "annotations", "labels"):
        raise typer.BadParameter(f"--corrects {corrects}: expected annotations or labels")
    opened, read = open_for_reading(store, None), label_files(files)
    if corrects == "annotations":
        done = import_corrections(opened, read, stage, annotator=annotator, note=note)
    elif corrects == "labels":
        done = import_corrected_labels(opened, read, annotator=annotator, note=note)
    else:
        done = import_labels(opened, read, annotator=annotator, note=note)
    _report(store, done, as_json)


@command(of=labels)
def add(
    store: StorePath,
    take: Annotated[str, typer.Argument(help="Name of the take.")],
    name: Annotated[str, typer.Argument(metavar="CLASS", help="Class that the interval shows.")],
    start: Annotated[str, typer.Argument(help="First frame (45) or seconds (1.5s).")],
    stop: Annotated[str, typer.Argument(help="Frame after the last, or seconds.")],
    negative: Annotated[bool, typer.Option("--not", help="The interval does not show the class.")] = False,
    limb: Annotated[str | None, typer.Option(help="Limb that the label is about.")] = None,
    confidence: Annotated[
        float | None, typer.Option(min=0, max=1, help="Confidence of the person, from 0 to 1.")
    ] = None,
    annotator: AnnotatorOption = None,
    note: NoteOption = None,
    as_json: JsonOption = False,
) -> None:
    """Label an interval of a take."""
    from kinedex.pipelines.labels.decisions import record
    from kinedex.pipelines.templates.stored_templates import clip_range

    opened = open_for_reading(store, None)
    first, last = clip_range(opened, take, start, stop)
    row = {"take": take, "class": name, "start": first, "stop": last, "origin": "drawn", "limb": limb}
    row |= {"verdict": "negative" if negative else "positive", "confidence": confidence}
    _report(store, record(opened, [{**row, "annotator": annotator, "note": note}]), as_json)


@command(of=labels)
def change(
    store: StorePath,
    id: Annotated[str, typer.Argument(metavar="ID", help="Id of the label, or its beginning.")],
    name: Annotated[str | None, typer.Option("--class", help="Class that it has from now on.")] = None,
    start: Annotated[str | None, typer.Option(help="First frame (45) or seconds (1.5s).")] = None,
    stop: Annotated[str | None, typer.Option(help="Frame after the last, or seconds.")] = None,
    verdict: Annotated[str | None, typer.Option(metavar="WORD", help="positive, or negative: it is not this.")] = None,
    annotator: AnnotatorOption = None,
    as_json: JsonOption = False,
) -> None:
    """Give a label another class, other edges or another verdict."""
    from kinedex.pipelines.labels.decisions import labels_by_id
    from kinedex.pipelines.labels.edits import change_label
    from kinedex.pipelines.templates.stored_templates import clip_range

    opened = open_for_reading(store, None)
    if verdict not in (None, "positive", "negative"):
        raise typer.BadParameter(f"--verdict {verdict}: expected positive or negative")
    values: dict[str, str | int | None] = {"class": name, "verdict": verdict}
    if start is not None or stop is not None:
        before = labels_by_id(opened, [id]).row(0, named=True)
        given = (start or str(before["start"]), stop or str(before["stop"]))
        values |= dict(zip(("start", "stop"), clip_range(opened, before["take"], *given), strict=True))
    _report(store, change_label(opened, id, annotator=annotator, **values), as_json)


@command(of=labels)
def remove(
    store: StorePath,
    ids: Annotated[
        list[str] | None, typer.Argument(metavar="[ID...]", help="Ids of labels, or their beginnings.")
    ] = None,
    take: TakeOption = None,
    name: ClassOption = None,
    start: StartOption = None,
    stop: StopOption = None,
    where: FilterOption = None,
    rows: RowsOption = None,
    every: AllOption = False,
    annotator: AnnotatorOption = None,
    note: NoteOption = None,
    as_json: JsonOption = False,
) -> None:
    """Take labels back; they stay in the history."""
    from kinedex.pipelines.labels.decisions import labels_by_id, withdraw
    from kinedex.pipelines.labels.selection import selected

    opened = open_for_reading(store, None)
    chosen = _selection(opened, take, name, start, stop, where, rows, every)
    if bool(ids) != chosen.is_empty:
        raise typer.BadParameter(
            "name the labels either by ids or by options such as --take and --class; --all for all"
        )
    found = labels_by_id(opened, ids) if ids else selected(opened.labels(), chosen, "label")
    _report(store, withdraw(opened, found, annotator=annotator, note=note), as_json)


@command(of=labels, name="list")
def list_(
    store: StorePath,
    take: TakeOption = None,
    name: ClassOption = None,
    start: StartOption = None,
    stop: StopOption = None,
    where: FilterOption = None,
    history: Annotated[bool, typer.Option("--history", help="Show rows that others replace, too.")] = False,
    form: FormatOption = "table",
    output: OutputOption = None,
    as_json: JsonOption = False,
    at: AtOption = None,
) -> None:
    """List the labels of a store."""
    from kinedex.pipelines.labels.selection import selected
    from kinedex.storage.sql.result_scans import shown_labels

    opened = open_for_reading(store, at)
    table = shown_labels(opened)
    table = table if history else table.filter(table.column("current")).drop_columns(["current"])
    chosen = _selection(opened, take, name, start, stop, where, None, True)
    found = selected(table, chosen, "label").to_arrow().cast(table.schema)
    if as_json:
        print_json({"store": store, "labels": found})
    elif form == "table" and output is None:
        few = ["take", "class", "start", "stop", "limb", "verdict", "origin", "annotator", "note", "id"]
        show_table(found.select([*few, *(["current"] if history else [])]), form, output)
        if not found.num_rows:
            print_message(f"no label of {table.num_rows:,} fits" if table.num_rows else "the store has no labels")
    else:
        show_table(found, form, output)


@command(of=labels)
def accept(
    store: StorePath,
    take: TakeOption = None,
    name: ClassOption = None,
    start: StartOption = None,
    stop: StopOption = None,
    where: FilterOption = None,
    rows: RowsOption = None,
    every: AllOption = False,
    stage: AnnotatedBy = None,
    annotator: AnnotatorOption = None,
    note: NoteOption = None,
    as_json: JsonOption = False,
) -> None:
    """Make annotations labels."""
    opened = open_for_reading(store, None)
    chosen = _selection(opened, take, name, start, stop, where, rows, every)
    _decide(opened, chosen, stage, True, annotator, note, as_json)


@command(of=labels)
def reject(
    store: StorePath,
    take: TakeOption = None,
    name: ClassOption = None,
    start: StartOption = None,
    stop: StopOption = None,
    where: FilterOption = None,
    rows: RowsOption = None,
    every: AllOption = False,
    stage: AnnotatedBy = None,
    annotator: AnnotatorOption = None,
    note: NoteOption = None,
    as_json: JsonOption = False,
) -> None:
    """Make annotations negative labels: examples of what a class is not."""
    opened = open_for_reading(store, None)
    chosen = _selection(opened, take, name, start, stop, where, rows, every)
    _decide(opened, chosen, stage, False, annotator, note, as_json)


def _decide(
    opened: Store,
    chosen: Selection,
    stage: str | None,
    accepted: bool,
    annotator: str | None,
    note: str | None,
    as_json: bool,
) -> None:
    from kinedex.ops.errors import KinedexError, did_you_mean
    from kinedex.pipelines.labels.decisions import annotations_of, decide
    from kinedex.pipelines.labels.selection import selected

    if chosen.is_empty:
        raise typer.BadParameter("choose annotations by options such as --take and --class; --all for all of them")
    source, annotations = annotations_of(opened, stage)
    for noun, columns, names in (("take", ["take"], chosen.takes), ("class", ["class", "subclass"], chosen.classes)):
        known = {value for column in columns for value in annotations.column(column).unique().to_pylist()} - {None}
        for name in names:
            if name not in known:
                raise KinedexError(
                    f"{opened.path}: no annotation of {source} has the {noun} '{name}'{did_you_mean(name, known)}"
                )
    found = selected(annotations, chosen, "annotation")
    if not found.height:
        raise KinedexError(f"{opened.path}: no annotation of {source} is chosen by these options")
    done = decide(opened, found, accept=accepted, source=source, annotator=annotator, note=note)
    _report(opened.path, done, as_json)


def _selection(
    opened: Store,
    takes: list[str] | None,
    classes: list[str] | None,
    start: str | None,
    stop: str | None,
    where: str | None,
    rows: Path | None,
    every: bool,
) -> Selection:
    """Return what the options choose; times need one take, whose frames they count."""
    from kinedex.pipelines.labels.selection import Selection
    from kinedex.pipelines.templates.stored_templates import clip_range

    first = last = None
    if start is not None or stop is not None:
        if takes is None or len(takes) != 1:
            raise typer.BadParameter("--start and --stop are frames or times of one take; name it with --take")
        edges = clip_range(opened, takes[0], start, stop)
        first, last = (edges[0] if start is not None else None), (edges[1] if stop is not None else None)
    return Selection(tuple(takes or ()), tuple(classes or ()), first, last, where, rows, every)


def _report(store: Path, done: Recorded, as_json: bool) -> None:
    """Print the number of recorded labels, and the labels that were excluded."""
    from kinedex.ops.wording import counted

    if as_json:
        print_json(
            {
                "store": store, "counts": done.counts, "known": done.known, "remarks": done.remarks,
                "unmatched_labels": [one.as_json() for one in done.unmatched], "labels": done.rows,
            }
        )  # fmt: skip
        raise typer.Exit(LEFT_OUT if done.unmatched else 0)
    for remark in done.remarks:
        print_message(f"! {remark}")
    counts = ", ".join(f"{count:,} {name}" for name, count in done.counts.items())
    known = f"; {done.known:,} were there already" if done.known else ""
    print_message(f"{counted(done.rows.num_rows, 'label')} recorded{f' ({counts})' if counts else ''}{known}")
    if done.unmatched:
        raise typer.Exit(LEFT_OUT)
