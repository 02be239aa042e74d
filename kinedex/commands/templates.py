"""Commands about motion templates: template list, show, diff, from-clip."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from kinedex.commands.app import ASK, command, group
from kinedex.commands.options import (
    FIGURES,
    AtOption,
    FiguresOption,
    FormatOption,
    HtmlOption,
    JsonOption,
    KindOption,
    OutputOption,
    StageOption,
    StorePath,
)
from kinedex.commands.output import print_json, print_message, print_path, show_table
from kinedex.commands.pages import Pages
from kinedex.commands.store_access import open_for_reading
from kinedex.ops.errors import KinedexError
from kinedex.ops.wording import visible

if TYPE_CHECKING:
    import pyarrow as pa

    from kinedex.ops.templates.templates import Kind

template = group("template", "Show, compare and make motion templates.", ASK)

DeltaOption = Annotated[
    float, typer.Option("--delta", min=0, max=0.4999, help="Values within δ of 0 or 1 count as off and on.")
]
ClassArgument = Annotated[str, typer.Argument(metavar="CLASS", help="Class (subclass) of the template.")]


@command(of=template, name="list")
def list_(
    store: StorePath,
    delta: DeltaOption = 0.05,
    stage: StageOption = None,
    form: FormatOption = "table",
    output: OutputOption = None,
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
    plain = form == "table" and output is None
    show_table(
        table.drop_columns(["stage", "remarks"] if one_stage(table) else ["remarks"]) if plain else table, form, output
    )
    if plain:
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
    delta: DeltaOption = 0.05,
    stage: StageOption = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Figure to write (.svg, .png), or template file to edit (.yaml, .csv)."),
    ] = None,
    html: HtmlOption = None,
    figures: FiguresOption = FIGURES,
    at: AtOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show a template: every feature over time.

    The page names the origin of the template, and how much the clips agree about each feature.
    """
    from kinedex.console.terminal import make_console
    from kinedex.ops.templates.templates import NamedTemplate
    from kinedex.pipelines.templates.stored_templates import choose_template, write_template
    from kinedex.pipelines.templates.template_text import heading, template_lines
    from kinedex.reports.matrix_figures import write_figure
    from kinedex.reports.template_figures import template_figure

    pages = Pages(html, None, figures)
    opened = open_for_reading(store, at)
    one = choose_template(opened, name, kind_of(kind), stage)
    if output is None and not as_json:
        console = make_console()
        for line in template_lines(one, opened.feature_set, delta, opened.rate_hz, console.width):
            console.print(visible(line), markup=False)
    elif output is not None and output.suffix.lower() in (".yaml", ".yml", ".csv"):
        write_template(
            NamedTemplate(name, one.learned.template, heading(one, opened.rate_hz)), opened.feature_set, output
        )
    elif output is not None:
        note = heading(one, opened.rate_hz).split(": ", 1)[1]
        figure = template_figure(one.learned.template, name, note, delta, opened.feature_set, opened.rate_hz)
        write_figure(figure, output)
    if output is not None and not as_json:
        print_path(output)
    pages.write_template(opened, one, delta)
    pages.report()
    if as_json:
        features = [feature.name for feature in opened.feature_set.features]
        values = one.learned.template.values.round(6).tolist()
        about = {"class": name, "kind": kind, "about": heading(one, opened.rate_hz), "features": features}
        print_json({"store": store, **about, "values": values, "file": output})


@command(of=template)
def diff(
    store: StorePath,
    first: Annotated[str, typer.Argument(metavar="CLASS", help="First class.")],
    second: Annotated[str, typer.Argument(metavar="CLASS", help="Second class.")],
    kind: KindOption = "soft",
    delta: DeltaOption = 0.05,
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
    from kinedex.pipelines.templates.template_text import contrast_lines
    from kinedex.reports.matrix_figures import write_figure
    from kinedex.reports.template_figures import contrast_figure

    opened = open_for_reading(store, at)
    names = (first, second)
    one, other = (choose_template(opened, name, kind_of(kind), stage).learned.template for name in names)
    found = contrast(one, other, delta)
    lines = list(contrast_lines(names, found, opened.feature_set, opened.rate_hz))
    if output is not None:
        about = (names, found, delta, lines[0], opened.feature_set, opened.rate_hz)
        write_figure(contrast_figure(one, other, *about), output)
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
    start: Annotated[
        str | None, typer.Argument(help="First frame (45) or seconds (1.5s); else the take's first.")
    ] = None,
    stop: Annotated[str | None, typer.Argument(help="Frame after the last, or seconds; else the end.")] = None,
    name: Annotated[str, typer.Option("--name", help="Name of the template; that of the take unless given.")] = "",
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="File to write (.yaml, .csv); standard output unless given.")
    ] = None,
    at: AtOption = None,
    as_json: JsonOption = False,
) -> None:
    """Make a template from one example: a take or an interval of it. `learn_templates.template_files` reads it."""
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


def one_stage(table: pa.Table) -> bool:
    """Return whether all templates of an overview are of one stage, so that the column can be omitted."""
    return len(set(table.column("stage").to_pylist())) == 1


def kind_of(text: str) -> Kind:
    """Return the kind of template that an option names."""
    if text not in ("soft", "hard"):
        raise KinedexError(f"--kind {text}: expected soft or hard")
    return cast("Kind", text)
