"""Command that drafts a pipeline for a folder of files: init."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinedex.commands.app import RUN, command
from kinedex.commands.options import JsonOption
from kinedex.commands.output import print_json, print_message, print_path
from kinedex.ops.errors import KinedexError

if TYPE_CHECKING:
    from kinedex.pipelines.ingestion.pattern_proposal import Proposal


@command(RUN)
def init(
    source: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of motion files.")],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FILE", help="Pipeline to write (.yaml); none unless given."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Write over an existing file.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Propose patterns for the names of motion files, as a pipeline.

    The names are divided into tokens; a table shows the values of each, and whether they look like actors, classes,
    numbers or styles. `kinedex run FILE --store STORE` then runs the pipeline as it is.
    """
    from kinedex.pipelines.ingestion.pattern_proposal import matched, propose
    from kinedex.pipelines.ingestion.pipeline_draft import draft
    from kinedex.storage.disk import whole_file, write_errors
    from kinedex.storage.formats.motion.sources import scan

    if output is not None and output.suffix not in (".yaml", ".yml"):
        raise KinedexError(f"--output {output}: expected a name with the ending .yaml")
    if output is not None and output.exists() and not force:
        raise KinedexError(f"{output}: exists already; give another --output, or --force to write over it")
    found = scan(source)
    if not found.motions:
        raise KinedexError(f"no motion files below {source}; is this the right folder?")
    paths = [motion.path for motion in found.motions]
    proposals = propose(paths)
    fitting = matched(proposals, paths)
    root = Path(found.motions[0].root)
    if as_json:
        patterns = [{"pattern": one.pattern, "paths": len(one.layout.paths)} for one in proposals]
        print_json({"source": source, "patterns": patterns, "paths": len(paths), "matched": fitting, "file": output})
    else:
        _print(proposals, fitting, len(paths))
    if output is None:
        again = shlex.join(["kinedex", "init", str(source), "-o", "my.yaml"])
        print_message(f"nothing was written; {again} writes a pipeline")
        return
    text = draft(proposals, root, len(paths), fitting, shlex.quote(str(output)))
    with write_errors(output), whole_file(output) as path:
        path.write_text(text, encoding="utf-8")
    if not as_json:
        print_path(output)


def _print(proposals: list[Proposal], fitting: int, count: int) -> None:
    """Print a table of the tokens of each pattern."""
    from rich import box
    from rich.table import Table

    from kinedex.console.tables import plain_text
    from kinedex.console.terminal import make_console
    from kinedex.ops.wording import counted
    from kinedex.pipelines.ingestion.pipeline_draft import value_counts

    console = make_console()
    for proposal in proposals:
        console.print(f"{counted(len(proposal.layout.paths), 'path')}: {proposal.pattern}", markup=False)
        table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
        for column in ("token", "column", "looks like", "values", "most frequent"):
            table.add_column(column)
        for number, token in enumerate(proposal.tokens, 1):
            kind = f"{number} (folder)" if token.column.folder else str(number)
            cells = (kind, token.role or "–", token.why, f"{len(token.column.counts):,}", value_counts(token, 6))
            table.add_row(*map(plain_text, cells))
        console.print(table)
    rest = "" if proposals else ": their names have nothing in common"
    console.print(f"{fitting:,} of {counted(count, 'path')} match{rest}", markup=False)
