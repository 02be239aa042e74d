"""Commands about keyframe queries: search, and the group `query`, which makes them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from kinedex.ops.errors import KinedexError
from kinedex.pipelines.commands.shell import Format, Output, StorePath, Where, app, command, guard, show_table
from kinedex.pipelines.console.terminal import make_console
from kinedex.pipelines.console.wording import counted

query = typer.Typer(no_args_is_help=True, help="Make keyframe queries.")
app.add_typer(query, name="query", rich_help_panel="Search for motion")


@command
def search(
    store: StorePath,
    queries: Annotated[str, typer.Argument(help="a query file: a shipped name, or a path to a .yaml or .json file")],
    name: Annotated[list[str] | None, typer.Option("--query", "-q", help="only this query; may be repeated")] = None,
    where: Where = None,
    explain: Annotated[
        bool,
        typer.Option(
            help="show list sizes per keyframe, the frames kept, and times: a search takes `takes`, `open` and "
            "`search`; lists and keyframes are read for the explanation alone"
        ),
    ] = False,
    save: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="keep the hits in the store under this name: `saved_as` of the view `hits`"),
    ] = None,
    form: Format = "table",
    output: Output = None,
) -> None:
    """Search keyframe queries over the index; prints the ranges that hold hits."""
    from kinedex.pipelines.search.explanation import explain_search
    from kinedex.pipelines.search.search import load_query_file, save_hits, search_store
    from kinedex.storage.store.store import open_store

    opened = open_store(store)
    loaded = load_query_file(queries, opened.feature_set, name, opened.rate_hz)
    if explain:
        if save is not None:
            raise KinedexError("--explain shows no hits that --save could keep; leave one of them out")
        from kinedex.pipelines.console.tables import wrapped

        table = explain_search(opened, loaded, where)
        if form == "table" and output is None:
            nameless = table.column("name").null_count == table.num_rows
            table = table.drop_columns(["pattern", *(["name"] if nameless else [])])
            # a terminal wraps by itself, to its own width
            table = table if make_console().is_terminal else wrapped(table, "features", 60)
        show_table(table, form, output)
        return
    if save is None:
        hits = search_store(opened, loaded, where)
        plain = form == "table" and output is None
        show_table(hits.drop_columns(["run", "saved_as", "take_id"] if plain else ["saved_as"]), form, output)
        if plain:
            takes = len(set(hits.column("take_id").to_pylist()))
            hint = "" if hits.num_rows else "; --explain shows at which keyframe it ends"
            make_console().print(f"{counted(hits.num_rows, 'range')} in {counted(takes, 'take')}{hint}", markup=False)
        return
    from kinedex.pipelines.engine.runner import new_run_id

    run = new_run_id()
    hits = search_store(opened, loaded, where, run)
    opened.close()
    hits = save_hits(opened, hits, save, run)
    if output is not None or form != "table":
        show_table(hits, form, output)
    else:
        make_console().print(f"{counted(hits.num_rows, 'hit')} kept as '{save}' (run {run})", markup=False)


@query.command()
@guard
def from_clip(
    store: StorePath,
    take: Annotated[str, typer.Argument(help="name of the take that holds the example")],
    start: Annotated[
        str | None, typer.Argument(help="first frame of the example (45), or seconds (1.5s); the take's first")
    ] = None,
    stop: Annotated[str | None, typer.Argument(help="the frame after its last, or seconds; the take's end")] = None,
    name: Annotated[str, typer.Option(help="name of the query")] = "proposed",
    keyframes: Annotated[int, typer.Option(min=1, max=20, help="at most so many keyframes")] = 3,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="write to this file instead of the terminal")
    ] = None,
) -> None:
    """Propose a keyframe query from an example: YAML with comments, to be edited."""
    from kinedex.pipelines.search.query_proposal import propose_query
    from kinedex.pipelines.templates.stored_templates import clip_range
    from kinedex.storage.store.store import open_store

    opened = open_store(store)
    first, last = clip_range(opened, take, start, stop)
    text = propose_query(opened, take, first, last, name=name, keyframes=keyframes)
    if output is None:
        print(text, end="")
    else:
        output.write_text(text, encoding="utf-8")
        print(output)
