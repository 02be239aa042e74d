"""Define the commands about motion templates: rank, template list, show, diff, from-clip."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from kinedex.commands.app import ASK, SEARCH, command, group
from kinedex.commands.options import (
    AtOption,
    JsonOption,
    KindOption,
    Output,
    StageOption,
    StartArgument,
    StopArgument,
    StorePath,
    WhereOption,
    open_for_reading,
)
from kinedex.commands.output import print_json, print_message, print_path, show_table
from kinedex.commands.pages import HitsOutput, Pages
from kinedex.ops.errors import KinedexError
from kinedex.ops.intervals import Hit, Interval
from kinedex.ops.wording import visible

if TYPE_CHECKING:
    from kinedex.catalog.queries.keyframe_query import KeyframeQuery
    from kinedex.ops.templates.templates import Kind
    from kinedex.pipelines.templates.store_ranking import RankingQuestion, StoreRanking
    from kinedex.storage.store.store import Store


template = group("template", "Show, compare and make motion templates.", ASK)

EXAMPLE = "example"
"""The name of the template of several examples."""

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
LikeOption = Annotated[
    list[str] | None,
    typer.Option("--like", metavar="INTERVAL", help="Rank by an example, 'TAKE[45:90]'; several show one motion."),
]
UnlikeOption = Annotated[
    list[str] | None,
    typer.Option("--unlike", metavar="INTERVAL", help="An interval that does not show the motion of the examples."),
]
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
    like: LikeOption = None,
    unlike: UnlikeOption = None,
    top: Annotated[int, typer.Option(min=1, help="Largest number of hits of a template.")] = 20,
    tau: Annotated[
        float | None,
        typer.Option(min=1e-6, max=1, help="Threshold: distances below it are hits; 0.1, or 0.5 by example."),
    ] = None,
    delta: DeltaOption = 0.1,
    kind: KindOption = "soft",
    stage: StageOption = None,
    queries: QueriesOption = None,
    where: WhereOption = None,
    mirror: MirrorOption = False,
    workers: Annotated[int | None, typer.Option(min=1, help="Threads; one per core unless given.")] = None,
    *,
    output: HitsOutput,
    at: AtOption = None,
    as_json: JsonOption = False,
) -> None:
    """Rank the intervals of an archive by templates, or by an example."""
    from kinedex.pipelines.templates.store_ranking import EXAMPLE_TAU, TAU, RankingQuestion, rank_store

    names = list(dict.fromkeys(templates or ()))
    _check_source(names, every, take, like, (start, stop), unlike)
    output.check()
    opened = open_for_reading(store, at)
    asked = None if queries is None else _read_queries(queries, opened)
    begin = time.perf_counter()
    examples = _examples(opened, take, start, stop, like or ())
    tau = tau or (EXAMPLE_TAU if examples else TAU)
    question = RankingQuestion(delta, tau, top, where, mirror, min(top, NEAREST), workers)
    if examples:
        found = _by_examples(opened, take or EXAMPLE, examples, unlike or (), question, asked)
    else:
        found = rank_store(opened, None if every else names, question, queries=asked, kind=_kind_of(kind), stage=stage)
    seconds = time.perf_counter() - begin
    output.write_ranking(opened, found, examples[0].interval if examples else None, tau, kind, stage)
    if as_json:
        document = {"store": store, "templates": [one.name for one in found.rankings], "tau": tau, "delta": delta}
        document |= {"frames": found.rankings[0].frames, "seconds": seconds, "remarks": found.remarks}
        hits, near = (rows.drop_columns(["run"]) for rows in (found.table(), found.nearest_table()))
        print_json({**document, "hits": hits, "nearest": near})
        return
    for remark in (*found.remarks, *found.misses(tau)):
        typer.echo(remark, err=True)
    if output.is_plain:
        _show_hits(found, tau, _summary(found, tau, top, queries is not None, seconds))
    elif not output.picture:
        output.show(found.table())
    if output.output is not None:
        print_path(output.output)
    output.report()


def _read_queries(file: str, store: Store) -> list[KeyframeQuery]:
    """Return the queries of a file."""
    from kinedex.catalog.queries.query_reader import read_queries

    return list(read_queries(file, store.feature_set, store.rate_hz))


def _examples(store: Store, take: str | None, start: str | None, stop: str | None, like: Sequence[str]) -> list[Hit]:
    """Return the intervals of the options --take and --like; none if templates are asked for."""
    from kinedex.pipelines.templates.stored_templates import clip_range

    examples = [] if take is None else [Hit(Interval(take, *clip_range(store, take, start, stop)))]
    if like:
        from kinedex.pipelines.templates.chosen_intervals import hit_of

        examples += [hit_of(one, store) for one in like]
    return examples


def _by_examples(
    store: Store,
    name: str,
    examples: Sequence[Hit],
    unlike: Sequence[str],
    question: RankingQuestion,
    queries: Sequence[KeyframeQuery] | None,
) -> StoreRanking:
    """Return the ranking by examples, with the remarks on their template."""
    from kinedex.pipelines.templates.example_ranking import rank_by_examples

    if len(examples) == 1 and not unlike and not examples[0].mirrored:
        from kinedex.pipelines.templates.stored_templates import template_from_clip

        return rank_by_examples(
            store, template_from_clip(store, *examples[0].interval), examples, question, (), queries
        )
    from kinedex.pipelines.templates.chosen_intervals import hit_of, template_of_chosen

    rejected = [hit_of(one, store) for one in unlike]
    made = template_of_chosen(store, name, examples, rejected, question.delta)
    found = rank_by_examples(store, made.named, examples, question, rejected, queries)
    return replace(found, remarks=(*made.remarks, *found.remarks))


def _show_hits(found: StoreRanking, tau: float, summary: str) -> None:
    """Print the hits, or the nearest intervals if there is no hit, as a table with a summary line below."""
    table = found.table()
    if not table.num_rows and found.nearest_table().num_rows:
        print_message(f"No hit below {tau:g}; the nearest places, which are none:")
        table = found.nearest_table()
    show_table(table.drop_columns(["run", "take_id"] if len(found.rankings) > 1 else ["run", "template", "take_id"]))
    print_message(summary)


def _check_source(
    names: list[str],
    every: bool,
    take: str | None,
    like: list[str] | None,
    frames: tuple[str | None, str | None],
    unlike: list[str] | None,
) -> None:
    """Raise an error unless exactly one source of templates is given, with options that belong to it."""
    by_example = take is not None or like
    given = (("TEMPLATE", names), ("--all", every), ("--like" if take is None else "--take", by_example))
    sources = [text for text, present in given if present]
    if len(sources) > 1:
        raise KinedexError(
            f"{' and '.join(sources)} exclude each other: rank by the names of templates, by --all, or by an example"
        )
    if not sources:
        raise KinedexError("rank by the names of TEMPLATES, by --all, or by an example: --take NAME --start … --stop …")
    if take is None and frames != (None, None):
        raise KinedexError("--start and --stop need --take: they are the interval of the example in a take")
    if unlike and not by_example:
        raise KinedexError("--unlike needs an example: --take NAME --start … --stop …, or --like 'NAME[45:90]'")


def _summary(found: StoreRanking, tau: float, top: int, preselected: bool, seconds: float) -> str:
    """Return the line below the table, with hits, frames, the fractions that were not searched, and the time.

    If a template has as many hits as were requested, the line adds that there may be more.
    """
    from kinedex.ops.wording import counted

    rankings = found.rankings
    kept = sum(one.searched for one in rankings) / max(sum(one.frames for one in rankings), 1)
    shares = [one.skipped for one in rankings if one.skipped is not None]
    limited = any(len(one) == top for one in rankings)
    probable = sum(one.hits.column("probable").to_pylist().count(True) for one in rankings) if found.compared else 0
    hits = counted(sum(len(one) for one in rankings), "best hit" if limited else "hit")
    return (
        f"{hits} below {tau:g}"
        + (f", as --top {top} asks for" if limited else "")
        + (f", {probable} of them probable" if found.compared else "")
        + (f" by {len(rankings)} templates" if len(rankings) > 1 else "")
        + f"; {rankings[0].frames:,} frames"
        + (f", {kept:.1%} of them within keyframe hits" if preselected else "")
        + (f", {sum(shares) / len(shares):.0%} skipped as provably without one" if shares else "")
        + f"; {seconds:.2f} s"
    )


OnOffOption = Annotated[
    float, typer.Option("--delta", min=0, max=0.4999, help="Values within δ of 0 or 1 count as off and on.")
]
ClassArgument = Annotated[str, typer.Argument(metavar="CLASS", help="Class (subclass) of the template.")]


@command(of=template, name="list")
def list_(
    store: StorePath,
    delta: OnOffOption = 0.05,
    stage: StageOption = None,
    *,
    output: Output,
    at: AtOption = None,
    as_json: JsonOption = False,
) -> None:
    """List the templates of a store."""
    from kinedex.pipelines.templates.stored_templates import stored_templates, templates_overview

    opened = open_for_reading(store, at)
    table = templates_overview(opened, delta, stage)
    if as_json:
        print_json({"store": store, "templates": table})
        return
    one_stage = len(set(table.column("stage").to_pylist())) == 1
    hidden = ["stage", "remarks"] if one_stage else ["remarks"]
    output.show(table.drop_columns(hidden) if output.is_plain else table)
    if output.is_plain:
        remarks = {
            (each.one.subclass, remark): None for each in stored_templates(opened, stage) for remark in each.one.remarks
        }
        for subclass, remark in remarks:
            print_message(f"! {subclass}: {remark}")


@command(of=template)
def show(
    store: StorePath,
    name: ClassArgument,
    kind: KindOption = "soft",
    delta: OnOffOption = 0.05,
    stage: StageOption = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Figure to write (.svg, .png), or template file to edit (.yaml, .csv)."),
    ] = None,
    *,
    pages: Pages,
    at: AtOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show a template: every feature over time.

    The page names the origin of the template, and how much the clips agree about each feature.
    """
    from kinedex.console.terminal import make_console
    from kinedex.ops.templates.templates import NamedTemplate
    from kinedex.pipelines.templates.stored_templates import choose_template, write_template
    from kinedex.reports.matrix_pictures import template_picture, write_matrices
    from kinedex.reports.template_text import template_heading, template_lines

    pages.check()
    opened = open_for_reading(store, at)
    one = choose_template(opened, name, _kind_of(kind), stage)
    if output is None and not as_json:
        console = make_console()
        for line in template_lines(one, opened.feature_set, delta, opened.rate_hz, console.width):
            console.print(visible(line), markup=False)
    elif output is not None and output.suffix.lower() in (".yaml", ".yml", ".csv"):
        write_template(
            NamedTemplate(name, one.learned.template, template_heading(one, opened.rate_hz)), opened.feature_set, output
        )
    elif output is not None:
        note = template_heading(one, opened.rate_hz).split(": ", 1)[1]
        figure = template_picture(one.learned.template, name, note, delta, opened.feature_set, opened.rate_hz)
        write_matrices(figure, output)
    if output is not None and not as_json:
        print_path(output)
    pages.write_template(opened, one, delta)
    pages.report()
    if as_json:
        features = [feature.name for feature in opened.feature_set.features]
        values = one.learned.template.values.round(6).tolist()
        about = {"class": name, "kind": kind, "about": template_heading(one, opened.rate_hz), "features": features}
        print_json({"store": store, **about, "values": values, "file": output})


