"""The command `kinedex rank`: where a template, or an example, fits best."""

from __future__ import annotations

import time
from typing import Annotated

import typer

from kinedex.ops.errors import KinedexError
from kinedex.pipelines.commands.shell import Format, Output, StorePath, Where, command, show_table
from kinedex.pipelines.console.terminal import make_console
from kinedex.pipelines.console.wording import counted


@command
def rank(
    store: StorePath,
    templates: Annotated[
        list[str] | None,
        typer.Argument(metavar="TEMPLATE", help="classes of learned templates, or template files (.yaml, .csv)"),
    ] = None,
    every: Annotated[bool, typer.Option("--all", help="by all learned templates of the store")] = False,
    take: Annotated[str | None, typer.Option(help="query by example: a take, or the stretch of it to look for")] = None,
    start: Annotated[str | None, typer.Option(help="first frame of the example, or seconds (1.5s)")] = None,
    stop: Annotated[str | None, typer.Option(help="the frame after its last, or seconds")] = None,
    top: Annotated[int, typer.Option(min=1, help="how many hits a template at most")] = 20,
    tau: Annotated[float, typer.Option(min=1e-6, max=1, help="distances below tau make a hit")] = 0.1,
    delta: Annotated[
        float,
        typer.Option(min=0, max=0.4999, help="template values within delta of 0 or 1 count, others are wildcards"),
    ] = 0.1,
    kind: Annotated[str, typer.Option("--kind", help="soft or hard template")] = "soft",
    stage: Annotated[
        str | None,
        typer.Option("--stage", metavar="STAGE", help="templates of this stage: PIPELINE/STAGE, or PIPELINE"),
    ] = None,
    queries: Annotated[
        str | None,
        typer.Option(
            metavar="FILE",
            help="only within the hits of this query file's queries for each TEMPLATE; in all frames without one",
        ),
    ] = None,
    where: Where = None,
    workers: Annotated[int | None, typer.Option(min=1, help="threads; all cores unless given")] = None,
    form: Format = "table",
    output: Output = None,
) -> None:
    """Rank the places of an archive by how well templates fit them, the best of each template first."""
    from kinedex.catalog.queries.query_files import read_queries
    from kinedex.pipelines.commands.templates import kind_of
    from kinedex.pipelines.ranking.store_ranking import rank_store
    from kinedex.pipelines.templates.stored_templates import template_from_clip
    from kinedex.storage.store.store import open_store

    opened = open_store(store)
    names = list(dict.fromkeys(templates or ()))
    ways = [said for said, given in (("TEMPLATE", names), ("--all", every), ("--take", take is not None)) if given]
    if len(ways) > 1:
        raise KinedexError(
            f"{' and '.join(ways)} exclude each other: rank by the names of templates, by --all, or by an example"
        )
    if not ways:
        raise KinedexError("rank by the names of TEMPLATES, by --all, or by an example: --take NAME --start … --stop …")
    if take is None and (start is not None or stop is not None):
        raise KinedexError("--start and --stop say which stretch of --take is the example")
    asked = None if queries is None else read_queries(queries, opened.feature_set, opened.rate_hz)
    chosen = None if every else names if take is None else [template_from_clip(opened, take, start, stop)]
    begin = time.perf_counter()
    found = rank_store(
        opened, chosen, queries=asked, kind=kind_of(kind), stage=stage, delta=delta, tau=tau, top=top, where=where,
        workers=workers,
    )  # fmt: skip
    seconds = time.perf_counter() - begin
    for remark in found.remarks:
        typer.echo(remark, err=True)
    rankings, table = found.rankings, found.table()
    plain = form == "table" and output is None
    hidden = ["run", "take_id"] if len(rankings) > 1 else ["run", "template", "take_id"]
    show_table(table.drop_columns(hidden) if plain else table, form, output)
    if output is not None:
        print(output)
    if plain:
        kept = sum(one.searched for one in rankings) / max(sum(one.frames for one in rankings), 1)
        shares = [one.skipped for one in rankings if one.skipped is not None]
        make_console().print(
            f"{counted(table.num_rows, 'hit')} below {tau:g}"
            + (f" by {len(rankings)} templates" if len(rankings) > 1 else "")
            + f"; {rankings[0].frames:,} frames"
            + (f", {kept:.1%} of them within keyframe hits" if queries is not None else "")
            + (f", {sum(shares) / len(shares):.0%} skipped as provably without one" if shares else "")
            + f"; {seconds:.2f} s",
            markup=False,
        )
