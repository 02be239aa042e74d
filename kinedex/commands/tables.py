"""Define the commands that show the content of a store: sql, takes, explore."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from kinedex.commands.app import ASK, Command, TakesPage, command, group
from kinedex.commands.options import (
    ROWS,
    AtOption,
    JsonOption,
    Output,
    StorePath,
    WhereOption,
    open_for_reading,
    seconds_of,
)
from kinedex.commands.output import print_json, print_message, print_path
from kinedex.commands.pages import Pages
from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.wording import counted, name_list, visible

if TYPE_CHECKING:
    import pyarrow as pa

    from kinedex.storage.store.store import Store


LimitOption = Annotated[
    int | None,
    typer.Option(
        min=0,
        metavar="N",
        help="Show this many rows and report the number of the others; 0 shows all. A table on a terminal has "
        "200 rows unless given, everything else has all.",
    ),
]


class _SqlCommand(Command):
    """A command whose SQL statement may begin with a comment.

    A word that begins with two dashes is a comment and not an option if white space comes before any equals sign.
    """

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if "--" not in args:
            statements = [word for word in args if re.match(r"--[^\s=]*\s", word)]
            if statements:
                args = [*(word for word in args if word not in statements), "--", *statements]
        return super().parse_args(ctx, args)


@command(ASK, cls=_SqlCommand)
def sql(
    store: StorePath,
    query: Annotated[
        str | None, typer.Argument(help="One SQL statement; standard input or a prompt unless given.")
    ] = None,
    file: Annotated[Path | None, typer.Option("--file", "-f", help="Read the statement from this file.")] = None,
    path: Annotated[
        bool, typer.Option("--path", help="Write a database file of all views for any DuckDB client, print its path.")
    ] = False,
    allow_files: Annotated[
        list[Path] | None,
        typer.Option("--allow-files", metavar="DIR", help="A folder whose files SQL may read; may be repeated."),
    ] = None,
    timeout: Annotated[
        float | None,
        typer.Option(
            "--timeout", metavar="DURATION", parser=seconds_of,
            help="End a statement that takes longer (30s, 10m, 2h) with exit code 124; no limit unless given.",
        ),
    ] = None,
    limit: LimitOption = None,
    *,
    output: Output,
    at: AtOption = None,
    as_json: JsonOption = False,
) -> None:  # fmt: skip
    """Ask the store in SQL (DuckDB), read-only. `SELECT * FROM help` lists the views and macros."""
    if path:
        if query is not None or file is not None:
            raise KinedexError("--path prints the path of the database file and runs no SQL: give no statement")
        _print_database(open_for_reading(store, at), as_json)
        return
    from kinedex.console.sql_prompt import hidden_rows_hints, rows_line, run_prompt
    from kinedex.console.terminal import make_console

    if query is not None and file is not None:
        raise KinedexError("give the SQL as an argument or with --file, not both")
    if file is not None:
        query = _statement_of(file)
    if missing := [folder for folder in allow_files or () if not folder.is_dir()]:
        raise KinedexError(f"--allow-files {missing[0]}: no such folder")
    opened = open_for_reading(store, at, allow_files or ())
    _bound_memory()
    prompts = query is None and sys.stdin.isatty() and not as_json
    if prompts:
        run_prompt(opened, make_console(), timeout=timeout, max_rows=(ROWS if limit is None else limit) or None)
        return
    query = sys.stdin.read() if query is None else query
    found = opened.answer(query, timeout=timeout, max_rows=(limit or None) if as_json else output.most(limit))
    if as_json:
        _print_rows(store, found.table, found.rows)
        return
    output.show(found.table)
    for hint in hidden_rows_hints(opened, query, found.rows):
        print(visible(hint), file=sys.stderr)
    if found.rows > found.table.num_rows:
        print(f"{rows_line(found)}; --limit 0 shows all", file=sys.stderr)


def _print_rows(store: Path, table: pa.Table, count: int) -> None:
    from kinedex.console.tables import distinct_names

    names = distinct_names(table.column_names)
    print_json({"store": store, "columns": names, "rows": table.rename_columns(names), "row_count": count})


def _print_database(store: Store, as_json: bool) -> None:
    from kinedex.storage.store.database_file import write_database

    path = write_database(store)
    if as_json:
        print_json({"store": store.path, "path": path})
    else:
        print_path(path)


def _bound_memory() -> None:
    """Limit this process to 90 % of the machine's memory, since DuckDB's limit does not count texts and lists.

    A statement that needs more memory then ends with an error; without a limit, the system would kill the process.
    """
    try:
        import resource
    except ImportError:  # Windows
        return
    most = int(0.9 * os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    if hard == resource.RLIM_INFINITY or most < hard:
        resource.setrlimit(resource.RLIMIT_DATA, (most, hard))


def _statement_of(file: Path) -> str:
    if not file.is_file():
        raise KinedexError(f"--file {file}: no such file")
    try:
        return file.read_text(encoding="utf-8")
    except UnicodeDecodeError as fault:
        raise KinedexError(f"--file {file}: not UTF-8 text (byte {fault.start})") from None


takes_group = group("takes", "List the takes of a store: `kinedex takes STORE`; remove some.", ASK, TakesPage)


@command(of=takes_group, name="list")
def takes(
    store: StorePath,
    where: WhereOption = None,
    columns: Annotated[str, typer.Option(help="Columns to show, separated by commas; * for all.")] = (
        "name,actor,class,clip,frames,seconds,source_rate_hz"
    ),
    limit: LimitOption = None,
    *,
    output: Output,
    pages: Pages,
    group: Annotated[
        str | None, typer.Option(metavar="COLUMN", help="Group the figures of the page by this column, or by folder.")
    ] = None,
    at: AtOption = None,
    as_json: JsonOption = False,
) -> None:
    """List the takes of a store; `kinedex takes STORE` is short for it."""
    pages.check()
    opened = open_for_reading(store, at)
    table = opened.takes_table(where)
    names = table.column_names
    wanted = names if columns.strip() == "*" else [column.strip() for column in columns.split(",")]
    for column in wanted:
        if column not in names:
            raise KinedexError(f"--columns: takes have no column '{column}'{did_you_mean(column, names)}")
    pages.write_takes(opened, table, group)
    seconds = sum(table.column("seconds").to_pylist())
    if as_json:
        print_json({"store": store, "seconds": seconds, "takes": table.select(wanted)})
        return
    shown = table.select(wanted).slice(0, output.most(limit))
    part = ""
    if pages.html is None or output.output is not None:
        output.show(shown, paged=True)
        if shown.num_rows < table.num_rows:
            part = f"; the first {shown.num_rows:,} are shown, --limit 0 shows all"
    pages.report()
    count = f"{counted(table.num_rows, 'take')}, {seconds / 60:.1f} minutes{part}"
    if output.is_plain:
        print_message("; ".join([count, *_take_remarks(table, wanted)]))
        if where is not None and not table.num_rows:
            print_message(_nothing_chosen(opened, where))
    elif part:
        print(count, file=sys.stderr)


def _nothing_chosen(store: Store, where: str) -> str:
    """Return a hint for a filter that selects no take, with the values of the columns that the filter names."""
    every = store.takes_table()
    words = dict.fromkeys(re.findall(r"\w+", re.sub(r"'(?:[^']|'')*'", " ", where)))
    texts = {name for name in every.column_names if str(every.schema.field(name).type) == "string"}
    found = []
    for name in (word for word in words if word in texts):
        values = sorted({value for value in every.column(name).to_pylist() if value is not None})
        shown = name_list([f"'{value}'" for value in values])
        found.append(f"{name} has {shown}" if values else f"{name} has no value")
    return f"no take of {counted(every.num_rows, 'take')} fits" + "".join(f"; {one}" for one in found)


def _take_remarks(table: pa.Table, columns: Sequence[str]) -> Iterator[str]:
    """Yield a remark on bodies that lack joints, and one on warnings if their column is not shown."""
    partial = table.num_rows - table.column("known").null_count
    if partial:
        yield f"{counted(partial, 'body', 'bodies')} without some joints (column known)"
    warned = sum(bool(warnings) for warnings in table.column("warnings").to_pylist())
    if warned and "warnings" not in columns:
        yield f"{counted(warned, 'take has', 'takes have')} warnings: --columns name,warnings"


@command(ASK)
def explore(
    store: StorePath,
    port: Annotated[
        int | None, typer.Option(min=0, max=65535, help="Port to listen on; 8734 or a free one unless given.")
    ] = None,
    host: Annotated[
        str, typer.Option(metavar="NAME", help="Listen on this address instead of this machine alone.")
    ] = "127.0.0.1",
    read_only: Annotated[bool, typer.Option("--read-only", help="Refuse everything that writes.")] = False,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Print the address only.")] = False,
) -> None:
    """Open the archive in a browser: takes, search by example, labels.

    A server on this machine shows the store until Ctrl-C. The address that it prints holds a token; nobody else can
    open it.
    """
    from kinedex.explorer.server import serve

    serve(
        store,
        host,
        port,
        read_only=read_only,
        browser=not no_browser,
        message=lambda text: print(text, flush=True),
        warn=lambda text: print(f"warning: {text}", file=sys.stderr, flush=True),
    )