@command(of=template)
def diff(
    store: StorePath,
    first: Annotated[str, typer.Argument(metavar="CLASS", help="First class.")],
    second: Annotated[str, typer.Argument(metavar="CLASS", help="Second class.")],
    kind: KindOption = "soft",
    delta: OnOffOption = 0.05,
    stage: StageOption = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Figure to write (.svg, .png); text unless given."),
    ] = None,
    at: AtOption = None,
    as_json: JsonOption = False,
) -> None:
    """List the features in which two templates contradict each other."""
    from kinedex.console.terminal import make_console
    from kinedex.ops.templates.derived_templates import contrast
    from kinedex.pipelines.templates.stored_templates import choose_template
    from kinedex.reports.matrix_pictures import contrast_picture, write_matrices
    from kinedex.reports.template_text import contrast_lines

    opened = open_for_reading(store, at)
    names = (first, second)
    one, other = (choose_template(opened, name, _kind_of(kind), stage).learned.template for name in names)
    found = contrast(one, other, delta)
    lines = list(contrast_lines(names, found, opened.feature_set, opened.rate_hz))
    if output is not None:
        about = (names, found, delta, lines[0], opened.feature_set, opened.rate_hz)
        write_matrices(contrast_picture(one, other, *about), output)
    if as_json:
        print_json({"store": store, "classes": names, "kind": kind, "delta": delta, "lines": lines, "file": output})
    elif output is not None:
        print_path(output)
    else:
        console = make_console()
        for line in lines:
            console.print(visible(line), markup=False)


