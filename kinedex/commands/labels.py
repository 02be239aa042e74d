"""Commands about label files: labels export, read, diff. `labels_kept` has those about labels in a store."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinedex.commands.app import ASK, LEFT_OUT, command, group
from kinedex.commands.options import AtOption, FormatOption, JsonOption, OutputOption, StorePath, WhereOption
from kinedex.commands.output import print_json, show_table
from kinedex.commands.store_access import open_for_reading
from kinedex.ops.errors import KinedexError
from kinedex.ops.escapes import visible

if TYPE_CHECKING:
    from kinedex.storage.formats.labels.formats import Written
    from kinedex.storage.formats.labels.segments import TakeLabels
    from kinedex.storage.store.store import Store

labels = group("labels", "Keep the labels of people; write and read label files.", ASK)


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
    stage: Annotated[
        str | None,
        typer.Option(
            "--stage",
            "--pipeline",
            metavar="STAGE",
            help="PIPELINE, PIPELINE/STAGE or run; the current pipeline unless given.",
        ),
    ] = None,
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

    Annotations that a person has rejected are left out.
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
) -> tuple[Sequence[TakeLabels], str, int]:
    """Return the segments that an option exports (None: annotations): by take, their origin, the number rejected."""
    from kinedex.pipelines.annotation.labels import annotate_stage, classes_of_takes, labels_kept, labels_of
    from kinedex.pipelines.inertial.limb_labels import limb_error_labels, limb_error_stage

    if option == "--limbs":
        chosen = limb_error_stage(store, stage)
        return limb_error_labels(store, chosen, takes, where), f"found wrong by {chosen}", 0
    if option == "--classes":
        return classes_of_takes(store, takes, where), "by the classes of takes", 0
    if option == "--labels":
        found = labels_kept(store, takes, where)
        if not found:
            raise KinedexError(f"{store.path}: no take has a label; `kinedex labels --help` shows how labels come in")
        return found, "labelled by people", 0
    chosen = annotate_stage(store, stage)
    annotations = labels_of(store, chosen, takes, where)
    return annotations.takes, f"annotated by {chosen}", annotations.rejected


def _print_export(inside: Sequence[TakeLabels], written: Written, output: str, by: str, rejected: int) -> None:
    from kinedex.ops.wording import counted, few

    paths = written.paths
    place = str(paths[0]) if len(paths) == 1 else f"{len(paths)} files in {output}"
    count = sum(len(one.labels) for one in inside)
    print(visible(f"{counted(count, 'segment')} of {counted(len(inside), 'take')}, {by}: {place}"))
    if rejected:
        print(f"left out, since a person has rejected them: {counted(rejected, 'annotation')}")
    if written.renamed:
        print(visible(f"files of other names than their takes: {few(_pairs(written.renamed))}"))
    if written.excluded:
        names = few([f"'{name}'" for name in written.excluded])
        print(visible(f"excluded, since this format would not give back their names; JSON would: {names}"))


def _pairs(renamed: dict[str, str]) -> list[str]:
    return [f"{name} of '{take}'" for take, name in sorted(renamed.items())]


@command(of=labels)
def read(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE...", help="Label files: .csv, .json, .eaf, .vtt or .txt.")
    ],
    form: FormatOption = "table",
    output: OutputOption = None,
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
        # takes and limbs in which a person found nothing
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
        show_table(table, form, output)


@command(of=labels)
def diff(
    before: Annotated[Path, typer.Argument(metavar="BEFORE", help="Label file, or folder of label files.")],
    after: Annotated[Path, typer.Argument(metavar="AFTER", help="The same after a person's corrections.")],
    store: Annotated[
        Path | None,
        typer.Option(metavar="STORE", help="Show frames of this store, as `labels list` does."),
    ] = None,
    every: Annotated[bool, typer.Option("--all", help="Show segments that are the same, too.")] = False,
    form: FormatOption = "table",
    output: OutputOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show which segments of label files a person changed.

    They were moved, renamed, added or removed. Without --store the unit is that of the files.
    """
    from kinedex.pipelines.labels.label_files import label_differences

    found = label_differences(before, after, None if store is None else open_for_reading(store, None), every=every)
    if as_json:
        lost = [one.as_json() for one in found.unmatched]
        known = {"differences": found.rows, "remarks": found.remarks, "unmatched_labels": lost}
        print_json({"before": before, "after": after, **known})
        raise typer.Exit(LEFT_OUT if lost else 0)
    for remark in found.remarks:
        typer.echo(visible(remark), err=True)
    show_table(found.rows, form, output)
    if found.unit == "source frames" and found.rows.num_rows and form == "table" and output is None:
        typer.echo("frames of source files; --store STORE shows those of the store, as `labels list` does", err=True)
    if found.unmatched:
        raise typer.Exit(LEFT_OUT)
