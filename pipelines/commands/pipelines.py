"""Commands that run pipelines: demo, run, plan, ingest, synth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from kinedex.pipelines.commands.shell import (
    ExecutorOption,
    ForceOption,
    RateOption,
    SchedulerOption,
    SetOption,
    StoreOption,
    StorePath,
    WorkersOption,
    assignments_of,
    command,
    finish,
    run_to_the_end,
)
from kinedex.pipelines.console.terminal import make_console


@command
def demo(
    store: StoreOption = Path("build/demo-store"),
    data: Annotated[
        Path | None, typer.Option(help="an archive of your own; a synthetic one is made without it")
    ] = None,
    minutes: Annotated[float, typer.Option(min=1, help="minutes of motion in the synthetic archive")] = 30.0,
    method: Annotated[str, typer.Option(help="how takes are labelled: thesis, or best")] = "thesis",
    executor: ExecutorOption = "processes",
    workers: WorkersOption = None,
) -> None:
    """Run the main job, from motion files to a report, on a synthetic archive or on your own."""
    from kinedex.pipelines.commands.demo import run_demo

    console = make_console()
    outcome = run_demo(store, data, minutes, executor, workers, console, method)
    finish(outcome, store, console)


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
    run_to_the_end(pipeline, store, assignments_of(assign), executor, workers, scheduler, force)


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

    from kinedex.pipelines.engine.config import load_pipeline
    from kinedex.pipelines.engine.plan import make_plan

    loaded = load_pipeline(pipeline, assignments_of(assign))
    table = Table(
        box=box.SIMPLE_HEAD, pad_edge=False, title=f"{loaded.name}: {loaded.description}", title_justify="left"
    )
    for column in ("stage", "inputs", "runs because", "last run"):
        table.add_column(column)
    steps = make_plan(loaded, store, frozenset(force or ()))
    for step in steps:
        last = f"{step.record.finished} ({step.record.seconds:g} s)" if step.record else "never"
        inputs = ", ".join(sorted(set(step.stage.inputs.values()))) or "–"
        nothing = f"– (unchanged: {step.what})" if step.what else "– (nothing to do)"
        table.add_row(step.stage.name, inputs, step.reason or nothing, last)
    make_console().print(table)


@command
def ingest(
    store: StorePath,
    source: Annotated[Path, typer.Argument(help="folder that holds the motion files")],
    rate: RateOption = None,
    prune: Annotated[bool, typer.Option("--prune", help="drop takes whose file is no longer in the source")] = False,
    strict: Annotated[
        bool, typer.Option("--strict", help="stop at the first file that does not come in, and fail with its message")
    ] = False,
    assign: SetOption = None,
    executor: ExecutorOption = "processes",
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
) -> None:
    """Bring motion files into a store and index them (the pipeline `ingest`).

    What comes in is committed batch by batch: stopped in the middle, the same command goes on where it was.
    """
    assignments = {"source": str(source), **assignments_of(assign)}
    for name, wanted in (("prune", prune), ("strict", strict)):
        if wanted:
            assignments[f"ingest.{name}"] = "true"
    if rate is not None:
        assignments["ingest.override_rate_hz"] = str(rate)
    run_to_the_end("ingest", store, assignments, executor, workers, scheduler)


@command
def synth(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="folder to make; must be empty or missing")],
    minutes: Annotated[float, typer.Option(min=1, help="minutes of motion in all")] = 30.0,
    actors: Annotated[int, typer.Option(min=2, help="how many actors")] = 5,
    seed: Annotated[int, typer.Option(help="the same seed makes the same bytes")] = 2026,
    workers: WorkersOption = None,
) -> None:
    """Make a synthetic archive: ASF/AMC files of example clips and long takes, with ground truth."""
    from kinedex.pipelines.commands.demo import make_archive

    make_archive(directory, minutes, actors, seed, workers, make_console())
