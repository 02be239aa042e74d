"""Define the command that explains which class an interval of a take shows."""

from __future__ import annotations

from typing import Annotated

import typer

from kinedex.commands.app import ASK, command
from kinedex.commands.options import (
    AtOption,
    JsonOption,
    Output,
    StartArgument,
    StopArgument,
    StorePath,
    open_for_reading,
)
from kinedex.commands.output import print_json, print_message


@command(ASK)
def explain(
    store: StorePath,
    take: Annotated[str, typer.Argument(help="Name of the take.")],
    start: StartArgument = None,
    stop: StopArgument = None,
    label: Annotated[
        str | None, typer.Option("--class", metavar="CLASS", help="Class to explain; the most probable unless given.")
    ] = None,
    top: Annotated[int, typer.Option(min=1, help="Largest number of quantities.")] = 12,
    *,
    output: Output,
    as_json: JsonOption = False,
    at: AtOption = None,
) -> None:
    """Explain which class an interval of a take shows, by quantities.

    The quantities (heights, ways, speeds, turn, duration) speak for the class or against it, beside the class that is
    the most probable of the others. Examples are the labels of the store, and takes with a class.
    """
    from kinedex.pipelines.templates.stored_templates import clip_range
    from kinedex.reports.class_explanations import described_labels, explain_interval, reasons_table

    opened = open_for_reading(store, at)
    interval = clip_range(opened, take, start, stop)
    found = explain_interval(opened, described_labels(opened), take, interval, label)
    table = reasons_table(found).slice(0, top)
    if as_json:
        facts = {key: value for key, value in found._asdict().items() if key != "reasons"}
        print_json({"store": store, "take": take, **facts, "reasons": table})
        return
    output.show(table.select(["speaks", "text", "share"]) if output.is_plain else table)
    if output.is_plain:
        sure, other = (f"{100 * one:.1f} %" for one in (found.probability, found.other_probability))
        print_message(
            f"{found.label} {sure}, {found.other} {other}; for and against {found.label}, beside {found.other}"
        )
