"""The command `kinedex rank`: where a template, or an example, fits best."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ops.errors import KinedexError
from pipelines.commands.shell import Format, Output, StorePath, Where, command, show_table
from pipelines.terminal import make_console

if TYPE_CHECKING:
    from catalog.queries import KeyframeQuery


@command
def rank(
    store: StorePath,
    template: Annotated[
        str | None,
        typer.Argument(metavar="[TEMPLATE]", help="class of a learned template, or a template file (.yaml, .csv)"),
    ] = None,
    take: Annotated[str | None, typer.Option(help="query by example: a take, or the stretch of it to look for")] = None,
    start: Annotated[str | None, typer.Option(help="first frame of the example, or seconds (1.5s)")] = None,
    stop: Annotated[str | None, typer.Option(help="the frame after its last, or seconds")] = None,
    top: Annotated[int, typer.Option(min=1, help="how many hits at most")] = 20,
    tau: Annotated[float, typer.Option(min=1e-6, max=1, help="distances below tau make a hit")] = 0.1,
    delta: Annotated[
        float,
        typer.Option(min=0, max=0.4999, help="template values within delta of 0 or 1 count, others are wildcards"),
    ] = 0.1,
    kind: Annotated[str, typer.Option("--kind", help="soft or hard template")] = "soft",
    queries: Annotated[
        str | None, typer.Option(metavar="FILE", help="only within the hits of this query file's queries for TEMPLATE")
    ] = None,
    where: Where = None,
    workers: Annotated[int | None, typer.Option(min=1, help="threads; all cores unless given")] = None,
    form: Format = "table",
    output: Output = None,
) -> None:
    """Rank the places of an archive by how well a template fits them, the best first."""
    from catalog.queryfiles import read_queries
    from ops.templates.templates import quantise
    from pipelines.commands.templates import kind_of, template_of_file
    from pipelines.retrieval.ranking import Searched, rank_store, ranking_table
    from pipelines.templates.templates import choose_template, template_from_clip
    from storage.store import open_store

    opened = open_store(store)
    if (template is None) == (take is None):
        raise KinedexError("rank by the name of a TEMPLATE, or by an example: --take NAME --start … --stop …")
    if take is None and (start is not None or stop is not None):
        raise KinedexError("--start and --stop say which stretch of --take is the example")
    if take is not None:
        learned, name = template_from_clip(opened, take, start, stop, take).template, take
    else:
        assert template is not None
        if template.endswith((".yaml", ".yml", ".csv")):
            made = template_of_file(Path(template), opened.feature_set)
            learned, name = made.template, made.name
        else:
            learned, name = choose_template(opened, template, kind_of(kind)).learned.template, template
    quantised = quantise(learned, delta)
    if not quantised.fixed:
        raise KinedexError(f"at --delta {delta:g} the template is wildcards alone and would fit anything")
    chosen: tuple[KeyframeQuery, ...] = ()
    if queries is not None:
        loaded = read_queries(queries, opened.feature_set, opened.rate_hz)
        chosen = tuple(query for query in loaded if query.target == name)
        if not chosen:
            targets = ", ".join(sorted({query.target for query in loaded}))
            raise KinedexError(f"{queries} has no query for '{name}'; its queries are for: {targets}")
    begin = time.perf_counter()
    (ranking,) = rank_store(opened, [Searched(name, quantised, chosen)], tau, top, where, workers)
    seconds = time.perf_counter() - begin
    table = ranking_table([ranking], opened.rate_hz)
    plain = form == "table" and output is None
    show_table(table.drop_columns(["run", "template", "take_id"]) if plain else table, form, output)
    if plain:
        kept = f", {ranking.kept:.1%} of them within keyframe hits" if chosen else ""
        make_console().print(
            f"{len(ranking.hits)} hits below {tau:g}; {ranking.frames:,} frames{kept}, {ranking.skipped:.0%} skipped "
            f"as provably without a hit; {seconds:.2f} s",
            markup=False,
        )
