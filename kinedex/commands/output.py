"""Print results on standard output: tables in a chosen format, JSON objects, and outcomes of pipelines."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from kinedex.commands.app import LEFT_OUT
from kinedex.ops.errors import KinedexError
from kinedex.ops.wording import counted, name_list, visible, visible_lines

if TYPE_CHECKING:
    import pyarrow as pa

    from kinedex.pipelines.engine.runner import Outcome


def print_json(document: Mapping[str, object]) -> None:
    """Print a result as one JSON object; Arrow tables in it become lists of rows."""
    from kinedex.storage.formats.json_text import json_text

    sys.stdout.write(json_text(document))


def print_message(text: str) -> None:
    """Print a line about a result, which `--quiet` suppresses and `--json` sends to standard error."""
    from kinedex.console.terminal import message_console

    message_console().print(visible_lines(text), markup=False)


def print_path(path: Path) -> None:
    """Print a path on a separate line, byte for byte in a pipe, with control characters escaped on a terminal."""
    print(visible(str(path)) if sys.stdout.isatty() else path)


FEW = 10
"""Number of failures that the end of a run shows in full."""


def show_table(table: pa.Table, form: str = "table", output: Path | None = None, *, paged: bool = False) -> None:
    """Print a table, or write it to a file.

    Parameters
    ----------
    table : pyarrow.Table
        The result.
    form : str
        Format: table, csv, json or parquet. For a file, "table" stands for the format of the file's ending, or CSV if
        it has no ending.
    output : Path or None
        File to write; None for standard output.
    paged : bool, optional
        True to show a table that is longer than the terminal in a pager.

    Raises
    ------
    KinedexError
        If the format is unknown, or is Parquet on a terminal.
    """
    from kinedex.console.tables import PrintedTable, encode
    from kinedex.console.terminal import make_console, page_by_page

    if output is not None and form == "table":
        form = _form_of(output)
    if form == "table":
        console = make_console()
        long = paged and console.is_terminal and sys.stdin.isatty() and table.num_rows + 3 > console.height
        with page_by_page(console) if long else nullcontext():
            console.print(PrintedTable(table))
        return
    data = encode(table, form)
    if output is not None:
        output.write_bytes(data)
    elif form == "parquet" and sys.stdout.isatty():
        raise KinedexError("a terminal cannot show Parquet: write it to a file with --output FILE")
    else:
        # a terminal gets escaped text, and a pipe the same bytes as a file
        sys.stdout.write(data.decode()) if sys.stdout.isatty() else sys.stdout.buffer.write(data)


def _form_of(output: Path) -> str:
    form = output.suffix.lower().removeprefix(".") or "csv"
    if form not in ("csv", "json", "parquet"):
        raise KinedexError(
            f"--output {output}: no format has the ending '{output.suffix}'; expected .csv, .json or .parquet, or "
            "choose a format with --format"
        )
    return form


def _pooled_metrics(outcome: Outcome) -> list[dict[str, object]]:
    from kinedex.storage.store.store import open_store

    rows = open_store(outcome.store_path, at="newest").result("metrics", pipeline=outcome.pipeline.name).to_pylist()
    return [row for row in rows if row["scope"] == "pooled"]


def show_outcome(outcome: Outcome, store: Path, as_json: bool = False, *, repeat: bool = False) -> None:
    """Print how a pipeline ended and where its report is; exit with `LEFT_OUT` if the run had failures.

    Parameters
    ----------
    outcome : Outcome
        The outcome that `run_pipeline` returned.
    store : Path
        Directory of the store.
    as_json : bool
        Print the JSON object of `run` (docs/reference.md, "JSON output").
    repeat : bool
        Print the command that repeats the run.
    """
    from kinedex.console.terminal import make_console

    if as_json:
        print_json(
            {
                "pipeline": outcome.pipeline.name,
                "store": store,
                "ran": outcome.ran,
                "skipped": outcome.skipped,
                "report": outcome.report,
                "excluded_files": outcome.left_out,
                "unmatched_labels": [one.as_json() for one in outcome.unmatched],
                "files": _files(outcome),
                "metrics": _pooled_metrics(outcome),
            }
        )
    else:
        console = make_console()
        if not outcome.ran:
            console.print(
                f"everything was done already: {counted(len(outcome.skipped), 'stage')}, nothing to do", style="bold"
            )
        if outcome.report is not None:
            console.print(f"report: {outcome.report}", style="bold", markup=False)
        for line in _file_lines(outcome) if outcome.remembers else _failure_lines(outcome, store):
            console.print(visible_lines(line), markup=False)
        if repeat:
            console.print(f"again, where something changed: {outcome.command}", markup=False)
    if outcome.has_failures:
        raise typer.Exit(LEFT_OUT)


def _failure_lines(outcome: Outcome, store: Path) -> list[str]:
    """Return lines about excluded files and labels that match no take."""
    lines = [str(one) for one in outcome.unmatched]
    if outcome.left_out:
        listed = f'kinedex sql {shlex.quote(str(store))} "SELECT * FROM ingest_log"'
        lines.insert(0, f"{counted(outcome.left_out, 'source file')} excluded; list them: {listed}")
    return lines


def _file_lines(outcome: Outcome) -> list[str]:
    """Return lines about new, changed, gone, accepted and failed files, for a run that stores known failures."""
    files = outcome.files
    failed = [f"failed: {one.reason}" for one in files.failed[:FEW]]
    if len(files.failed) > FEW:
        failed.append(f"failed: {len(files.failed) - FEW:,} more (view known_failures)")
    kinds = {"new": files.new, "changed": files.changed, "gone": files.gone}
    kinds |= {"accepted, since they failed before": tuple(one.file for one in files.accepted)}
    return [
        f"{counted(len(paths), 'file')} {kind}: {name_list(paths)}" for kind, paths in kinds.items() if paths
    ] + failed


def _files(outcome: Outcome) -> dict[str, object]:
    """Return the source files of a run as a JSON object."""
    files = outcome.files
    failures = {
        kind: [{"file": one.file, "reason": one.reason} for one in some]
        for kind, some in (("failed", files.failed), ("accepted", files.accepted))
    }
    return {"new": files.new, "changed": files.changed, "gone": files.gone, **failures}
