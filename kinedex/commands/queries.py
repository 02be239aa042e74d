"""Define the commands about keyframe queries: search, query from-clip, keyframes learn, show and export."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinedex.commands.app import SEARCH, command, group
from kinedex.commands.options import (
    AtOption,
    JsonOption,
    Output,
    RunOptions,
    StartArgument,
    StopArgument,
    StorePath,
    WhereOption,
    open_for_reading,
)
from kinedex.commands.output import print_json, print_message, print_path, show_outcome, show_table
from kinedex.commands.pages import HitsOutput
from kinedex.ops.errors import KinedexError
from kinedex.ops.wording import counted

if TYPE_CHECKING:
    import pyarrow as pa

    from kinedex.pipelines.keyframes.stored_queries import StoredQueries
    from kinedex.storage.store.store import Store

query = group("query", "Make keyframe queries.", SEARCH)
keyframes = group("keyframes", "Learn keyframe queries from example clips.", SEARCH)


ExplainOption = Annotated[
    bool,
    typer.Option(
        "--explain",
        help="Show list sizes per keyframe, the frames that survive it, and times: a search takes `takes`, `open` "
        "and `search`; lists and keyframes are read for the explanation alone.",
    ),
]
SaveOption = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="Save the hits in the store under this name: `saved_as` of the view `hits`."),
]


SearchLimitOption = Annotated[
    int | None,
    typer.Option(
        "--limit", "--top",
        min=0,
        metavar="N",
        help="Show this many intervals, in the order of the takes, and report the number of all; 0 shows all. A table "
        "on a terminal has 200 unless given, everything else has all.",
    ),
]  # fmt: skip


@command(SEARCH)
def search(
    store: StorePath,
    queries: Annotated[str, typer.Argument(help="Query file: name of a shipped one, or path (.yaml, .json).")],
    name: Annotated[
        list[str] | None, typer.Option("--query", "-q", help="Only this query; may be given several times.")
    ] = None,
    where: WhereOption = None,
    explain: ExplainOption = False,
    save: SaveOption = None,
    limit: SearchLimitOption = None,
    *,
    output: HitsOutput,
    at: AtOption = None,
    as_json: JsonOption = False,
) -> None:
    """Search for keyframe queries with the index.

    The result is a table of the intervals with hits.
    """
    from kinedex.pipelines.engine.run_id import new_run_id
    from kinedex.pipelines.keyframes.search_explanation import explain_search
    from kinedex.pipelines.keyframes.store_search import load_query_file, save_hits, search_remarks, search_store

    output.check()
    if explain and save is not None:
        raise KinedexError("--explain shows no hits that --save could store: give only one of them")
    if explain and (output.html or output.picture):
        raise KinedexError("--explain shows no hits: give it without --html and without a picture")
    if at is not None and save is not None:
        raise KinedexError("--save stores the hits in the newest version: give no --at with it")
    opened = open_for_reading(store, at if save is None else "newest")
    loaded = load_query_file(queries, opened.feature_set, name, opened.rate_hz)
    if explain:
        table = explain_search(opened, loaded, where)
        if as_json:
            print_json({"store": store, "query_file": queries, "explanation": table})
        else:
            output.show(_explanation(table) if output.is_plain else table)
        return
    run = None if save is None else new_run_id()
    hits = search_store(opened, loaded, where) if run is None else search_store(opened, loaded, where, run)
    remarks = search_remarks(opened, loaded, where)
    output.write_search(opened, hits, f"Hits of {queries}", remarks)
    if save is not None and run is not None:
        opened.close()
        hits = save_hits(opened, hits, save, run)
    if as_json:
        document = {"store": store, "query_file": queries, "takes": _takes(hits), "saved_as": save, "run": run}
        document |= {"remarks": remarks} if remarks else {}
        print_json({**document, "hits": hits.drop_columns(["run", "saved_as"])})
        return
    for remark in remarks:
        typer.echo(remark, err=True)
    shown = hits.slice(0, output.most(limit))
    if output.is_plain:
        _show_hits(hits, shown, save, run)
    elif output.picture is not None:
        print_path(output.picture)
    else:
        output.show(shown if save is not None else shown.drop_columns(["saved_as"]))
        if shown.num_rows < hits.num_rows:
            typer.echo(f"{counted(hits.num_rows, 'interval')}{_part(shown.num_rows)}", err=True)
    output.report()


def _show_hits(hits: pa.Table, shown: pa.Table, save: str | None, run: str | None) -> None:
    """Print the first hits as a table with a line of totals below; if hits were saved, print only the line."""
    if save is not None:
        print_message(f"{counted(hits.num_rows, 'hit')} saved as '{save}' (run {run})")
        return
    show_table(shown.drop_columns(["run", "saved_as", "take_id"]))
    hint = _part(shown.num_rows) if shown.num_rows < hits.num_rows else ""
    hint = hint if hits.num_rows else "; --explain shows at which keyframe the search ends"
    print_message(f"{counted(hits.num_rows, 'interval')} in {counted(_takes(hits), 'take')}{hint}")


def _takes(hits: pa.Table) -> int:
    return len(set(hits.column("take_id").to_pylist()))


def _part(shown: int) -> str:
    return f"; the first {shown:,} are shown, --limit 0 shows all"


def _explanation(table: pa.Table) -> pa.Table:
    """Return those columns of an explanation that are shown on a terminal."""
    from kinedex.console.tables import wrapped
    from kinedex.console.terminal import make_console

    nameless = table.column("name").null_count == table.num_rows
    table = table.drop_columns(["pattern", *(["name"] if nameless else [])])
    # a terminal wraps by itself, to its own width
    return table if make_console().is_terminal else wrapped(table, "features", 60)


@command(of=query, name="from-clip")
def from_clip(
    store: StorePath,
    take: Annotated[str, typer.Argument(help="Name of the take that holds the example.")],
    start: StartArgument = None,
    stop: StopArgument = None,
    name: Annotated[str, typer.Option(help="Name of the query.")] = "proposed",
    keyframes: Annotated[int, typer.Option(min=1, max=20, help="Largest number of keyframes.")] = 3,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="File to write; standard output unless given.")
    ] = None,
    at: AtOption = None,
    as_json: JsonOption = False,
) -> None:
    """Propose a keyframe query for an example, as YAML to be edited."""
    from kinedex.pipelines.keyframes.proposed_query import propose_query
    from kinedex.pipelines.templates.stored_templates import clip_range

    opened = open_for_reading(store, at)
    first, last = clip_range(opened, take, start, stop)
    text = propose_query(opened, take, first, last, name=name, keyframes=keyframes)
    if output is not None:
        output.write_text(text, encoding="utf-8")
    if as_json:
        print_json({"store": store, "name": name, "yaml": text, "file": output})
    elif output is not None:
        print_path(output)
    else:
        print(text, end="")


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
    *,
    options: Annotated[RunOptions, "assign executor workers scheduler force wait"],
    as_json: JsonOption = False,
) -> None:
    """Learn a keyframe query for each class.

    An interruption loses at most 20 seconds of finished runs.
    """
    from kinedex.storage.store.store import open_store

    open_store(store, at="newest")
    show_outcome(options.run(pipeline, store), store, as_json)


@command(of=keyframes)
def show(
    store: StorePath,
    name: ClassOption = None,
    pipeline: PipelineOption = None,
    *,
    output: Output,
    at: AtOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show learned queries and how well they separate the training clips.

    Precision and recall are for all queries of a class together, and are shown only in the first row of the class.
    """
    from kinedex.console.tables import PrintedTable, wrapped
    from kinedex.console.terminal import make_console
    from kinedex.pipelines.keyframes.stored_queries import LEGEND, queries_overview

    opened = open_for_reading(store, at)
    found = _stored(opened, name, pipeline)
    table = queries_overview(found.outcomes, opened.feature_set, found.classes)
    if as_json:
        print_json({"store": store, "stage": found.stage, "queries": table})
        return
    if not output.is_plain:
        output.show(table)
        return
    console = make_console()
    # a terminal wraps by itself, to its own width
    console.print(PrintedTable(table if console.is_terminal else wrapped(table, "keyframes", 76), null=""))
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
    from kinedex.pipelines.keyframes.query_learning import keyframe_queries

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
    """Return the newest learned queries, and print which other stages have queries of the same classes."""
    from kinedex.pipelines.keyframes.stored_queries import stored_queries

    found = stored_queries(store, classes, pipeline)
    if found.other_stages:
        others = ", ".join(found.other_stages)
        typer.echo(f"queries of {found.stage}, the newest; --pipeline shows others: {others}", err=True)
    return found
