"""Arguments and options that several commands have; each has one meaning everywhere."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from kinedex.commands.output import print_message
from kinedex.ops.errors import KinedexError
from kinedex.reports.motion_pages import FIGURES as FIGURES

if TYPE_CHECKING:
    from kinedex.pipelines.engine.config import KnownFailures
    from kinedex.storage.lock import Wait

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
FormatOption = Annotated[str, typer.Option("--format", help="table, csv, json or parquet.")]
OutputOption = Annotated[
    Path | None,
    typer.Option(
        "--output", "-o", help="Write to this file; its ending (.csv, .json, .parquet) is the format unless given."
    ),
]
HitsOutputOption = Annotated[
    Path | None,
    typer.Option(
        "--output",
        "-o",
        help="Write to this file; its ending (.csv, .json, .parquet) is the format unless given; .png makes a picture "
        "with the frames of each hit.",
    ),
]
HtmlOption = Annotated[
    Path | None,
    typer.Option("--html", metavar="FILE", help="Write a page with a moving figure of each; it needs no network."),
]
FiguresOption = Annotated[
    int, typer.Option("--figures", min=1, metavar="N", help="Largest number of figures of a page or picture.")
]


def seconds_of(text: str | float) -> float:
    """Return the seconds of a duration such as 30s, 10m, 2h or 30d.

    Raises
    ------
    BadParameter
        The text is no duration.
    """
    match = re.fullmatch(r"(\d+(?:\.\d+)?)\s*([smhd])", str(text).strip())
    if match is None:
        raise typer.BadParameter(f"'{text}' is no duration; expected a number and its unit: 30s, 10m, 2h, 30d")
    return float(match[1]) * {"s": 1, "m": 60, "h": 3600, "d": 86400}[match[2]]


def wait_of(seconds: float | None) -> Wait:
    """Return the `Wait` for the seconds of `--wait`, which prints the process that the command waits for."""
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
        help="Wait so long (30s, 10m, 2h) for another writer; fail at once unless given.",
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


def known_failures_of(word: str | None) -> KnownFailures | None:
    """Return the value of `--known-failures`, None if absent; raise BadParameter for an unknown value."""
    if word not in (None, "report", "remember"):
        raise typer.BadParameter(f"--known-failures {word}: expected remember or report")
    return cast("KnownFailures | None", word)


def interval_of(text: str) -> tuple[int, int]:
    """Return the frames of an interval such as 100:160."""
    start, colon, stop = text.strip().partition(":")
    if not (colon and start.isdecimal() and stop.isdecimal() and int(start) < int(stop)):
        raise typer.BadParameter(f"--frames {text}: expected the first frame and the one after the last, as 0:60")
    return int(start), int(stop)
