"""The command line: `kinedex COMMAND`, one function a command."""

from __future__ import annotations

import functools
import os
import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from ops.errors import KinedexError, did_you_mean
from pipelines.terminal import make_console

if TYPE_CHECKING:
    import pyarrow as pa
    from rich.console import Console

    from pipelines.runner import Outcome

FAILED, LEFT_OUT, INTERRUPTED = 1, 3, 130
"""Exit codes: something could not be done; all was done, but the ingest left source files out; stopped by Ctrl-C."""

app = typer.Typer(
    name="kinedex",
    help="A motion archive that can be queried: motion capture in, SQL over feature runs, annotations and reports out.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    epilog="Exit codes: 0 done, 1 failed, 2 wrong usage, 3 done, but some source files were left out.",
)

Command = TypeVar("Command", bound=Callable[..., None])


def command(function: Command) -> Command:
    """Register a command; its errors are shown as one message, without a traceback."""

    @functools.wraps(function)
    def guarded(*args: object, **kwargs: object) -> None:
        try:
            function(*args, **kwargs)
        except KinedexError as fault:
            reason = str(fault)
        except KeyboardInterrupt:
            print("\nkinedex: stopped; the same command goes on where it was", file=sys.stderr)
            raise typer.Exit(INTERRUPTED) from None
        except BrokenPipeError:
            # The reader of a pipe has gone; nothing more can be said to it, not even at exit.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            raise typer.Exit(0) from None
        except OSError as fault:
            reason = f"{fault.filename}: {fault.strerror}" if fault.filename else str(fault)
        except MemoryError:
            reason = "out of memory; fewer --workers need less"
        else:
            return
        print(f"kinedex: {reason}", file=sys.stderr)
        raise typer.Exit(FAILED)

    app.command()(guarded)
    return function


StorePath = Annotated[Path, typer.Argument(metavar="STORE", help="directory of the store")]
StoreOption = Annotated[Path, typer.Option("--store", metavar="DIR", help="directory of the store; made where missing")]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="NAME=VALUE", help="a setting of the pipeline, or stage.parameter; may be repeated"),
]
Format = Annotated[str, typer.Option("--format", help="table, csv, json or parquet")]
Output = Annotated[Path | None, typer.Option("--output", "-o", help="write to this file instead of the terminal")]
ExecutorOption = Annotated[str, typer.Option(help="serial, processes or dask")]
SchedulerOption = Annotated[
    str | None,
    typer.Option(metavar="ADDRESS", help="a running Dask scheduler, e.g. tcp://host:8786; with --executor dask"),
]
RateOption = Annotated[
    float | None,
    typer.Option("--rate", metavar="HZ", help="frames per second of every file, whatever the file says"),
]
WorkersOption = Annotated[int | None, typer.Option(min=1, help="worker processes; all cores unless given")]
ForceOption = Annotated[
    list[str] | None, typer.Option(metavar="STAGE", help="run this stage even where nothing changed; may be repeated")
]
Where = Annotated[str | None, typer.Option(help="only takes for which this SQL filter holds, e.g. \"actor = 'bk'\"")]


@command
def demo(
    store: StoreOption = Path("build/demo-store"),
    data: Annotated[
        Path | None, typer.Option(help="an archive of your own; a synthetic one is made without it")
    ] = None,
    minutes: Annotated[float, typer.Option(min=1, help="minutes of motion in the synthetic archive")] = 30.0,
    executor: ExecutorOption = "processes",
    workers: WorkersOption = None,
) -> None:
    """Run the main job, from motion files to a report, on a synthetic archive or on your own."""
    from pipelines.demo import run_demo

    console = make_console()
    outcome = run_demo(store, data, minutes, executor, workers, console)
    _finish(outcome, store, console)


@command
def run(
    pipeline: Annotated[str, typer.Argument(help="a shipped pipeline (annotate, ingest), or a path ending in .yaml")],
    store: StoreOption,
    assign: SetOption = None,
    executor: ExecutorOption = "processes",
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    force: ForceOption = None,
) -> None:
    """Run a pipeline: every stage whose code, parameters or inputs changed since it last ran."""
    from pipelines.runner import run_pipeline

    outcome = run_pipeline(
        pipeline,
        store,
        assignments=_assignments(assign),
        executor=executor,
        workers=workers,
        scheduler=scheduler,
        force=frozenset(force or ()),
    )
    _finish(outcome, store, make_console())


