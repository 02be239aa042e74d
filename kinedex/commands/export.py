"""Define the command `export`, which writes motions of a store as files: a take, or a data set of clips."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinedex.commands.app import ASK, LEFT_OUT, OptionGroup, command
from kinedex.commands.options import AtOption, JsonOption, StorePath, WhereOption, open_for_reading, seconds_of
from kinedex.commands.output import print_json, print_message, print_path
from kinedex.ops.errors import KinedexError
from kinedex.ops.intervals import in_seconds
from kinedex.pipelines.export.request import FILE_FORMATS, format_named

if TYPE_CHECKING:
    from kinedex.pipelines.export.request import ClipOptions, IntervalSource
    from kinedex.storage.store.store import Store

_METRES = {"mm": 0.001, "cm": 0.01, "m": 1.0}


def _metres_of(text: str | float) -> float:
    match = re.fullmatch(r"(\d+(?:\.\d+)?)\s*(mm|cm|m)", str(text).strip())
    if match is None:
        raise typer.BadParameter(f"'{text}' is no length; expected a number and its unit: 3cm, 25mm")
    return float(match[1]) * _METRES[match[2]]


TakesArgument = Annotated[list[str] | None, typer.Argument(metavar="[TAKE...]", help="Takes; all unless given.")]
PlaceOption = Annotated[
    str | None,
    typer.Option(
        "--output", "-o", metavar="DIR_OR_FILE",
        help="Folder of a data set; or the file of one take, TAKE.FORMAT in this folder unless given.",
    ),
]  # fmt: skip
ClipFormatOption = Annotated[
    str, typer.Option("--format", help=f"{', '.join(FILE_FORMATS)}; the ending of the file unless given, else csv.")
]
JointsOption = Annotated[
    bool, typer.Option("--joints", help="Write the 24 joints also where the source's own channels can be cut.")
]
ProcessesOption = Annotated[int | None, typer.Option(min=1, help="Worker processes; one per core unless given.")]


@dataclass(frozen=True)
class Choice(OptionGroup):
    """The motions to export: whole takes, or clips given by annotations, labels, hits or rows of a file or query."""

    where: WhereOption = None
    annotations: Annotated[bool, typer.Option("--annotations", help="Cut out annotated segments.")] = False
    labels: Annotated[bool, typer.Option("--labels", help="Cut out the labels of people.")] = False
    hits: Annotated[str | None, typer.Option(metavar="NAME", help="Cut out the hits that were saved as NAME.")] = None
    ranges: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Cut out the rows of a CSV file: take,start,stop[,class].")
    ] = None
    sql: Annotated[
        str | None, typer.Option(metavar="QUERY", help="Cut out the rows of a query: take[, start, stop, class, …].")
    ] = None
    classes: Annotated[
        list[str] | None, typer.Option("--class", metavar="CLASS", help="Only this class; may be given several times.")
    ] = None
    pipeline: Annotated[
        str | None,
        typer.Option(
            "--pipeline",
            "--stage",
            metavar="NAME",
            help="PIPELINE, PIPELINE/STAGE or run that annotated; the current pipeline unless given.",
        ),
    ] = None
    min_confidence: Annotated[float | None, typer.Option(min=0, max=1, help="Least confidence.")] = None

    def what(self, takes: list[str] | None) -> IntervalSource:
        """Return the chosen takes or intervals of takes."""
        from kinedex.pipelines.export.request import IntervalSource, source_of

        kind, name = source_of(
            annotations=self.annotations, labels=self.labels, hits=self.hits, ranges=self.ranges, sql=self.sql
        )
        return IntervalSource(
            kind, name, tuple(takes or ()), self.where, tuple(self.classes or ()), self.pipeline, self.min_confidence
        )


@dataclass(frozen=True)
class Clips(OptionGroup):
    """The form of exported clips, and the choice of clips for a data set."""

    margin: Annotated[
        float | None,
        typer.Option(parser=seconds_of, metavar="DURATION", help="Time to add before and after each clip, as 0.2s."),
    ] = None
    context: Annotated[
        float | None,
        typer.Option(
            parser=seconds_of,
            metavar="DURATION",
            help="Time around a clip that is also in its file; metadata.csv has the clip as inner_start, inner_stop.",
        ),
    ] = None
    min_length: Annotated[
        float | None, typer.Option(parser=seconds_of, metavar="DURATION", help="Shortest duration of an interval.")
    ] = None
    mirror: Annotated[
        bool,
        typer.Option(
            "--mirror", help="Add the mirror image of each clip, with left and right exchanged in its class, too."
        ),
    ] = False
    resample: Annotated[float | None, typer.Option(metavar="HZ", help="Frames per second of the files.")] = None
    in_place: Annotated[bool, typer.Option("--in-place", help="Begin each clip above the origin, facing +Z.")] = False
    split: Annotated[
        str | None,
        typer.Option(metavar="COLUMN", help="Split by a column of takes, as actor; no value is in two splits."),
    ] = None
    shares: Annotated[str, typer.Option(help="Shares of train,val,test or of train,test, by seconds.")] = "0.8,0.1,0.1"
    seed: Annotated[int, typer.Option(help="Seed for the choice of splits and of clips.")] = 0
    balance: Annotated[
        bool, typer.Option("--balance", help="In each split, use as many clips of each class as of the rarest one.")
    ] = False
    per_class: Annotated[int | None, typer.Option(min=1, metavar="N", help="Largest number of clips per class.")] = None
    distinct: Annotated[
        float | None,
        typer.Option(
            parser=_metres_of, metavar="LENGTH", help="Exclude clips whose joints are this near to another's (3cm)."
        ),
    ] = None

    def how(self, form: str, joints: bool) -> ClipOptions:
        """Return the options with which clips are written in a format."""
        from kinedex.pipelines.export.request import ClipOptions

        try:
            shares = tuple(float(part) for part in self.shares.split(","))
        except ValueError:
            raise KinedexError(f"--shares {self.shares}: expected two or three numbers, such as 0.8,0.1,0.1") from None
        return ClipOptions(
            form, joints, self.margin or 0.0, self.context or 0.0, self.min_length or 0.0, self.mirror, self.resample,
            self.in_place, self.split, shares, self.seed, self.balance, self.per_class, self.distinct,
        )  # fmt: skip


@command(ASK)
def export(
    store: StorePath,
    takes: TakesArgument = None,
    output: PlaceOption = None,
    form: ClipFormatOption = "",
    joints: JointsOption = False,
    *,
    chosen: Choice,
    clips: Clips,
    workers: ProcessesOption = None,
    at: AtOption = None,
    as_json: JsonOption = False,
) -> None:
    """Write takes, or clips cut out of them, as files.

    With one TAKE, -o is a file unless it is a folder or ends in a slash. Otherwise it is the folder of a data set, with
    metadata.csv and dataset.json.
    """
    from kinedex.pipelines.export.request import IntervalSource

    what = chosen.what(takes)
    alone = what == IntervalSource(takes=what.takes) and len(what.takes) == 1 and not _is_folder(output)
    form = form or (Path(output).suffix.lstrip(".").lower() if alone and output else "") or "csv"
    how = clips.how(form, joints)
    if alone:
        _export_take(open_for_reading(store, at), what.takes[0], how, output, as_json)
    elif output is None:
        raise KinedexError("-o is missing: the folder of the data set, as in -o clips")
    else:
        _export_data_set(open_for_reading(store, at), what, how, Path(output), workers, as_json)


def _is_folder(output: str | None) -> bool:
    return output is not None and (output.endswith(("/", os.sep)) or Path(output).is_dir())


def _export_take(store: Store, take: str, how: ClipOptions, output: str | None, as_json: bool) -> None:
    from kinedex.pipelines.export.data_set import export_take
    from kinedex.storage.formats.labels.formats import file_names

    form = format_named(how.form)
    # the name of a take need not be a valid file name
    (name,) = file_names([Path(take).name])
    files = export_take(store, take, how, Path(output or f"{name}.{form.endings[0]}"))
    if as_json:
        seconds = in_seconds(store.take_frames[store.take_id(take)], store.rate_hz)
        print_json(_document(store, files, clips=1, written=1, seconds=seconds))
        return
    for file in files:
        print_path(file)


def _document(store: Store, files: list[Path], **facts: object) -> dict[str, object]:
    """Return the files of an export in the form of `--json`; an export of a single take has no folder."""
    empty: dict[str, object] = {
        "folder": None,
        "clips": 0,
        "seconds": 0.0,
        "written": 0,
        "reused": 0,
        "splits": {},
        "excluded": {},
    }
    return {"store": store.path, "files": files, **empty, "remarks": [], **facts}


def _export_data_set(
    store: Store, what: IntervalSource, how: ClipOptions, folder: Path, workers: int | None, as_json: bool
) -> None:
    """Write a data set; exit with `LEFT_OUT` if some clips could not be written."""
    from kinedex.console.terminal import Terminal
    from kinedex.pipelines.engine.executors import make_executor
    from kinedex.pipelines.export.data_set import export_data_set, summary_lines
    from kinedex.pipelines.export.data_set_record import split_facts
    from kinedex.storage.formats.data_set_folder import DATA_SET, METADATA

    executor = make_executor("processes", workers)
    try:
        done = export_data_set(store, what, how, folder, executor=executor, progress=Terminal().progress)
    except BaseException:
        executor.abort()
        raise
    executor.close()
    if as_json:
        files = [folder / METADATA, folder / DATA_SET]
        facts = {"folder": folder, "clips": len(done.rows), "seconds": sum(row["seconds"] for row in done.rows)}
        facts |= {"written": done.written, "reused": done.reused, "splits": split_facts(done.rows, how)}
        print_json(_document(store, files, **facts, excluded=done.excluded, remarks=done.remarks))
    else:
        for line in summary_lines(done, how):
            print_message(line)
        print_path(folder / DATA_SET)
    if done.excluded:
        raise typer.Exit(LEFT_OUT)
