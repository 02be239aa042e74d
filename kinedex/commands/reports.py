"""Commands about reports: report compare."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from kinedex.commands.app import RUN, command, group
from kinedex.commands.options import JsonOption
from kinedex.commands.output import print_json
from kinedex.ops.errors import KinedexError
from kinedex.ops.wording import visible

report = group("report", "Compare evaluations.", RUN)

FORMATS = (".md", ".html", ".json")
EvaluationArgument = Annotated[
    str,
    typer.Argument(help="Store, folder of its reports, or JSON file of them; ::PIPELINE, ::METHOD, or both choose."),
]


@report.callback()
def _group() -> None:
    """Compare evaluations."""


@command(of=report)
def compare(
    a: EvaluationArgument,
    b: EvaluationArgument,
    split: Annotated[str | None, typer.Option(help="Only this split of evaluations of several methods.")] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Write to this file: .md, .html or .json.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """List the classes and takes that improved or got worse from A to B.

    Two methods of one evaluation: kinedex report compare STORE::thesis STORE::best

    A store with evaluations of several pipelines means the current one (`kinedex use`), unless ::PIPELINE is given.
    """
    from kinedex.console.terminal import Terminal, make_console
    from kinedex.pipelines.engine.page_files import write_page
    from kinedex.pipelines.evaluation.differences import compared, comparison_tables, content, markdown, without_repeats
    from kinedex.pipelines.evaluation.written_evaluations import pairs, read_run
    from kinedex.reports.comparison_page import comparison_page
    from kinedex.storage.formats.json_text import json_text

    if output is not None and output.suffix not in FORMATS:
        raise KinedexError(f"--output {output}: must end in {', '.join(FORMATS)}")
    ours, theirs = read_run(a), read_run(b)
    for remark in dict.fromkeys(one.remark for one in (ours, theirs) if one.remark is not None):
        typer.echo(visible(remark), err=True)
    found = pairs(ours, theirs, split)
    comparisons = without_repeats([compared(one, other, _names(a, b, one.name, other.name)) for one, other in found])
    if as_json:
        print_json(content(comparisons))
    elif output is None:
        for one in comparisons:
            Terminal(make_console()).show(*comparison_tables(one))
    if output is not None and output.suffix == ".json":
        write_page(json_text(content(comparisons)), output)
    elif output is not None:
        write_page(comparison_page(comparisons) if output.suffix == ".html" else markdown(comparisons), output)


def _names(a: str, b: str, one: str, other: str) -> tuple[str, str]:
    """Return the names of two evaluations for tables; if they are equal, the command's arguments are appended."""
    if one != other:
        return one, other
    return f"{one} ({a})", f"{other} ({b})"