@command
def plan(
    pipeline: Annotated[str, typer.Argument(help="a shipped pipeline (annotate, ingest), or a path ending in .yaml")],
    store: StoreOption,
    assign: SetOption = None,
    force: ForceOption = None,
) -> None:
    """Show what `run` would do, and why, without doing it."""
    from rich import box
    from rich.table import Table

    from pipelines.config import load_pipeline
    from pipelines.plan import make_plan

    loaded = load_pipeline(pipeline, _assignments(assign))
    table = Table(
        box=box.SIMPLE_HEAD, pad_edge=False, title=f"{loaded.name}: {loaded.description}", title_justify="left"
    )
    for column in ("stage", "inputs", "runs because", "last run"):
        table.add_column(column)
    steps = make_plan(loaded, store, frozenset(force or ()))
    for step in steps:
        last = f"{step.record.finished} ({step.record.seconds:g} s)" if step.record else "never"
        inputs = ", ".join(sorted(set(step.stage.inputs.values()))) or "–"
        table.add_row(step.stage.name, inputs, step.reason or "– (nothing to do)", last)
    make_console().print(table)


@command
def ingest(
    store: StorePath,
    source: Annotated[Path, typer.Argument(help="folder that holds the motion files")],
    rate: RateOption = None,
    assign: SetOption = None,
    executor: ExecutorOption = "processes",
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
) -> None:
    """Bring motion files into a store and index them (the pipeline `ingest`)."""
    from pipelines.runner import run_pipeline

    assignments = {"source": str(source), **_assignments(assign)}
    if rate is not None:
        assignments["ingest.override_rate_hz"] = str(rate)
    outcome = run_pipeline(
        "ingest", store, assignments=assignments, executor=executor, workers=workers, scheduler=scheduler
    )
    _finish(outcome, store, make_console())


@command
def inspect(
    file: Annotated[Path, typer.Argument(help="a motion file")],
    skeleton: Annotated[str, typer.Option(help="skeleton mapping: auto, a shipped name, or a .yaml file")] = "auto",
    source: Annotated[
        Path | None, typer.Option(metavar="DIR", help="source root: the ASF of an AMC file is looked for up to there")
    ] = None,
    rate: RateOption = None,
    fill_gap_frames: Annotated[int, typer.Option(min=0, help="longest gap of a point that is closed")] = 0,
    picture: Annotated[
        Path | None, typer.Option(metavar="PNG", help="picture to write; STEM.png in this folder unless given")
    ] = None,
) -> None:
    """Show what a motion file is and what becomes of it, and draw a few of its frames."""
    from pipelines.inspect import inspect_file, show, write_picture
    from storage.bodies import Given

    found = inspect_file(file, skeleton, source, Given(None, rate, fill_gap_frames))
    path = picture or Path(f"{file.stem}.png")
    if write_picture(found, path):
        found.say("picture", str(path))
    show(found, make_console())
    if found.fault is not None:
        raise found.fault


@command
def search(
    store: StorePath,
    queries: Annotated[str, typer.Argument(help="a query file: a shipped name, or a path to a .yaml or .json file")],
    name: Annotated[list[str] | None, typer.Option("--query", "-q", help="only this query; may be repeated")] = None,
    where: Where = None,
    explain: Annotated[bool, typer.Option(help="show list sizes per keyframe and the share of frames kept")] = False,
    form: Format = "table",
    output: Output = None,
) -> None:
    """Search keyframe queries over the index; prints the ranges that hold hits."""
    from pipelines.search import explain_search, load_query_file, search_store
    from storage.store import open_store

    opened = open_store(store)
    loaded = load_query_file(queries, opened.feature_set, name)
    if explain:
        _show(explain_search(opened, loaded, where), form, output)
        return
    _show(search_store(opened, loaded, where), form, output)


@command
def sql(
    store: StorePath,
    query: Annotated[
        str | None, typer.Argument(help="one SQL statement; without it, standard input or a prompt")
    ] = None,
    file: Annotated[Path | None, typer.Option("--file", "-f", help="read the statement from this file")] = None,
    form: Format = "table",
    output: Output = None,
) -> None:
    """Ask the store in SQL (DuckDB), read-only. `SELECT * FROM help` lists the views and macros."""
    from storage.store import open_store

    if query is not None and file is not None:
        raise KinedexError("give the SQL as an argument or with --file, not both")
    if file is not None:
        if not file.is_file():
            raise KinedexError(f"--file {file}: no such file")
        try:
            query = file.read_text(encoding="utf-8")
        except UnicodeDecodeError as fault:
            raise KinedexError(f"--file {file}: not UTF-8 text (byte {fault.start})") from None
    opened = open_store(store)
    if query is None and sys.stdin.isatty():
        from pipelines.prompt import run_prompt

        run_prompt(opened, make_console())
        return
    _show(opened.sql(query if query is not None else sys.stdin.read()), form, output)


