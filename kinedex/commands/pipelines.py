"""Commands that run pipelines: demo, run, plan, ingest, synth."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from kinedex.commands.app import RUN, command
from kinedex.commands.options import (
    AcceptOption,
    ExecutorOption,
    ForceOption,
    JsonOption,
    KnownFailuresOption,
    MaxMemoryOption,
    MetadataOption,
    PipelineArgument,
    RateOption,
    SchedulerOption,
    SetOption,
    StoreOption,
    StorePath,
    WaitOption,
    WorkersOption,
    assignments_of,
    known_failures_of,
)
from kinedex.commands.output import print_json, show_outcome


@command(RUN)
def demo(
    store: Annotated[
        Path | None,
        typer.Argument(
            metavar="STORE",
            help="Directory of the store; created where it is missing.",
            show_default="build/demo-store; build/tracking-store with --tracking, and so on",
        ),
    ] = None,
    data: Annotated[
        Path | None, typer.Option(help="Archive of motion files; a synthetic one is made unless given.")
    ] = None,
    minutes: Annotated[
        float | None,
        typer.Option(
            min=1,
            help="Minutes of motion in the synthetic archive.",
            show_default="30; 3 with --tracking, --depth or --inertial",
        ),
    ] = None,
    method: Annotated[str, typer.Option(help="Method of annotation: thesis or best.")] = "thesis",
    tracking: Annotated[
        bool, typer.Option("--tracking", help="Film takes by simulated cameras, track and stabilise them.")
    ] = False,
    depth: Annotated[
        bool, typer.Option("--depth", help="Film takes by a simulated depth camera, and reconstruct them.")
    ] = False,
    inertial: Annotated[
        bool, typer.Option("--inertial", help="Put simulated inertial sensors on takes, and judge the takes by them.")
    ] = False,
    executor: ExecutorOption = "processes",
    workers: WorkersOption = None,
    as_json: JsonOption = False,
) -> None:
    """Run everything, from motion files to a report.

    The archive is synthetic, and made where it is missing; --data runs the same on an archive of your own.
    """
    from kinedex.commands.demo import run_demo, run_depth_demo, run_tracking_demo
    from kinedex.commands.inertial_demo import run_inertial_demo
    from kinedex.console.terminal import message_console

    others = {"tracking": run_tracking_demo, "depth": run_depth_demo, "inertial": run_inertial_demo}
    chosen = [name for name, on in (("tracking", tracking), ("depth", depth), ("inertial", inertial)) if on]
    if len(chosen) > 1:
        raise typer.BadParameter(f"{' and '.join(f'--{name}' for name in chosen)} are different demos; choose one")
    if chosen and data is not None:
        raise typer.BadParameter(f"--{chosen[0]} uses takes of the synthetic archive; leave out --data")
    if chosen:
        store = store or Path(f"build/{chosen[0]}-store")
        outcome = others[chosen[0]](store, minutes or 3.0, executor, workers, message_console())
    else:
        store = store or Path("build/demo-store")
        outcome = run_demo(store, data, minutes or 30.0, executor, workers, message_console(), method)
    show_outcome(outcome, store, as_json, repeat=True)


@command(RUN)
def run(
    pipeline: PipelineArgument,
    store: StoreOption,
    assign: SetOption = None,
    executor: ExecutorOption = "processes",
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    force: ForceOption = None,
    max_memory: MaxMemoryOption = None,
    accept: AcceptOption = False,
    known_failures: KnownFailuresOption = None,
    wait: WaitOption = None,
    as_json: JsonOption = False,
) -> None:
    """Run the stages of a pipeline that are not up to date.

    A stage runs where its code, its parameters or its inputs changed since it last ran.
    """
    from kinedex.console.terminal import Terminal
    from kinedex.pipelines.engine.runner import run_pipeline

    assignments = assignments_of(assign)
    if max_memory is not None:
        assignments["ingest.max_memory"] = max_memory
    outcome = run_pipeline(
        pipeline, store, assignments=assignments, executor=executor, workers=workers, scheduler=scheduler,
        force=frozenset(force or ()), terminal=Terminal(), wait_seconds=wait or 0.0, accept=accept,
        known_failures=known_failures_of(known_failures),
    )  # fmt: skip
    show_outcome(outcome, store, as_json)


@command(RUN)
def plan(
    pipeline: PipelineArgument,
    store: Annotated[
        Path, typer.Option("--store", metavar="DIR", help="Directory of the store; nothing is written into it.")
    ],
    assign: SetOption = None,
    force: ForceOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show which stages `run` would run, and why."""
    from kinedex.pipelines.engine.config import load_pipeline
    from kinedex.pipelines.engine.plan import make_plan

    loaded = load_pipeline(pipeline, assignments_of(assign))
    steps = make_plan(loaded, store, frozenset(force or ()))
    if as_json:
        stages = [
            {
                "stage": step.stage.name,
                "inputs": sorted(set(step.stage.inputs.values())),
                "runs_because": step.reason,
                "last_finished": step.record and step.record.finished,
                "last_seconds": step.record and step.record.seconds,
            }
            for step in steps
        ]
        print_json({"pipeline": loaded.name, "description": loaded.description, "store": store, "stages": stages})
        return
    from rich import box
    from rich.table import Table

    from kinedex.console.tables import plain_text
    from kinedex.console.terminal import make_console

    table = Table(
        box=box.SIMPLE_HEAD,
        pad_edge=False,
        title=plain_text(f"{loaded.name}: {loaded.description}"),
        title_justify="left",
    )
    for column in ("stage", "inputs", "runs because", "last run"):
        table.add_column(column)
    for step in steps:
        last = f"{step.record.finished} ({step.record.seconds:g} s)" if step.record else "never"
        inputs = ", ".join(sorted(set(step.stage.inputs.values()))) or "–"
        nothing = f"– (unchanged: {step.what})" if step.what else "– (nothing to do)"
        table.add_row(*map(plain_text, (step.stage.name, inputs, step.reason or nothing, last)))
    make_console().print(table)


