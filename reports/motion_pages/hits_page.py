"""Write hits of rankings and searches as a page of moving figures, or as a strip of pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa

from kinedex.ops.errors import KinedexError
from kinedex.ops.intervals import shown_seconds
from kinedex.ops.wording import counted
from kinedex.pipelines.templates.stored_clips import clips_of
from kinedex.pipelines.templates.stored_templates import stored_templates
from kinedex.reports.motion_pages import FIGURES
from kinedex.reports.motion_pages.motion_page import (
    Clip,
    Examples,
    Group,
    MotionPage,
    Place,
    figures_of,
    grouped,
    write_motion_page,
)
from kinedex.reports.stick_figures import StripRow, draw_strip
from kinedex.storage.snapshot.parts import joint_positions
from kinedex.storage.store.store import Store

EXAMPLE = "example"
"""The name of the examples if a ranking is by an interval of a take instead of templates."""


@dataclass(frozen=True)
class HitsPage:
    """The texts about hits on a page or a picture, and the examples beside them.

    Attributes
    ----------
    title, lead : str
        The heading, and the sentence below it.
    group : str
        The column by which hits are grouped.
    examples : Examples, optional
        Value of the column `group` → its examples; or `EXAMPLE` → the examples of all hits.
    remarks : sequence of str
        Sentences at the end.
    """

    title: str
    lead: str
    group: str
    examples: Examples | None = None
    remarks: Sequence[str] = ()


def write_hits_page(store: Store, hits: pa.Table, about: HitsPage, path: Path, most: int = FIGURES) -> str:
    """Write a page of hits, and return the sentence about how many it shows.

    Parameters
    ----------
    store : Store
        The store of the takes.
    hits : pyarrow.Table
        Rows with take, start, stop and the column of groups, and optionally cost or keyframes; the best come first.
    about : HitsPage
        The texts and the examples.
    path : Path
        The file, ending in .html.
    most : int, optional
        Largest number of figures.
    """
    rows = hits.to_pylist()
    clips = [_clip(row, store.rate_hz, about.group, about.examples) for row in rows]
    name_of = {clip: str(row[about.group]) for clip, row in zip(clips, rows, strict=True)}
    groups = grouped(list(name_of), name_of.__getitem__, most)
    page = MotionPage(about.title, about.lead, "hit", groups, tuple(about.remarks))
    return write_motion_page(store, page, path, about.examples)


def best_hits(store: Store, hits: pa.Table, stage: str, each: int) -> dict[str, Any]:
    """Return the best hits of each template as moving figures.

    Parameters
    ----------
    store : Store
        The store of the takes.
    hits : pyarrow.Table
        Rows of the kind `ranked_hits`.
    stage : str
        The stage that learned the templates.
    each : int
        Largest number of figures of a template.

    Returns
    -------
    dict
        The variables of a page template: `groups`, and those of `figures_of`.
    """
    rows = sorted(hits.to_pylist(), key=lambda row: (row["template"], row["rank"]))
    names = list(dict.fromkeys(row["template"] for row in rows))
    examples = template_examples(store, names, "soft", stage)
    groups = []
    for name in names:
        own = [row for row in rows if row["template"] == name]
        clips = tuple(_clip(row, store.rate_hz, "template", examples) for row in own[:each])
        groups.append(Group(name, clips, len(own)))
    return {"groups": groups, **figures_of(store, groups, examples)}


def _clip(row: dict[str, Any], rate_hz: float, group: str, examples: Examples | None) -> Clip:
    start, stop = row["start"], row["stop"]
    facts = [f"{shown_seconds(start, rate_hz)} to {shown_seconds(stop, rate_hz)} s, frames {start} to {stop}"]
    title = str(row["take"])
    if row.get("cost") is not None:
        rank = f"{row['rank']}. " if row.get("rank") is not None else ""
        facts.append(f"{rank}cost {row['cost']:.3f}")
    if row.get("mirrored"):
        facts.append("in the mirror")
    name = ""
    if examples is not None and not row.get("mirrored"):
        name = EXAMPLE if EXAMPLE in examples else str(row[group])
    return Clip(title, start, stop, title, tuple(facts), name)


def ranking_page(
    store: Store, hits: pa.Table, tau: float, kind: str, stage: str | None, example: Place | None
) -> HitsPage:
    """Return the texts about the hits of a ranking, and the examples of its templates.

    Parameters
    ----------
    store : Store
        The store of the takes.
    hits : pyarrow.Table
        The hits; if there are none, the nearest intervals.
    tau : float
        The distance below which an interval is a hit.
    kind : str
        The kind of templates: soft or hard.
    stage : str or None
        The stage that learned the templates.
    example : Place or None
        The interval by which takes are ranked, instead of learned templates.
    """
    names = list(dict.fromkeys(hits.column("template").to_pylist()))
    what = f"{example[0]}, frames {example[1]} to {example[2]}" if example is not None else ", ".join(names)
    title = f"Ranked by {what}" if len(what) < 80 else f"Ranked by {len(names)} templates"
    lead = f"Hits with a distance below {tau:g} in {store.path.resolve().name}, the best first."
    if not any(cost < tau for cost in hits.column("cost").to_pylist()):
        lead = f"There is no hit with a distance below {tau:g}; these are the nearest places."
    examples = {EXAMPLE: [example]} if example else template_examples(store, names, kind, stage)
    return HitsPage(title, lead, "template", examples)


def search_page(store: Store, title: str) -> HitsPage:
    """Return the texts about the hits of a search."""
    return HitsPage(title, f"Intervals of {store.path.resolve().name} that keyframe queries find.", "query")


def template_examples(store: Store, names: Sequence[str], kind: str, stage: str | None = None) -> Examples:
    """Return the clips of learned templates as examples; templates that were read from files have none."""
    try:
        known = stored_templates(store, stage)
    except KinedexError:
        return {}  # no template was learned: all come from files
    chosen = [each.one for each in known if each.one.subclass in names and each.one.kind == kind]
    return {one.subclass: clips_of(store, one) for one in chosen}


def write_strip(store: Store, hits: pa.Table, about: HitsPage, path: Path, most: int = FIGURES) -> str:
    """Write hits as rows of key frames side by side, and return the sentence about how many the picture shows.

    Parameters
    ----------
    store : Store
        The store of the takes.
    hits : pyarrow.Table
        Rows with take, start and stop, and optionally cost; the best come first.
    about : HitsPage
        The line at the top, and the column whose value begins each row of the picture.
    path : Path
        The file, ending in .png.
    most : int, optional
        Largest number of rows.
    """
    rows = hits.slice(0, most).to_pylist()
    amount = counted(hits.num_rows, "hit")
    if len(rows) < hits.num_rows:
        amount = f"{len(rows):,} of {amount}; --figures {hits.num_rows} shows all"
    joints = tuple(store.feature_set.joints)
    strip = []
    for row in rows:
        positions = joint_positions(store.frames(row["take"], row["start"], row["stop"]), joints)
        cost = f", cost {row['cost']:.3f}" if row.get("cost") is not None else ""
        times = f"{shown_seconds(row['start'], store.rate_hz)} to {shown_seconds(row['stop'], store.rate_hz)} s{cost}"
        strip.append(StripRow(f"{row[about.group]} in {row['take']}", times, positions, row["start"], store.rate_hz))
    draw_strip(strip, joints, about.title, amount, path)
    return f"{amount}."