@command
def takes(
    store: StorePath,
    where: Where = None,
    columns: Annotated[str, typer.Option(help="columns to show, separated by commas; * for all")] = (
        "name,actor,class,clip,frames,seconds,source_rate_hz,warnings"
    ),
    form: Format = "table",
    output: Output = None,
) -> None:
    """List the takes of a store."""
    from storage.store import open_store

    frame = open_store(store).takes(where)
    wanted = frame.columns if columns.strip() == "*" else [column.strip() for column in columns.split(",")]
    for column in wanted:
        if column not in frame.columns:
            raise KinedexError(f"--columns: takes have no column '{column}'{did_you_mean(column, frame.columns)}")
    _show(frame.select(wanted).to_arrow(), form, output)
    if form == "table" and output is None:
        make_console().print(f"{len(frame)} takes, {frame['seconds'].sum() / 60:.1f} minutes")


@command
def verify(store: StorePath) -> None:
    """Check every file of a store against its manifest: sums, sizes, counts, order, and the index."""
    from storage.store import open_store
    from storage.verify import verify as check

    opened = open_store(store)
    findings = check(opened)
    for finding in findings:
        print(f"{'✗' if finding.fault else '·'} {finding}")
    parts = len(opened.manifest.parts)
    faults = sum(finding.fault for finding in findings)
    if faults:
        raise KinedexError(f"{store}: {faults} of {parts} parts or files are damaged")
    print(
        f"{store}: version {opened.manifest.version}, {len(opened.manifest.live_takes)} takes, {parts} parts: all sound"
    )


@command
def gc(
    store: StorePath,
    keep: Annotated[int, typer.Option(min=1, help="how many of the newest versions stay readable")] = 2,
    dry_run: Annotated[bool, typer.Option(help="only say what would go")] = False,
) -> None:
    """Remove old versions of a store, and the files that only they need."""
    from storage.garbage import collect, summary

    for line in summary(collect(store, keep=keep, dry_run=dry_run)):
        print(f"would remove {line}" if dry_run else f"removed {line}")


@command
def export(
    store: StorePath,
    take: Annotated[str, typer.Argument(help="name of the take")],
    form: Annotated[
        str, typer.Option("--format", help="bvh, csv or parquet; by default what the output's ending says")
    ] = "",
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="file to write; TAKE.FORMAT unless given")
    ] = None,
) -> None:
    """Write a take's joint positions (metres, Y up) as BVH, CSV or Parquet."""
    from storage.export import export_take
    from storage.store import open_store

    form = form or (output.suffix.lstrip(".").lower() if output else "") or "csv"
    path = output or Path(f"{Path(take).name}.{form}")
    export_take(open_store(store), take, form, path)
    print(path)


@command
def synth(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="folder to make; must be empty or missing")],
    minutes: Annotated[float, typer.Option(min=1, help="minutes of motion in all")] = 30.0,
    actors: Annotated[int, typer.Option(min=2, help="how many actors")] = 5,
    seed: Annotated[int, typer.Option(help="the same seed makes the same bytes")] = 2026,
    workers: WorkersOption = None,
) -> None:
    """Make a synthetic archive: ASF/AMC files of example clips and long takes, with ground truth."""
    from pipelines.demo import make_archive

    make_archive(directory, minutes, actors, seed, workers, make_console())


@command
def version() -> None:
    """Print the versions of kinedex and of what it computes with."""
    from importlib.metadata import version as installed

    for package in ("kinedex", "numpy", "numba", "pyarrow", "duckdb", "polars"):
        print(f"{package:10} {installed(package)}")


def _assignments(pairs: list[str] | None) -> dict[str, str]:
    result = {}
    for pair in pairs or ():
        name, equals, value = pair.partition("=")
        if not equals or not name:
            raise KinedexError(f"--set {pair}: expected NAME=VALUE")
        result[name] = value
    return result


def _show(table: pa.Table, form: str, output: Path | None) -> None:
    from pipelines.tables import encode, rich_table

    if output is not None and form == "table":
        form = {".csv": "csv", ".json": "json", ".parquet": "parquet"}.get(output.suffix, "csv")
    if form == "table":
        make_console().print(rich_table(table))
        return
    data = encode(table, form)
    if output is not None:
        output.write_bytes(data)
    elif form == "parquet" and sys.stdout.isatty():
        raise KinedexError("Parquet is not for the terminal: name a file with --output, or redirect")
    else:
        sys.stdout.buffer.write(data)


def _finish(outcome: Outcome, store: Path, console: Console) -> None:
    if not outcome.ran:
        console.print(f"everything was done already: {len(outcome.skipped)} stages, nothing to do", style="bold")
    if outcome.report is not None:
        console.print(f"report: {outcome.report}", style="bold", markup=False)
    if outcome.left_out:
        console.print(
            f"{outcome.left_out} source files were left out: "
            f'kinedex sql {shlex.quote(str(store))} "SELECT * FROM ingest_log"',
            markup=False,
        )
        raise typer.Exit(LEFT_OUT)


def main() -> None:
    """The console command `kinedex`."""
    app()


if __name__ == "__main__":
    main()
