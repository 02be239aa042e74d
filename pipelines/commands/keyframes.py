"""Commands about learned keyframe queries: keyframes learn, show, export."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.pipelines.commands.shell import (
    ExecutorOption,
    ForceOption,
    Format,
    Output,
    SchedulerOption,
    SetOption,
    StorePath,
    WorkersOption,
    app,
    assignments_of,
    guard,
    run_to_the_end,
    show_table,
)
from kinedex.pipelines.console.terminal import make_console

if TYPE_CHECKING:
    from kinedex.pipelines.keyframes.learning import Outcome
    from kinedex.storage.store.store import Store

keyframes = typer.Typer(name="keyframes", help="Learn keyframe queries from example clips.", no_args_is_help=True)
app.add_typer(keyframes, rich_help_panel="Search for motion")

ClassOption = Annotated[
    list[str] | None, typer.Option("--class", "-c", metavar="CLASS", help="only this one; may be repeated")
]

PipelineOption = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="the pipeline that learned them, or pipeline/stage; the newest unless given"),
]


def learn(
    store: StorePath,
    pipeline: Annotated[str, typer.Option(help="a pipeline with a stage learn_keyframes: shipped, or a path")] = (
        "keyframes"
    ),
    assign: SetOption = None,
    executor: ExecutorOption = "processes",
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    force: ForceOption = None,
) -> None:
    """Learn a keyframe query for each class of a store; an interruption loses 20 seconds of finished runs at most."""
    from kinedex.storage.store.store import open_store

    open_store(store)
    run_to_the_end(pipeline, store, assignments_of(assign), executor, workers, scheduler, force)


def show(
    store: StorePath,
    name: ClassOption = None,
    pipeline: PipelineOption = None,
    form: Format = "table",
    output: Output = None,
) -> None:
    """Show learned queries: how well they tell the training clips apart, and what they ask for.

    Precision and recall are those of all queries of a class together, so they stand on its first row only.
    """
    from kinedex.pipelines.console.tables import Shown, wrapped
    from kinedex.pipelines.keyframes.tables import LEGEND, overview
    from kinedex.storage.store.store import open_store

    opened = open_store(store)
    outcomes, taken = _outcomes(opened, name, pipeline)
    table = overview(outcomes, opened.feature_set, taken)
    if form != "table" or output is not None:
        show_table(table, form, output)
        return
    console = make_console()
    # a terminal wraps by itself, to its own width
    console.print(Shown(table if console.is_terminal else wrapped(table, "keyframes", 76), null=""))
    console.print(LEGEND, markup=False)


def export(
    store: StorePath,
    name: ClassOption = None,
    pipeline: PipelineOption = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="file to write (.yaml); the terminal unless given")
    ] = None,
) -> None:
    """Write learned queries as a query file with named features, to read, to edit, and to search with."""
    from kinedex.catalog.queries.query_writer import write_queries
    from kinedex.pipelines.keyframes.learning import keyframe_queries
    from kinedex.storage.disk import write_errors
    from kinedex.storage.store.store import open_store

    if output is not None and output.suffix.lower() not in (".yaml", ".yml"):
        raise KinedexError(f"--output {output}: query files end in .yaml, or they cannot be searched with")
    if output is not None and not output.parent.is_dir():
        raise KinedexError(f"--output {output}: there is no directory {output.parent}; make it first")
    opened = open_store(store)
    outcomes, taken = _outcomes(opened, name, pipeline)
    queries = [query for one in outcomes for query in keyframe_queries(one, opened.feature_set, taken)]
    text = write_queries(queries, opened.feature_set)
    if output is None:
        print(text, end="")
        return
    with write_errors(output):
        output.write_text(text, encoding="utf-8")
    make_console().print(f"{len(queries)} queries written to {output}", markup=False)


def _outcomes(store: Store, names: list[str] | None, pipeline: str | None) -> tuple[list[Outcome], set[str]]:
    """The outcomes asked for, each once, and the names of all classes that were learned with them."""
    from kinedex.pipelines.keyframes.runs import outcomes_of

    stage = _stage(store, pipeline)
    found = {one.subclass: one for one in outcomes_of(store.result("queries", stage=stage))}
    for name in names or ():
        if name not in found:
            raise KinedexError(f"no query was learned for '{name}' by {stage}{did_you_mean(name, found)}")
    return [found[name] for name in dict.fromkeys(names or found)], set(found)


def _stage(store: Store, pipeline: str | None) -> str:
    """Which stage's queries are meant, "<pipeline>/<stage>": the newest ones unless said; where there are several, it
    is said which these are."""
    # what was written last stands last
    stages = [part.stage for part in store.manifest.results.get("queries", ())]
    if not stages:
        raise KinedexError(f"{store.path} has no learned queries; learn some: kinedex keyframes learn {store.path}")
    fitting = [one for one in stages if pipeline is None or pipeline in (one, one.partition("/")[0])]
    if not fitting:
        assert pipeline is not None
        there = ", ".join(dict.fromkeys(one.partition("/")[0] for one in stages))
        raise KinedexError(f"--pipeline {pipeline}: no queries were learned by it; there are those of {there}")
    if len(fitting) > 1:
        others = ", ".join(fitting[:-1])
        print(f"queries of {fitting[-1]}, the newest; --pipeline shows others: {others}", file=sys.stderr)
    return fitting[-1]


for _function in (learn, show, export):
    keyframes.command()(guard(_function))