@command(of=template, name="from-clip")
def from_clip(
    store: StorePath,
    take: Annotated[str, typer.Argument(help="Name of the take.")],
    start: StartArgument = None,
    stop: StopArgument = None,
    name: Annotated[str, typer.Option("--name", help="Name of the template; that of the take unless given.")] = "",
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="File to write (.yaml, .csv); standard output unless given.")
    ] = None,
    at: AtOption = None,
    as_json: JsonOption = False,
) -> None:
    """Make a template from an example, a take or an interval. `learn_templates.template_files` reads the file."""
    from kinedex.catalog.template_files import write_yaml
    from kinedex.pipelines.templates.stored_templates import template_from_clip, write_template

    opened = open_for_reading(store, at)
    made = template_from_clip(opened, take, start, stop, name or take)
    if output is not None:
        write_template(made, opened.feature_set, output)
    text = write_yaml([made], opened.feature_set)
    if as_json:
        print_json({"store": store, "name": made.name, "yaml": text, "file": output})
    elif output is not None:
        print_path(output)
    else:
        print(text, end="")


def _kind_of(text: str) -> Kind:
    """Return the kind of template that an option names."""
    if text not in ("soft", "hard"):
        raise KinedexError(f"--kind {text}: expected soft or hard")
    return cast("Kind", text)
