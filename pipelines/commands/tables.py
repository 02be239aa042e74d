"""Commands that ask a store: sql, takes, export."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.pipelines.commands.shell import Format, Output, StorePath, Where, app, command, guard, show_table
from kinedex.pipelines.console.terminal import make_console


class _SqlCommand(TyperCommand):
    """A statement may begin with a comment: where white space follows two dashes before any =, they are no option."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if "--" not in args:
            statements = [word for word in args if re.match(r"--[^\s=]*\s", word)]
            if statements:
                args = [*(word for word in args if word not in statements), "--", *statements]
        return super().parse_args(ctx, args)


@app.command(cls=_SqlCommand)
@guard
def sql(
    store: StorePath,
    query: Annotated[
        str | None, typer.Argument(help="one SQL statement; without it, standard input or a prompt")
    ] = None,
    file: Annotated[Path | None, typer.Option("--file", "-f", help="read the statement from this file")] = None,
    path: Annotated[
        bool, typer.Option("--path", help="print the index file, which any DuckDB client opens, and do nothing else")
    ] = False,
    form: Format = "table",
    output: Output = None,
) -> None:
    """Ask the store in SQL (DuckDB), read-only. `SELECT * FROM help` lists the views and macros."""
    from kinedex.storage.store.store import open_store

    if path:
        if query is not None or file is not None:
            raise KinedexError("--path prints the index file and runs no SQL; leave the statement out")
        print(open_store(store).index_path().absolute())
        return
    if query is not None and file is not None:
        raise KinedexError("give the SQL as an argument or with --file, not both")
    if file is not None:
        if not file.is_file():
            raise KinedexError(f"--file {file}: no such file")
        try:
            query = file.read_text(encoding="utf-8")
        except UnicodeDecodeError as fault:
            raise KinedexError(f"--file {file}: not UTF-8 text (byte {fault.start})") from None
    opened = open_store(store)
    if query is None and sys.stdin.isatty():
        from kinedex.pipelines.console.sql_prompt import run_prompt

        run_prompt(opened, make_console())
        return
    show_table(opened.sql(query if query is not None else sys.stdin.read()), form, output)


@command
def takes(
    store: StorePath,
    where: Where = None,
    columns: Annotated[str, typer.Option(help="columns to show, separated by commas; * for all")] = (
        "name,actor,class,clip,frames,seconds,source_rate_hz,warnings"
    ),
    form: Format = "table",
    output: Output = None,
) -> None:
    """List the takes of a store."""
    from kinedex.storage.store.store import open_store

    frame = open_store(store).takes(where)
    wanted = frame.columns if columns.strip() == "*" else [column.strip() for column in columns.split(",")]
    for column in wanted:
        if column not in frame.columns:
            raise KinedexError(f"--columns: takes have no column '{column}'{did_you_mean(column, frame.columns)}")
    show_table(frame.select(wanted).to_arrow(), form, output)
    if form == "table" and output is None:
        make_console().print(f"{len(frame)} takes, {frame['seconds'].sum() / 60:.1f} minutes")


@command
def export(
    store: StorePath,
    take: Annotated[str, typer.Argument(help="name of the take")],
    form: Annotated[
        str, typer.Option("--format", help="bvh, csv or parquet; by default what the output's ending says")
    ] = "",
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="file to write; TAKE.FORMAT unless given")
    ] = None,
) -> None:
    """Write a take's joint positions (metres, Y up) as BVH, CSV or Parquet."""
    from kinedex.storage.formats.motion.export import export_take
    from kinedex.storage.store.store import open_store

    form = form or (output.suffix.lstrip(".").lower() if output else "") or "csv"
    path = output or Path(f"{Path(take).name}.{form}")
    export_take(open_store(store), take, form, path)
    print(path)
