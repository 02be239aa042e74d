"""Commands about reports: report compare."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from kinedex.ops.errors import KinedexError
from kinedex.pipelines.commands.shell import app, guard
from kinedex.pipelines.console.terminal import make_console

report = typer.Typer(name="report", help="Compare evaluations.", no_args_is_help=True)
app.add_typer(report, rich_help_panel="Run pipelines")

FORMATS = (".md", ".html", ".json")
RunArgument = Annotated[
    str, typer.Argument(help="a store, a folder of its reports, or a JSON file of them; ::METHOD chooses a method")
]


@report.callback()
def _group() -> None:
    """Compare evaluations."""


@report.command("compare")
@guard
def compare(
    a: RunArgument,
    b: RunArgument,
    split: Annotated[str | None, typer.Option(help="only this split of evaluations of several methods")] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="write to this file: .md, .html or .json")
    ] = None,
) -> None:
    """What got better and what got worse from A to B: in all, class by class and take by take.

    Two methods of one evaluation: kinedex report compare STORE::thesis STORE::best
    """
    import json

    from kinedex.pipelines.evaluation.difference_tables import markdown, page, rich_comparison
    from kinedex.pipelines.evaluation.differences import compared, content, without_repeats
    from kinedex.pipelines.evaluation.written_evaluations import pairs, read_run
    from kinedex.pipelines.report.output import write_page

    if output is not None and output.suffix not in FORMATS:
        raise KinedexError(f"--output {output}: must end in {', '.join(FORMATS)}")
    found = pairs(read_run(a), read_run(b), split)
    comparisons = without_repeats([compared(one, other, _names(a, b, one.name, other.name)) for one, other in found])
    if output is None:
        for one in comparisons:
            make_console().print(rich_comparison(one))
        return
    if output.suffix == ".json":
        text = json.dumps(content(comparisons), indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    else:
        text = page(comparisons) if output.suffix == ".html" else markdown(comparisons)
    write_page(text, output)


def _names(a: str, b: str, one: str, other: str) -> tuple[str, str]:
    """What A and B are called: by what they are where that differs, by where they are where it does not."""
    if one != other:
        return one, other
    return f"{one} ({a})", f"{other} ({b})"
