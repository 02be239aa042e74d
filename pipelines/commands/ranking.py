"""The command `kinedex rank`: where a template, or an example, fits best."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinedex.ops.errors import KinedexError
from kinedex.pipelines.commands.shell import Format, Output, StorePath, Where, command, show_table
from kinedex.pipelines.console.terminal import make_console
from kinedex.pipelines.console.wording import counted, few

if TYPE_CHECKING:
    from kinedex.catalog.queries.queries import KeyframeQuery
    from kinedex.ops.templates.templates import Kind, Template
    from kinedex.pipelines.ranking.ranking import Searched
    from kinedex.storage.store.store import Store


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
    from kinedex.pipelines.commands.templates import kind_of
    from kinedex.pipelines.ranking.ranking import rank_store, ranking_table
    from kinedex.pipelines.templates.templates import template_from_clip
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
    if take is not None:
        wanted = {take: template_from_clip(opened, take, start, stop, take).template}
    else:
        wanted = _templates(opened, None if every else names, kind_of(kind), stage)
    searched = _searched(opened, wanted, delta, queries, every)
    begin = time.perf_counter()
    rankings = rank_store(opened, searched, tau, top, where, workers)
    seconds = time.perf_counter() - begin
    table = ranking_table(rankings, opened.rate_hz)
    plain = form == "table" and output is None
    unsaid = ["run", "take_id"] if len(searched) > 1 else ["run", "template", "take_id"]
    show_table(table.drop_columns(unsaid) if plain else table, form, output)
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


def _templates(store: Store, names: list[str] | None, kind: Kind, stage: str | None) -> dict[str, Template]:
    """Templates by name: learned ones and those of files, or all learned ones."""
    from kinedex.pipelines.commands.templates import template_of_file
    from kinedex.pipelines.templates.templates import choose_template, stored_templates

    if names is None:
        names = [each.one.subclass for each in stored_templates(store, stage) if each.one.kind == kind]
        if not names:
            raise KinedexError(f"{store.path} has no {kind} templates" + (f" of stage {stage}" if stage else ""))
    found = {}
    for name in dict.fromkeys(names):
        if name.endswith((".yaml", ".yml", ".csv")):
            made = template_of_file(Path(name), store.feature_set)
            if made.name in found:
                raise KinedexError(f"{name}: there is a template '{made.name}' already; give it another name")
            found[made.name] = made.template
        else:
            found[name] = choose_template(store, name, kind, stage).learned.template
    return found


def _searched(
    store: Store, wanted: dict[str, Template], delta: float, queries: str | None, lenient: bool
) -> list[Searched]:
    """What to rank by: templates quantised, each with its queries.

    Templates without a query, where others have one, are ranked in all frames, as by the stage `rank`; that is said.
    lenient: templates of wildcards alone are left out, and that is said; else there must be none.
    """
    from kinedex.catalog.queries.query_files import read_queries
    from kinedex.ops.templates.templates import quantise
    from kinedex.pipelines.ranking.ranking import Searched

    loaded = [] if queries is None else read_queries(queries, store.feature_set, store.rate_hz)
    searched: list[Searched] = []
    unasked = []
    for name, template in wanted.items():
        quantised = quantise(template, delta)
        if not quantised.fixed and lenient and len(wanted) > 1:
            typer.echo(f"left out, wildcards alone at --delta {delta:g}: {name}", err=True)
            continue
        if not quantised.fixed:
            raise KinedexError(f"at --delta {delta:g} the template '{name}' is wildcards alone and would fit anything")
        chosen: tuple[KeyframeQuery, ...] = tuple(query for query in loaded if query.target == name)
        if queries is not None and not chosen:
            unasked.append(name)
        searched.append(Searched(name, quantised, chosen))
    if not searched:
        raise KinedexError(f"at --delta {delta:g} all templates are wildcards alone and would fit anything")
    if queries is not None and len(unasked) == len(searched):
        targets = ", ".join(sorted({query.target for query in loaded}))
        raise KinedexError(f"{queries} has no query for {few(unasked)}; its queries are for: {targets}")
    if unasked:
        typer.echo(f"no query in {queries}, so ranked in all frames: {few(unasked)}", err=True)
    return searched
