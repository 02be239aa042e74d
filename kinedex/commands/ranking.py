"""The command `rank`, which lists where templates or an example fit best."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from kinedex.commands.app import SEARCH, command
from kinedex.commands.options import (
    FIGURES,
    AtOption,
    FiguresOption,
    FormatOption,
    HitsOutputOption,
    HtmlOption,
    JsonOption,
    KindOption,
    StageOption,
    StorePath,
    WhereOption,
)
from kinedex.commands.output import print_json, print_message, print_path, show_table
from kinedex.commands.pages import Pages
from kinedex.commands.store_access import open_for_reading
from kinedex.ops.errors import KinedexError

if TYPE_CHECKING:
    from kinedex.catalog.queries.keyframe_query import KeyframeQuery
    from kinedex.pipelines.ranking.ranked_hits import Ranking
    from kinedex.pipelines.ranking.store_ranking import StoreRanking
    from kinedex.storage.store.store import Store


NEAREST = 5
"""Number of nearest intervals that are shown for a template without a hit."""

TemplatesArgument = Annotated[
    list[str] | None,
    typer.Argument(metavar="[TEMPLATE...]", help="Classes of learned templates, or template files (.yaml, .csv)."),
]
DeltaOption = Annotated[
    float, typer.Option(min=0, max=0.4999, help="Template values within δ of 0 or 1 count, others are wildcards.")
]
ExampleOption = Annotated[str | None, typer.Option(help="Rank by an example: a take, or an interval of it.")]
QueriesOption = Annotated[
    str | None,
    typer.Option(
        metavar="FILE",
        help="Query file; a template is ranked within the hits of its queries, in all frames where it has none.",
    ),
]

MirrorOption = Annotated[
    bool, typer.Option("--mirror", help="Rank by mirror images, too; their hits have true in the column mirrored.")
]


@command(SEARCH)
def rank(
    store: StorePath,
    templates: TemplatesArgument = None,
    every: Annotated[bool, typer.Option("--all", help="Rank by all learned templates of the store.")] = False,
    take: ExampleOption = None,
    start: Annotated[str | None, typer.Option(help="First frame of the example (45), or seconds (1.5s).")] = None,
    stop: Annotated[str | None, typer.Option(help="Frame after its last, or seconds.")] = None,
    top: Annotated[int, typer.Option(min=1, help="Largest number of hits of a template.")] = 20,
    tau: Annotated[float, typer.Option(min=1e-6, max=1, help="Threshold: distances below it are hits.")] = 0.1,
    delta: DeltaOption = 0.1,
    kind: KindOption = "soft",
    stage: StageOption = None,
    queries: QueriesOption = None,
    where: WhereOption = None,
    mirror: MirrorOption = False,
    workers: Annotated[int | None, typer.Option(min=1, help="Threads; one per core unless given.")] = None,
    form: FormatOption = "table",
    output: HitsOutputOption = None,
    html: HtmlOption = None,
    figures: FiguresOption = FIGURES,
    at: AtOption = None,
    as_json: JsonOption = False,
) -> None:
    """Rank the places of an archive by how well templates fit."""
    from kinedex.commands.templates import kind_of
    from kinedex.pipelines.ranking.store_ranking import RankingQuestion, rank_store
    from kinedex.pipelines.templates.stored_templates import template_from_clip

    names = list(dict.fromkeys(templates or ()))
    _check_source(names, every, take, start, stop)
    pages = Pages(html, output, figures)
    opened = open_for_reading(store, at)
    asked = None if queries is None else _read_queries(queries, opened)
    chosen = None if every else names if take is None else [template_from_clip(opened, take, start, stop)]
    begin = time.perf_counter()
    question = RankingQuestion(delta, tau, top, where, mirror, min(top, NEAREST), workers)
    found = rank_store(opened, chosen, question, queries=asked, kind=kind_of(kind), stage=stage)
    seconds = time.perf_counter() - begin
    pages.write_ranking(opened, found, _interval(opened, take, start, stop), tau, kind, stage)
    if as_json:
        document = {"store": store, "templates": [one.name for one in found.rankings], "tau": tau, "delta": delta}
        document |= {"frames": found.rankings[0].frames, "seconds": seconds, "remarks": found.remarks}
        hits, near = (rows.drop_columns(["run"]) for rows in (found.table(), found.nearest_table()))
        print_json({**document, "hits": hits, "nearest": near})
        return
    for remark in (*found.remarks, *found.misses(tau)):
        typer.echo(remark, err=True)
    if form == "table" and output is None:
        _show_hits(found, tau, _summary(found.rankings, tau, top, queries is not None, seconds))
    elif not pages.picture:
        show_table(found.table(), form, output)
    if output is not None:
        print_path(output)
    pages.report()


def _read_queries(name: str, store: Store) -> tuple[KeyframeQuery, ...]:
    from kinedex.catalog.queries.query_reader import read_queries

    return read_queries(name, store.feature_set, store.rate_hz)


def _show_hits(found: StoreRanking, tau: float, summary: str) -> None:
    """Print the hits, or the nearest intervals if there is no hit, as a table with a line below it."""
    table = found.table()
    if not table.num_rows and found.nearest_table().num_rows:
        print_message(f"No hit below {tau:g}; the nearest places, which are none:")
        table = found.nearest_table()
    show_table(
        table.drop_columns(["run", "take_id"] if len(found.rankings) > 1 else ["run", "template", "take_id"]),
        "table", None,
    )  # fmt: skip
    print_message(summary)


def _interval(store: Store, take: str | None, start: str | None, stop: str | None) -> tuple[str, int, int] | None:
    """Return the example as (take, start, stop) in frames; None if no take is given."""
    from kinedex.pipelines.templates.stored_templates import clip_range

    return None if take is None else (take, *clip_range(store, take, start, stop))


def _check_source(names: list[str], every: bool, take: str | None, start: str | None, stop: str | None) -> None:
    """Raise an error unless exactly one source of templates is given."""
    sources = [text for text, given in (("TEMPLATE", names), ("--all", every), ("--take", take is not None)) if given]
    if len(sources) > 1:
        raise KinedexError(
            f"{' and '.join(sources)} exclude each other: rank by the names of templates, by --all, or by an example"
        )
    if not sources:
        raise KinedexError("rank by the names of TEMPLATES, by --all, or by an example: --take NAME --start … --stop …")
    if take is None and (start is not None or stop is not None):
        raise KinedexError("--start and --stop need --take: they are the interval of the example in a take")


def _summary(rankings: Sequence[Ranking], tau: float, top: int, preselected: bool, seconds: float) -> str:
    """Return the line below the table: hits, frames, the shares that were not searched, and the time.

    If a template has as many hits as were asked for, the line adds that there may be more.
    """
    from kinedex.ops.wording import counted

    kept = sum(one.searched for one in rankings) / max(sum(one.frames for one in rankings), 1)
    shares = [one.skipped for one in rankings if one.skipped is not None]
    limited = any(len(one) == top for one in rankings)
    hits = counted(sum(len(one) for one in rankings), "best hit" if limited else "hit")
    return (
        f"{hits} below {tau:g}"
        + (f", as --top {top} asks for" if limited else "")
        + (f" by {len(rankings)} templates" if len(rankings) > 1 else "")
        + f"; {rankings[0].frames:,} frames"
        + (f", {kept:.1%} of them within keyframe hits" if preselected else "")
        + (f", {sum(shares) / len(shares):.0%} skipped as provably without one" if shares else "")
        + f"; {seconds:.2f} s"
    )
