"""What all commands share: the app, how errors are shown, options of one meaning everywhere, and output."""

from __future__ import annotations

import functools
import os
import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar, cast

import typer

from kinedex.ops.errors import KinedexError
from kinedex.pipelines.console.terminal import make_console

if TYPE_CHECKING:
    import pyarrow as pa
    from rich.console import Console

    from kinedex.pipelines.engine.runner import Outcome

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
    app.command()(guard(function))
    return function


def guard(function: Command) -> Command:
    """A command whose errors are shown as one message, without a traceback."""

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

    return cast("Command", guarded)


StorePath = Annotated[Path, typer.Argument(metavar="STORE", help="directory of the store")]
StoreOption = Annotated[Path, typer.Option("--store", metavar="DIR", help="directory of the store; made where missing")]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="NAME=VALUE", help="a setting of the pipeline, or stage.parameter; may be repeated"),
]
Format = Annotated[str, typer.Option("--format", help="table, csv, json or parquet")]
Output = Annotated[
    Path | None,
    typer.Option(
        "--output",
        "-o",
        help="write to this file instead of the terminal: .csv, .json or .parquet, unless --format says",
    ),
]
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


def assignments_of(pairs: list[str] | None) -> dict[str, str]:
    """The NAME=VALUE of --set as a dictionary."""
    result = {}
    for pair in pairs or ():
        name, equals, value = pair.partition("=")
        if not equals or not name:
            raise KinedexError(f"--set {pair}: expected NAME=VALUE")
        result[name] = value
    return result


def show_table(table: pa.Table, form: str, output: Path | None) -> None:
    """Print a table, or write it to a file, in the form asked for; else in that of the file's ending, or CSV without
    one."""
    from kinedex.pipelines.console.tables import Shown, encode

    if output is not None and form == "table":
        form = _form_of(output)
    if form == "table":
        make_console().print(Shown(table))
        return
    data = encode(table, form)
    if output is not None:
        output.write_bytes(data)
    elif form == "parquet" and sys.stdout.isatty():
        raise KinedexError("Parquet is not for the terminal: name a file with --output, or redirect")
    else:
        sys.stdout.buffer.write(data)


def _form_of(output: Path) -> str:
    form = output.suffix.lower().removeprefix(".") or "csv"
    if form not in ("csv", "json", "parquet"):
        raise KinedexError(
            f"--output {output}: no format has the ending '{output.suffix}'; known are .csv, .json and .parquet, or "
            "say --format"
        )
    return form


def run_to_the_end(
    pipeline: str,
    store: Path,
    assignments: dict[str, str],
    executor: str,
    workers: int | None,
    scheduler: str | None,
    force: list[str] | None = None,
) -> None:
    """Run a pipeline and say how it ended, as `finish` does."""
    from kinedex.pipelines.engine.runner import run_pipeline

    outcome = run_pipeline(
        pipeline, store, assignments=assignments, executor=executor, workers=workers, scheduler=scheduler,
        force=frozenset(force or ()),
    )  # fmt: skip
    finish(outcome, store, make_console())


def finish(outcome: Outcome, store: Path, console: Console) -> None:
    """Say how a pipeline ended, and where its report is; exits with LEFT_OUT where source files were left out."""
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
