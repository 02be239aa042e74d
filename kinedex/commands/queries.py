"""Commands about keyframe queries: search, and the group `query`, which makes them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinedex.commands.app import SEARCH, command, group
from kinedex.commands.options import (
    FIGURES,
    AtOption,
    FiguresOption,
    FormatOption,
    HitsOutputOption,
    HtmlOption,
    JsonOption,
    StorePath,
    WhereOption,
)
from kinedex.commands.output import ROWS, is_for_people, print_json, print_message, print_path, show_table
from kinedex.commands.pages import Pages
from kinedex.commands.store_access import open_for_reading
from kinedex.ops.errors import KinedexError
from kinedex.ops.wording import counted

if TYPE_CHECKING:
    import pyarrow as pa

query = group("query", "Make keyframe queries.", SEARCH)


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
    form: FormatOption = "table",
    output: HitsOutputOption = None,
    html: HtmlOption = None,
    figures: FiguresOption = FIGURES,
    at: AtOption = None,
    as_json: JsonOption = False,
) -> None:
    """Search for keyframe queries with the index.

    The result is a table of the intervals that hold hits.
    """
    from kinedex.pipelines.engine.run_id import new_run_id
    from kinedex.pipelines.search.explanation import explain_search
    from kinedex.pipelines.search.search import load_query_file, save_hits, search_remarks, search_store

    pages = Pages(html, output, figures)
    _refuse_contradictions(explain, save, at, bool(html or pages.picture))
    opened = open_for_reading(store, at if save is None else "newest")
    loaded = load_query_file(queries, opened.feature_set, name, opened.rate_hz)
    plain = form == "table" and output is None
    if explain:
        table = explain_search(opened, loaded, where)
        if as_json:
            print_json({"store": store, "query_file": queries, "explanation": table})
        else:
            show_table(_explanation(table) if plain else table, form, output)
        return
    run = None if save is None else new_run_id()
    hits = search_store(opened, loaded, where) if run is None else search_store(opened, loaded, where, run)
    remarks = search_remarks(opened, loaded, where)
    pages.write_search(opened, hits, f"Hits of {queries}", remarks)
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
    if limit is None and is_for_people(form, output):
        limit = ROWS
    shown = hits.slice(0, limit or None)
    if plain:
        _show_hits(hits, shown, save, run)
    elif pages.picture is not None:
        print_path(pages.picture)
    else:
        show_table(shown if save is not None else shown.drop_columns(["saved_as"]), form, output)
        if shown.num_rows < hits.num_rows:
            typer.echo(f"{counted(hits.num_rows, 'interval')}{_part(shown.num_rows)}", err=True)
    pages.report()


def _refuse_contradictions(explain: bool, save: str | None, at: int | str | None, pictures: bool) -> None:
    """Raise a KinedexError if options of a search exclude each other."""
    if explain and save is not None:
        raise KinedexError("--explain shows no hits that --save could store: give only one of them")
    if explain and pictures:
        raise KinedexError("--explain shows no hits: give it without --html and without a picture")
    if at is not None and save is not None:
        raise KinedexError("--save stores the hits in the newest version: give no --at with it")


def _show_hits(hits: pa.Table, shown: pa.Table, save: str | None, run: str | None) -> None:
    """Print the first hits as a table, and a line with the totals below; only the line if hits were saved."""
    if save is not None:
        print_message(f"{counted(hits.num_rows, 'hit')} saved as '{save}' (run {run})")
        return
    show_table(shown.drop_columns(["run", "saved_as", "take_id"]), "table", None)
    hint = _part(shown.num_rows) if shown.num_rows < hits.num_rows else ""
    hint = hint if hits.num_rows else "; --explain shows at which keyframe the search ends"
    print_message(f"{counted(hits.num_rows, 'interval')} in {counted(_takes(hits), 'take')}{hint}")


def _takes(hits: pa.Table) -> int:
    return len(set(hits.column("take_id").to_pylist()))


def _part(shown: int) -> str:
    return f"; the first {shown:,} are shown, --limit 0 shows all"


def _explanation(table: pa.Table) -> pa.Table:
    """Return the columns of an explanation that a terminal shows."""
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
    start: Annotated[
        str | None, typer.Argument(help="First frame (45) or seconds (1.5s); else the take's first.")
    ] = None,
    stop: Annotated[str | None, typer.Argument(help="Frame after the last, or seconds; else the end.")] = None,
    name: Annotated[str, typer.Option(help="Name of the query.")] = "proposed",
    keyframes: Annotated[int, typer.Option(min=1, max=20, help="Largest number of keyframes.")] = 3,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="File to write; standard output unless given.")
    ] = None,
    at: AtOption = None,
    as_json: JsonOption = False,
) -> None:
    """Propose a keyframe query for an example, as YAML to be edited."""
    from kinedex.pipelines.search.query_proposal import propose_query
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
