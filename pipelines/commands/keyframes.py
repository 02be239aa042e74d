"""Commands about learned keyframe queries: keyframes learn, show, export."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ops.errors import KinedexError, did_you_mean
from pipelines.commands.shell import (
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
from pipelines.terminal import make_console

if TYPE_CHECKING:
    from pipelines.keyframes.learning import Outcome
    from storage.store import Store

keyframes = typer.Typer(name="keyframes", help="Learn keyframe queries from example clips.", no_args_is_help=True)
app.add_typer(keyframes, rich_help_panel="Search for motion")

ClassOption = Annotated[
    list[str] | None, typer.Option("--class", "-c", metavar="CLASS", help="only this one; may be repeated")
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
    """Learn a keyframe query for each class of a store; finished runs are never lost."""
    from storage.store import open_store

    open_store(store)
    run_to_the_end(pipeline, store, assignments_of(assign), executor, workers, scheduler, force)


def show(store: StorePath, name: ClassOption = None, form: Format = "table", output: Output = None) -> None:
    """Show learned queries: how well they tell the training clips apart, and what they ask for."""
    from pipelines.keyframes.tables import overview
    from storage.store import open_store

    opened = open_store(store)
    outcomes = _outcomes(opened, name)
    show_table(overview(outcomes, opened.feature_set), form, output)


def export(
    store: StorePath,
    name: ClassOption = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="file to write (.yaml); the terminal unless given")
    ] = None,
) -> None:
    """Write learned queries as a query file with named features, to read, to edit, and to search with."""
    from catalog.querywriting import write_queries
    from pipelines.keyframes.learning import keyframe_queries
    from storage.disk import writing
    from storage.store import open_store

    opened = open_store(store)
    queries = [query for one in _outcomes(opened, name) for query in keyframe_queries(one, opened.feature_set)]
    text = write_queries(queries, opened.feature_set)
    if output is None:
        print(text, end="")
        return
    with writing(output):
        output.write_text(text, encoding="utf-8")
    make_console().print(f"{len(queries)} queries written to {output}", markup=False)


def _outcomes(store: Store, names: list[str] | None) -> list[Outcome]:
    from pipelines.keyframes.runs import outcomes_of

    found = {one.subclass: one for one in outcomes_of(store.result("queries"))}
    if not found:
        raise KinedexError(f"{store.path} has no learned queries; learn some: kinedex keyframes learn {store.path}")
    for name in names or ():
        if name not in found:
            raise KinedexError(f"no query was learned for '{name}'{did_you_mean(name, found)}")
    return [found[name] for name in names] if names else list(found.values())


for _function in (learn, show, export):
    keyframes.command()(guard(_function))
