"""The commands about label files: labels export, labels read."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from kinedex.pipelines.commands.shell import Format, Output, StorePath, Where, app, guard, show_table
from kinedex.pipelines.console.wording import counted

labels = typer.Typer(
    name="labels", help="Annotations as label files for other tools, and label files as tables.", no_args_is_help=True
)
app.add_typer(labels, rich_help_panel="Ask a store")


def export(
    store: StorePath,
    output: Annotated[
        str, typer.Option("--output", "-o", metavar="DIR_OR_FILE", help="folder for a file per take, or one file")
    ],
    form: Annotated[
        str | None,
        typer.Option(
            "--format",
            help="csv, json, eaf (ELAN), vtt (WebVTT) or txt (Audacity); as FILE ends unless given, csv in a folder",
        ),
    ] = None,
    take: Annotated[list[str] | None, typer.Option(help="only this take; may be repeated")] = None,
    where: Where = None,
    stage: Annotated[
        str | None,
        typer.Option(
            "--stage", metavar="STAGE", help="PIPELINE/STAGE, PIPELINE or run; the last to annotate unless given"
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="overwrite files that are there")] = False,
) -> None:
    """Write annotations as label files: a file per take into a folder, or one file."""
    from kinedex.pipelines.annotation.labels import annotate_stage, labels_of
    from kinedex.storage.formats.labels.formats import write_labels
    from kinedex.storage.store.store import open_store

    opened = open_store(store)
    chosen = annotate_stage(opened, stage)
    found = labels_of(opened, chosen, take or (), where)
    paths = write_labels(found, form, output, force=force)
    count = sum(len(one.labels) for one in found)
    where_to = str(paths[0]) if len(paths) == 1 else f"{len(paths)} files in {output}"
    print(f"{counted(count, 'segment')} of {counted(len(found), 'take')}, annotated by {chosen}: {where_to}")


def read(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="label files: .csv, .json, .eaf, .vtt, .txt")],
    form: Format = "table",
    output: Output = None,
) -> None:
    """Show what label files say, as ground truth would be read from them."""
    import pyarrow as pa

    from kinedex.storage.formats.labels.formats import read_labels

    unit = {True: "seconds", False: "source frames"}
    rows: list[dict[str, object]] = []
    for file in map(read_labels, files):
        rows += [
            {"take": one.take, "class": one.label, "start": one.start, "stop": one.stop}
            | {"unit": unit[one.in_seconds], "where": one.where}
            for one in file.segments
        ]
        # takes that somebody looked at without finding anything
        labelled = {one.take for one in file.segments}
        rows += [{"take": take, "where": file.path} for take in file.takes if take not in labelled]
    text, number = pa.string(), pa.float64()
    kinds = {"take": text, "class": text, "start": number, "stop": number, "unit": text, "where": text}
    show_table(pa.Table.from_pylist(rows, schema=pa.schema(list(kinds.items()))), form, output)


for _function in (export, read):
    labels.command()(guard(_function))