@command(RUN)
def ingest(
    store: StorePath,
    source: Annotated[Path, typer.Argument(help="Folder of motion files.")],
    rate: RateOption = None,
    metadata: MetadataOption = None,
    prune: Annotated[bool, typer.Option("--prune", help="Drop takes whose file is no longer in the source.")] = False,
    strict: Annotated[bool, typer.Option("--strict", help="Stop at the first file that cannot be read.")] = False,
    assign: SetOption = None,
    executor: ExecutorOption = "processes",
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    max_memory: MaxMemoryOption = None,
    accept: AcceptOption = False,
    known_failures: KnownFailuresOption = None,
    wait: WaitOption = None,
    as_json: JsonOption = False,
) -> None:
    """Read motion files into a store and index them.

    This is the pipeline `ingest`. Takes are committed batch by batch: after an interruption the same command continues
    where it was.
    """
    from kinedex.console.terminal import Terminal
    from kinedex.pipelines.engine.runner import run_pipeline

    assignments = {"source": str(source), **assignments_of(assign)}
    for name, wanted in (("prune", prune), ("strict", strict)):
        if wanted:
            assignments[f"ingest.{name}"] = "true"
    if rate is not None:
        assignments["ingest.override_rate_hz"] = str(rate)
    if metadata:
        assignments["ingest.metadata"] = json.dumps(list(map(str, metadata)))
    if max_memory is not None:
        assignments["ingest.max_memory"] = max_memory
    outcome = run_pipeline(
        "ingest", store, assignments=assignments, executor=executor, workers=workers, scheduler=scheduler,
        terminal=Terminal(), wait_seconds=wait or 0.0, accept=accept,
        known_failures=known_failures_of(known_failures),
    )  # fmt: skip
    show_outcome(outcome, store, as_json)


@command(RUN)
def synth(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="Folder to create; empty or missing.")],
    minutes: Annotated[float, typer.Option(min=1, help="Minutes of motion in all.")] = 30.0,
    actors: Annotated[int, typer.Option(min=2, help="Number of actors.")] = 5,
    seed: Annotated[int, typer.Option(help="Seed; the same seed makes the same bytes.")] = 2026,
    workers: WorkersOption = None,
    as_json: JsonOption = False,
) -> None:
    """Make a synthetic archive of ASF/AMC files with ground truth."""
    from kinedex.commands.demo import make_archive
    from kinedex.console.terminal import message_console

    made = make_archive(directory, minutes, actors, seed, workers, message_console())
    if as_json:
        print_json({**asdict(made), "directory": directory})
