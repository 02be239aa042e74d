"""Define the commands `labels …`, which write, read and compare label files, and keep the labels of a store."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinedex.commands.app import ASK, LEFT_OUT, OptionGroup, command, group
from kinedex.commands.options import AtOption, JsonOption, Output, StorePath, WhereOption, open_for_reading
from kinedex.commands.output import print_json, print_message
from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.wording import visible

if TYPE_CHECKING:
    from kinedex.pipelines.labels.decisions import RecordedDecisions
    from kinedex.pipelines.labels.row_selection import RowSelection
    from kinedex.storage.formats.labels.file_labels import LabelsOfTake
    from kinedex.storage.formats.labels.formats import Written
    from kinedex.storage.store.store import Store

labels = group("labels", "Keep the labels of people; write and read label files.", ASK)

AnnotatedBy = Annotated[
    str | None,
    typer.Option(
        "--stage",
        "--pipeline",
        metavar="STAGE",
        help="PIPELINE, PIPELINE/STAGE or run; the current pipeline unless given.",
    ),
]
AnnotatorOption = Annotated[str | None, typer.Option("--annotator", metavar="NAME", help="Person who decides.")]


@dataclass(frozen=True)
class Author(OptionGroup):
    """The person who decides about labels, and a remark on the labels."""

    annotator: AnnotatorOption = None
    note: Annotated[str | None, typer.Option("--note", metavar="TEXT", help="Remark on these labels.")] = None


@dataclass(frozen=True)
class LabelFilter(OptionGroup):
    """The criteria by which labels or annotations of a store are chosen."""

    take: Annotated[list[str] | None, typer.Option("--take", help="Only this take; may be given several times.")] = None
    name: Annotated[
        list[str] | None, typer.Option("--class", help="Only this class or subclass; may be given several times.")
    ] = None
    start: Annotated[
        str | None, typer.Option("--start", help="Only what ends after this frame (45) or time (1.5s) of the take.")
    ] = None
    stop: Annotated[str | None, typer.Option("--stop", help="Only what begins before this frame or time.")] = None
    where: Annotated[str | None, typer.Option("--where", help="SQL filter over their columns.")] = None
    rows: Annotated[
        Path | None,
        typer.Option(
            "--rows", metavar="FILE", help="Only rows of this file (.csv, .json, .parquet): take, class, start, stop."
        ),
    ] = None
    every: Annotated[bool, typer.Option("--all", help="All of them, where nothing else is chosen.")] = False

    def selection(self, opened: Store, *, every: bool = False) -> RowSelection:
        """Return the selection that the options state; `start` and `stop` require exactly one take."""
        from kinedex.pipelines.labels.row_selection import RowSelection
        from kinedex.pipelines.templates.stored_templates import clip_range

        first = last = None
        if self.start is not None or self.stop is not None:
            if self.take is None or len(self.take) != 1:
                raise typer.BadParameter("--start and --stop are frames or times of one take; name it with --take")
            edges = clip_range(opened, self.take[0], self.start, self.stop)
            first = edges[0] if self.start is not None else None
            last = edges[1] if self.stop is not None else None
        takes, classes = tuple(self.take or ()), tuple(self.name or ())
        return RowSelection(takes, classes, first, last, self.where, self.rows, every or self.every)


@command(of=labels)
def export(
    store: StorePath,
    output: Annotated[
        str, typer.Option("--output", "-o", metavar="DIR_OR_FILE", help="Folder for one file per take, or one file.")
    ],
    form: Annotated[
        str | None,
        typer.Option(
            "--format",
            help="csv, json, eaf (ELAN), vtt (WebVTT) or txt (Audacity); the file's ending unless given, csv in a "
            "folder.",
        ),
    ] = None,
    take: Annotated[list[str] | None, typer.Option(help="Only this take; may be given several times.")] = None,
    where: WhereOption = None,
    stage: AnnotatedBy = None,
    kept: Annotated[bool, typer.Option("--labels", help="Write the labels of people in place of annotations.")] = False,
    limbs: Annotated[
        bool, typer.Option("--limbs", help="Write the runs in which sensors find limbs wrong in place of annotations.")
    ] = False,
    classes: Annotated[
        bool, typer.Option("--classes", help="Write the class of each take, as paths or tables give it, for all of it.")
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite existing files.")] = False,
    at: AtOption = None,
    as_json: JsonOption = False,
) -> None:
    """Write annotations as label files, one per take or one for all.

    Annotations that a person has rejected are excluded.
    """
    from kinedex.storage.formats.labels.formats import write_labels

    options = [name for name, on in (("--labels", kept), ("--limbs", limbs), ("--classes", classes)) if on]
    if len(options) > 1:
        raise typer.BadParameter(f"choose one of {' and '.join(options)}")
    if (kept or classes) and stage is not None:
        raise typer.BadParameter(f"labels are of no stage: give --stage or {options[0]}")
    opened = open_for_reading(store, at)
    found, by, rejected = _segments(opened, next(iter(options), None), stage, take or (), where)
    written = write_labels(found, form, output, force=force)
    inside = [one for one in found if one.take not in written.excluded]
    if as_json:
        print_json(
            {
                "store": store, "files": written.paths, "takes": len(inside),
                "segments": sum(len(one.labels) for one in inside), "by": by, "rejected": rejected,
                "renamed": written.renamed, "excluded": written.excluded,
            }
        )  # fmt: skip
        return
    _print_export(inside, written, output, by, rejected)


def _segments(
    store: Store, option: str | None, stage: str | None, takes: Sequence[str], where: str | None
) -> tuple[Sequence[LabelsOfTake], str, int]:
    """Return the segments that an option exports (None for annotations), their origin, and the number rejected."""
    from kinedex.pipelines.annotation.annotation_tables import annotation_stage
    from kinedex.pipelines.inertial.limb_labels import limb_error_labels, limb_error_stage
    from kinedex.pipelines.labels.label_files import annotation_labels, classes_of_takes, stored_labels

    if option == "--limbs":
        chosen = limb_error_stage(store, stage)
        return limb_error_labels(store, chosen, takes, where), f"found wrong by {chosen}", 0
    if option == "--classes":
        return classes_of_takes(store, takes, where), "by the classes of takes", 0
    if option == "--labels":
        found = stored_labels(store, takes, where)
        if not found:
            raise KinedexError(f"{store.path}: no take has a label; `kinedex labels --help` shows how labels come in")
        return found, "labelled by people", 0
    chosen = annotation_stage(store, stage)
    annotations = annotation_labels(store, chosen, takes, where)
    return annotations.takes, f"annotated by {chosen}", annotations.rejected


def _print_export(inside: Sequence[LabelsOfTake], written: Written, output: str, by: str, rejected: int) -> None:
    from kinedex.ops.wording import counted, name_list

    paths = written.paths
    place = str(paths[0]) if len(paths) == 1 else f"{len(paths)} files in {output}"
    count = sum(len(one.labels) for one in inside)
    print(visible(f"{counted(count, 'segment')} of {counted(len(inside), 'take')}, {by}: {place}"))
    if rejected:
        print(f"left out, since a person has rejected them: {counted(rejected, 'annotation')}")
    if written.renamed:
        print(visible(f"files of other names than their takes: {name_list(_pairs(written.renamed))}"))
    if written.excluded:
        names = name_list([f"'{name}'" for name in written.excluded])
        print(visible(f"excluded, since this format would change their names, unlike JSON: {names}"))


def _pairs(renamed: dict[str, str]) -> list[str]:
    return [f"{name} of '{take}'" for take, name in sorted(renamed.items())]


@command(of=labels)
def read(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE...", help="Label files: .csv, .json, .eaf, .vtt or .txt.")
    ],
    *,
    output: Output,
    as_json: JsonOption = False,
) -> None:
    """Show the segments of label files as they are read for ground truth."""
    import pyarrow as pa

    from kinedex.pipelines.labels.label_files import known_columns
    from kinedex.storage.formats.labels.formats import read_labels

    unit = {True: "seconds", False: "source frames"}
    rows: list[dict[str, object]] = []
    for file in map(read_labels, files):
        rows += [
            {"take": one.take, "class": one.label, "start": one.start, "stop": one.stop}
            | {"unit": unit[one.in_seconds], "where": one.where}
            | {"limb": one.limb or None, "annotator": one.annotator or None}
            for one in file.segments
        ]
        # takes and limbs in which a person found no segment
        labelled = {one.take for one in file.segments}
        labelled |= {take for take, _, _ in file.covered}
        rows += [
            {"take": take, "where": file.path, "limb": limb or None, "annotator": annotator or None}
            for take, limb, annotator in file.covered
        ]
        rows += [{"take": take, "where": file.path} for take in file.takes if take not in labelled]
    text, number = pa.string(), pa.float64()
    kinds = {"take": text, "class": text, "start": number, "stop": number, "unit": text, "where": text}
    kinds |= {"limb": text, "annotator": text}
    table = known_columns(rows, pa.schema(list(kinds.items())))
    if as_json:
        print_json({"files": files, "segments": table})
    else:
        output.show(table)


@command(of=labels)
def diff(
    before: Annotated[Path, typer.Argument(metavar="BEFORE", help="Label file, or folder of label files.")],
    after: Annotated[Path, typer.Argument(metavar="AFTER", help="The same after a person's corrections.")],
    store: Annotated[
        Path | None,
        typer.Option(metavar="STORE", help="Show frames of this store, as `labels list` does."),
    ] = None,
    every: Annotated[bool, typer.Option("--all", help="Show segments that are the same, too.")] = False,
    *,
    output: Output,
    as_json: JsonOption = False,
) -> None:
    """Show which segments of label files a person changed.

    Segments can be moved, renamed, added or removed. Without --store, times are in the unit of the files.
    """
    from kinedex.pipelines.labels.label_files import label_differences

    found = label_differences(before, after, None if store is None else open_for_reading(store), every=every)
    if as_json:
        lost = [one.as_json() for one in found.unmatched]
        known = {"differences": found.rows, "remarks": found.remarks, "unmatched_labels": lost}
        print_json({"before": before, "after": after, **known})
        raise typer.Exit(LEFT_OUT if lost else 0)
    for remark in found.remarks:
        typer.echo(visible(remark), err=True)
    output.show(found.rows)
    if found.unit == "source frames" and found.rows.num_rows and output.is_plain:
        typer.echo("frames of source files; --store STORE shows those of the store, as `labels list` does", err=True)
    if found.unmatched:
        raise typer.Exit(LEFT_OUT)


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
    *,
    by: Author,
    as_json: JsonOption = False,
) -> None:
    """Keep the segments of label files as labels."""
    from kinedex.pipelines.labels.decisions import import_labels
    from kinedex.pipelines.labels.label_files import label_files

    if corrects not in (None, "annotations", "labels"):
        raise typer.BadParameter(f"--corrects {corrects}: expected annotations or labels")
    done = import_labels(open_for_reading(store), label_files(files), corrects, stage, **asdict(by))
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
    *,
    by: Author,
    as_json: JsonOption = False,
) -> None:
    """Label an interval of a take."""
    from kinedex.pipelines.labels.decisions import record_decisions
    from kinedex.pipelines.templates.stored_templates import clip_range

    opened = open_for_reading(store)
    first, last = clip_range(opened, take, start, stop)
    row = {"take": take, "class": name, "start": first, "stop": last, "origin": "drawn", "limb": limb}
    row |= {"verdict": "negative" if negative else "positive", "confidence": confidence}
    _report(store, record_decisions(opened, [{**row, **asdict(by)}]), as_json)


@command(of=labels)
def change(
    store: StorePath,
    id: Annotated[str, typer.Argument(metavar="ID", help="Id of the label, or its beginning.")],
    name: Annotated[str | None, typer.Option("--class", help="New class of the label.")] = None,
    start: Annotated[str | None, typer.Option(help="First frame (45) or seconds (1.5s).")] = None,
    stop: Annotated[str | None, typer.Option(help="Frame after the last, or seconds.")] = None,
    verdict: Annotated[str | None, typer.Option(metavar="WORD", help="positive, or negative: it is not this.")] = None,
    annotator: AnnotatorOption = None,
    as_json: JsonOption = False,
) -> None:
    """Change the class, the interval or the verdict of a label."""
    from kinedex.pipelines.labels.decisions import labels_by_id
    from kinedex.pipelines.labels.label_edits import change_label
    from kinedex.pipelines.templates.stored_templates import clip_range

    opened = open_for_reading(store)
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
    *,
    chosen_by: LabelFilter,
    by: Author,
    as_json: JsonOption = False,
) -> None:
    """Withdraw labels; they stay in the history."""
    from kinedex.pipelines.labels.decisions import labels_by_id, withdraw_labels
    from kinedex.pipelines.labels.row_selection import selected_rows

    opened = open_for_reading(store)
    chosen = chosen_by.selection(opened)
    if bool(ids) != chosen.is_empty:
        raise typer.BadParameter(
            "name the labels either by ids or by options such as --take and --class; --all for all"
        )
    found = labels_by_id(opened, ids) if ids else selected_rows(opened.labels(), chosen, "label")
    _report(store, withdraw_labels(opened, found, **asdict(by)), as_json)


@command(of=labels, name="list")
def list_(
    store: StorePath,
    *,
    chosen_by: Annotated[LabelFilter, "take name start stop where"],
    history: Annotated[bool, typer.Option("--history", help="Show rows that others replace, too.")] = False,
    output: Output,
    as_json: JsonOption = False,
    at: AtOption = None,
) -> None:
    """List the labels of a store."""
    from kinedex.pipelines.labels.row_selection import selected_rows
    from kinedex.storage.sql.result_scans import shown_labels

    opened = open_for_reading(store, at)
    table = shown_labels(opened)
    table = table if history else table.filter(table.column("current")).drop_columns(["current"])
    found = selected_rows(table, chosen_by.selection(opened, every=True), "label").to_arrow().cast(table.schema)
    if as_json:
        print_json({"store": store, "labels": found})
    elif output.is_plain:
        few = ["take", "class", "start", "stop", "limb", "verdict", "origin", "annotator", "note", "id"]
        output.show(found.select([*few, *(["current"] if history else [])]))
        if not found.num_rows:
            print_message(f"no label of {table.num_rows:,} fits" if table.num_rows else "the store has no labels")
    else:
        output.show(found)


@command(of=labels)
def suspects(
    store: StorePath,
    top: Annotated[int, typer.Option(min=1, help="Largest number of labels.")] = 20,
    *,
    chosen_by: LabelFilter,
    output: Output,
    as_json: JsonOption = False,
    at: AtOption = None,
) -> None:
    """List the labels that are probably wrong, with what fits better.

    A label can name a wrong class or side of the body, have wrong edges, or be of frames at a wrong rate. Each is
    judged by the labels, and the classes of takes, that other takes have.
    """
    from kinedex.library.label_suspects import label_suspects
    from kinedex.ops.wording import counted
    from kinedex.pipelines.labels.row_selection import selected_rows

    opened = open_for_reading(store, at)
    found = label_suspects(opened)
    chosen = chosen_by.selection(opened, every=True)
    table = selected_rows(found.rows, chosen, "suspect", keep_order=True).to_arrow().cast(found.rows.schema)
    shown = table.slice(0, top)
    if as_json:
        print_json({"store": store, "judged": found.judged, "remarks": found.remarks, "suspects": shown})
        return
    for remark in found.remarks:
        typer.echo(visible(remark), err=True)
    plain = ["take", "class", "start", "stop", "suspicion", "probability", "kind", "proposal"]
    output.show(shown.select(plain) if output.is_plain else shown)
    if output.is_plain:
        print_message(f"{shown.num_rows:,} of {table.num_rows:,}; {counted(found.judged, 'label')} judged")


@command(of=labels)
def accept(
    store: StorePath,
    *,
    chosen_by: LabelFilter,
    stage: AnnotatedBy = None,
    by: Author,
    as_json: JsonOption = False,
) -> None:
    """Turn annotations into labels."""
    _decide(store, chosen_by, stage, by, accepted=True, as_json=as_json)


@command(of=labels)
def reject(
    store: StorePath,
    *,
    chosen_by: LabelFilter,
    stage: AnnotatedBy = None,
    by: Author,
    as_json: JsonOption = False,
) -> None:
    """Turn annotations into negative labels: examples that do not show the class."""
    _decide(store, chosen_by, stage, by, accepted=False, as_json=as_json)


def _decide(
    store: Path, chosen_by: LabelFilter, stage: str | None, by: Author, *, accepted: bool, as_json: bool
) -> None:
    from kinedex.pipelines.labels.decisions import annotations_of, decide_annotations
    from kinedex.pipelines.labels.row_selection import selected_rows

    opened = open_for_reading(store)
    chosen = chosen_by.selection(opened)
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
    found = selected_rows(annotations, chosen, "annotation")
    if not found.height:
        raise KinedexError(f"{opened.path}: no annotation of {source} is chosen by these options")
    done = decide_annotations(opened, found, accept=accepted, source=source, **asdict(by))
    _report(opened.path, done, as_json)


def _report(store: Path, done: RecordedDecisions, as_json: bool) -> None:
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
