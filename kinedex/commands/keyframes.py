"""Commands about learned keyframe queries: keyframes learn, show, export."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinedex.commands.app import SEARCH, command, group
from kinedex.commands.options import (
    AtOption,
    ExecutorOption,
    ForceOption,
    FormatOption,
    JsonOption,
    OutputOption,
    SchedulerOption,
    SetOption,
    StorePath,
    WaitOption,
    WorkersOption,
    assignments_of,
)
from kinedex.commands.output import print_json, print_message, show_outcome, show_table
from kinedex.commands.store_access import open_for_reading
from kinedex.ops.errors import KinedexError

if TYPE_CHECKING:
    from kinedex.pipelines.keyframes.stored_queries import StoredQueries
    from kinedex.storage.store.store import Store

keyframes = group("keyframes", "Learn keyframe queries from example clips.", SEARCH)

ClassOption = Annotated[
    list[str] | None,
    typer.Option("--class", "-c", metavar="CLASS", help="Only this class; may be given several times."),
]
PipelineOption = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="Pipeline that learned the queries, or PIPELINE/STAGE; the newest unless given."),
]


@command(of=keyframes)
def learn(
    store: StorePath,
    pipeline: Annotated[
        str, typer.Option(help="Pipeline with a stage learn_keyframes: name of a shipped one, or path.")
    ] = "keyframes",
    assign: SetOption = None,
    executor: ExecutorOption = "processes",
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    force: ForceOption = None,
    wait: WaitOption = None,
    as_json: JsonOption = False,
) -> None:
    """Learn a keyframe query for each class.

    An interruption loses at most 20 seconds of finished runs.
    """
    from kinedex.console.terminal import Terminal
    from kinedex.pipelines.engine.runner import run_pipeline
    from kinedex.storage.store.store import open_store

    open_store(store, at="newest")
    outcome = run_pipeline(
        pipeline, store, assignments=assignments_of(assign), executor=executor, workers=workers, scheduler=scheduler,
        force=frozenset(force or ()), terminal=Terminal(), wait_seconds=wait or 0.0,
    )  # fmt: skip
    show_outcome(outcome, store, as_json)


@command(of=keyframes)
def show(
    store: StorePath,
    name: ClassOption = None,
    pipeline: PipelineOption = None,
    form: FormatOption = "table",
    output: OutputOption = None,
    at: AtOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show learned queries and how well they separate the training clips.

    Precision and recall are those of all queries of a class together and stand on its first row only.
    """
    from kinedex.console.tables import Shown, wrapped
    from kinedex.console.terminal import make_console
    from kinedex.pipelines.keyframes.stored_queries import LEGEND, overview

    opened = open_for_reading(store, at)
    found = _stored(opened, name, pipeline)
    table = overview(found.outcomes, opened.feature_set, found.classes)
    if as_json:
        print_json({"store": store, "stage": found.stage, "queries": table})
        return
    if form != "table" or output is not None:
        show_table(table, form, output)
        return
    console = make_console()
    # a terminal wraps by itself, to its own width
    console.print(Shown(table if console.is_terminal else wrapped(table, "keyframes", 76), null=""))
    console.print(LEGEND, markup=False)


@command(of=keyframes)
def export(
    store: StorePath,
    name: ClassOption = None,
    pipeline: PipelineOption = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="File to write (.yaml); standard output unless given.")
    ] = None,
    at: AtOption = None,
    as_json: JsonOption = False,
) -> None:
    """Write learned queries as a query file, to edit and to search with."""
    from kinedex.catalog.queries.query_writer import write_queries
    from kinedex.pipelines.engine.page_files import write_page
    from kinedex.pipelines.keyframes.learning import keyframe_queries

    if output is not None and output.suffix.lower() not in (".yaml", ".yml"):
        raise KinedexError(f"--output {output}: the name of a query file ends in .yaml, or it cannot be searched with")
    opened = open_for_reading(store, at)
    found = _stored(opened, name, pipeline)
    queries = [query for one in found.outcomes for query in keyframe_queries(one, opened.feature_set, found.classes)]
    text = write_queries(queries, opened.feature_set)
    if output is not None:
        write_page(text, output)
    if as_json:
        print_json({"store": store, "stage": found.stage, "queries": len(queries), "yaml": text, "file": output})
    elif output is None:
        print(text, end="")
    else:
        print_message(f"{len(queries)} queries written to {output}")


def _stored(store: Store, classes: list[str] | None, pipeline: str | None) -> StoredQueries:
    """Return the newest learned queries, and print which other stages have some of the same classes."""
    from kinedex.pipelines.keyframes.stored_queries import stored_queries

    found = stored_queries(store, classes, pipeline)
    if found.other_stages:
        others = ", ".join(found.other_stages)
        typer.echo(f"queries of {found.stage}, the newest; --pipeline shows others: {others}", err=True)
    return found
