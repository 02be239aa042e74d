"""Define arguments and options that several commands share, and functions that open stores and run pipelines."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Annotated, Literal, cast

import typer

from kinedex.commands.app import OptionGroup
from kinedex.commands.output import print_message, show_table
from kinedex.ops.errors import KinedexError

if TYPE_CHECKING:
    import pyarrow as pa

    from kinedex.pipelines.engine.config import KnownFailures
    from kinedex.pipelines.engine.runner import Outcome
    from kinedex.storage.lock import Wait
    from kinedex.storage.store.store import Store
    from kinedex.storage.store.writer import StoreWriter

StorePath = Annotated[Path, typer.Argument(metavar="STORE", help="Directory of the store.")]
StoreOption = Annotated[
    Path, typer.Option("--store", metavar="DIR", help="Directory of the store; created where it is missing.")
]
AtOption = Annotated[
    str | None,
    typer.Option("--at", metavar="VERSION", help="Version to read, or newest; the newest with its index unless given."),
]
PipelineArgument = Annotated[
    str, typer.Argument(help="Name of a shipped pipeline (annotate, ingest, …) or path of a .yaml file.")
]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="NAME=VALUE",
        help="Setting of the pipeline, STAGE.PARAMETER, or PARAMETER of one stage; may be given several times.",
    ),
]
ForceOption = Annotated[
    list[str] | None,
    typer.Option(metavar="STAGE", help="Run this stage even where nothing changed; may be given several times."),
]
ExecutorOption = Annotated[str, typer.Option(help="serial, processes or dask.")]
WorkersOption = Annotated[int | None, typer.Option(min=1, help="Worker processes; one per core unless given.")]
SchedulerOption = Annotated[
    str | None,
    typer.Option(metavar="ADDRESS", help="Running Dask scheduler, for instance tcp://host:8786; with --executor dask."),
]
RateOption = Annotated[
    float | None,
    typer.Option("--rate", metavar="HZ", help="Frames per second of every file; overrides what the files contain."),
]
MetadataOption = Annotated[
    list[Path] | None,
    typer.Option(
        metavar="FILE", help="Table of metadata whose columns become columns of takes; may be given several times."
    ),
]
MaxMemoryOption = Annotated[
    str | None,
    typer.Option(
        metavar="SIZE", help="Most memory of all workers, such as 1.5GB; ingest refuses files that need more."
    ),
]
AcceptOption = Annotated[
    bool, typer.Option("--accept", help="Let the run take values, such as classes, away from takes of the store.")
]
KnownFailuresOption = Annotated[
    str | None,
    typer.Option(
        "--known-failures",
        metavar="WORD",
        help="remember: the store keeps failures, and only new ones end with 3; report: all do, as unless given.",
    ),
]
WhereOption = Annotated[
    str | None, typer.Option(help="SQL filter over the columns of takes, for instance \"actor = 'bk'\".")
]
KindOption = Annotated[str, typer.Option("--kind", help="soft or hard template.")]
StageOption = Annotated[
    str | None,
    typer.Option("--stage", metavar="STAGE", help="Stage that learned the templates: PIPELINE/STAGE, or PIPELINE."),
]
StartArgument = Annotated[str | None, typer.Argument(help="First frame (45) or seconds (1.5s); else the take's first.")]
StopArgument = Annotated[str | None, typer.Argument(help="Frame after the last, or seconds; else the end.")]
FormatOption = Annotated[str, typer.Option("--format", help="table, csv, json or parquet.")]
OutputOption = Annotated[
    Path | None,
    typer.Option(
        "--output", "-o", help="Write to this file; its ending (.csv, .json, .parquet) is the format unless given."
    ),
]


def seconds_of(text: str | float) -> float:
    """Return the seconds of a duration such as 30s, 10m, 2h or 30d.

    Raises
    ------
    BadParameter
        The text is not a duration.
    """
    match = re.fullmatch(r"(\d+(?:\.\d+)?)\s*([smhd])", str(text).strip())
    if match is None:
        raise typer.BadParameter(f"'{text}' is no duration; expected a number and its unit: 30s, 10m, 2h, 30d")
    return float(match[1]) * {"s": 1, "m": 60, "h": 3600, "d": 86400}[match[2]]


def wait_of(seconds: float | None) -> Wait:
    """Return the `Wait` for the seconds of `--wait`; it prints which process the command waits for."""
    from kinedex.storage.lock import Wait

    return Wait(seconds or 0.0, print_message, "--wait 10m")


OlderOption = Annotated[
    float | None,
    typer.Option(
        "--older-than",
        parser=seconds_of,
        metavar="AGE",
        help="Keep versions younger than this (12h, 30d), however many there are.",
    ),
]
WaitOption = Annotated[
    float | None,
    typer.Option(
        "--wait",
        parser=seconds_of,
        metavar="DURATION",
        help="Longest time to wait for another writer (30s, 10m, 2h); fail at once unless given.",
    ),
]
JsonOption = Annotated[
    bool, typer.Option("--json", help="Print one JSON object and nothing else to standard output; errors too.")
]


def assignments_of(pairs: list[str] | None) -> dict[str, str]:
    """Return the NAME=VALUE pairs of `--set` as a dictionary.

    Raises
    ------
    KinedexError
        If a pair has no name or no equals sign.
    """
    result = {}
    for pair in pairs or ():
        name, equals, value = pair.partition("=")
        if not equals or not name:
            raise KinedexError(f"--set {pair}: expected NAME=VALUE")
        result[name] = value
    return result


def interval_of(text: str) -> tuple[int, int]:
    """Return the first frame of an interval such as 100:160, and the frame after its last."""
    start, colon, stop = text.strip().partition(":")
    if not (colon and start.isdecimal() and stop.isdecimal() and int(start) < int(stop)):
        raise typer.BadParameter(f"--frames {text}: expected the first frame and the one after the last, as 0:60")
    return int(start), int(stop)


@dataclass(frozen=True)
class Output(OptionGroup):
    """The format in which a command shows its table, and the file to which the table is written."""

    form: FormatOption = "table"
    output: OutputOption = None

    @property
    def is_plain(self) -> bool:
        """Return whether the table is shown to people, on the terminal or in a pipe."""
        return self.form == "table" and self.output is None

    def most(self, limit: int | None) -> int | None:
        """Return the largest number of rows to show, given the number of `--limit`; None for all rows."""
        return (ROWS if limit is None and self.is_plain and sys.stdout.isatty() else limit) or None

    def show(self, table: pa.Table, *, paged: bool = False) -> None:
        """Print a table, or write it to the file."""
        show_table(table, self.form, self.output, paged=paged)


ROWS = 200
"""Number of rows that a terminal shows by default; a line below the table gives the number of further rows."""


@dataclass(frozen=True)
class RunOptions(OptionGroup):
    """The settings of a pipeline run, and how it runs."""

    assign: SetOption = None
    executor: ExecutorOption = "processes"
    workers: WorkersOption = None
    scheduler: SchedulerOption = None
    force: ForceOption = None
    max_memory: MaxMemoryOption = None
    accept: AcceptOption = False
    known_failures: KnownFailuresOption = None
    wait: WaitOption = None

    def run(
        self,
        pipeline: str,
        store: Path,
        settings: Mapping[str, str] | None = None,
        fixed: Mapping[str, str] | None = None,
    ) -> Outcome:
        """Run a pipeline, and print its progress.

        Parameters
        ----------
        pipeline : str
            Name or file of the pipeline.
        store : Path
            Directory of the store.
        settings : mapping of str to str, optional
            Settings from options of the command, which `--set` overrides.
        fixed : mapping of str to str, optional
            Settings from options of the command, which override `--set`.
        """
        from kinedex.console.terminal import Terminal
        from kinedex.pipelines.engine.runner import run_pipeline

        assignments = {**(settings or {}), **assignments_of(self.assign), **(fixed or {})}
        if self.max_memory is not None:
            assignments["ingest.max_memory"] = self.max_memory
        if self.known_failures not in (None, "report", "remember"):
            raise typer.BadParameter(f"--known-failures {self.known_failures}: expected remember or report")
        return run_pipeline(
            pipeline, store, assignments=assignments, executor=self.executor, workers=self.workers,
            scheduler=self.scheduler, force=frozenset(self.force or ()), terminal=Terminal(),
            wait_seconds=self.wait or 0.0, accept=self.accept,
            known_failures=cast("KnownFailures | None", self.known_failures),
        )  # fmt: skip


def open_for_reading(store: Path, at: str | None = None, files: Iterable[Path] = ()) -> Store:
    """Open the version of a store that `--at` names, or by default the newest version with an index.

    If the opened version is not the newest, a line on standard error says so.

    Parameters
    ----------
    store : Path
        Directory of the store.
    at : str or None
        Number of a version, or "newest".
    files : iterable of Path, optional
        Folders outside the store whose files SQL may read.

    Raises
    ------
    KinedexError
        There is no store or no such version, or the value of the option is not a version.
    """
    from kinedex.console.terminal import is_quiet
    from kinedex.storage.store.store import open_store

    _leave_pandas_out()
    if at is not None and at != "newest" and not at.isdecimal():
        raise KinedexError(f"--at {at}: expected the number of a version, or newest")
    version = int(at) if at is not None and at.isdecimal() else cast(Literal["newest"] | None, at)
    opened = open_store(store, files, version)
    shown, newest = opened.manifest.version, opened.newest_version
    if at is None and shown != newest and not is_quiet():
        typer.echo(
            f"version {shown} of {store} is shown, the newest with its index; version {newest} is the newest: --at "
            "newest shows it",
            err=True,
        )
    return opened


def _leave_pandas_out() -> None:
    """Prevent PyArrow from importing pandas, which it does on the first conversion of a list, if it is installed.

    Importing pandas takes as long as all other imports of a command. `to_pandas` of a table still imports it later.
    """
    if "pandas" in sys.modules:
        return
    import pyarrow as pa

    absent = _NoPandas()
    sys.meta_path.insert(0, absent)
    try:
        pa.array([])
    finally:
        sys.meta_path.remove(absent)


class _NoPandas:
    def find_spec(self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None) -> None:
        """Raise ModuleNotFoundError for pandas."""
        if fullname == "pandas":
            raise ModuleNotFoundError(name=fullname)


def writer_of(opened: Store, wait: float | None) -> StoreWriter:
    """Return a writer of an open store, after waiting for another writer for at most the time of `--wait`."""
    from kinedex.storage.store.writer import StoreWriter

    return StoreWriter.open(opened.path, opened.feature_set, opened.rate_hz, wait_of(wait))


@dataclass(frozen=True)
class Follow(OptionGroup):
    """The folder into which a live depth camera writes its frames, and the files that describe it."""

    follow: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Reconstruct the frames that are written into this folder.")
    ] = None
    camera: Annotated[Path | None, typer.Option(metavar="FILE", help="With --follow: file of the camera.")] = None
    background: Annotated[Path | None, typer.Option(metavar="FILE", help="With --follow: the empty room.")] = None
    idle: Annotated[
        float | None,
        typer.Option(min=0.1, metavar="SECONDS", help="With --follow: end this long after the last frame."),
    ] = None
