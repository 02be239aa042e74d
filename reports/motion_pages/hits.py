"""Hits of rankings and searches as a page of moving figures, or as a strip of pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa

from kinedex.ops.errors import KinedexError
from kinedex.ops.intervals import shown_seconds
from kinedex.ops.wording import counted
from kinedex.pipelines.templates.stored_clips import clips_of
from kinedex.pipelines.templates.stored_templates import stored_templates
from kinedex.reports.hit_strip import StripRow, draw_strip
from kinedex.reports.motion_pages import FIGURES
from kinedex.reports.motion_pages.examples import Examples, Place
from kinedex.reports.motion_pages.motion_page import (
    Clip,
    Group,
    MotionPage,
    figures_of,
    grouped,
    write_motion_page,
)
from kinedex.storage.snapshot.parts import joint_positions
from kinedex.storage.store.store import Store

EXAMPLE = "example"
"""The name of the examples of a ranking by an interval of a take."""


def write_hits_page(
    store: Store,
    hits: pa.Table,
    path: Path,
    *,
    title: str,
    lead: str,
    group: str,
    examples: Examples | None = None,
    remarks: Sequence[str] = (),
    most: int = FIGURES,
) -> str:
    """Write a page of hits, and return the sentence about how many it shows.

    Parameters
    ----------
    store : Store
        The store of the takes.
    hits : pyarrow.Table
        Rows with take, start, stop and the column of groups, and cost or keyframes where there are any, the best first.
    path : Path
        The file, ending in .html.
    title, lead : str
        Heading of the page, and the sentence below it.
    group : str
        The column by which hits are grouped.
    examples : Examples, optional
        Examples by the value of that column, or by `EXAMPLE` for all hits.
    remarks : sequence of str, optional
        Sentences at the end.
    most : int, optional
        Largest number of figures.
    """
    rows = hits.to_pylist()
    clips = [_clip(row, store.rate_hz, group, examples) for row in rows]
    name_of = {clip: str(row[group]) for clip, row in zip(clips, rows, strict=True)}
    page = MotionPage(title, lead, "hit", grouped(list(name_of), name_of.__getitem__, most), tuple(remarks))
    write_motion_page(store, page, path, examples)
    return page.amount


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
        name = EXAMPLE if EXAMPLE in examples.of else str(row[group])
    return Clip(title, start, stop, title, tuple(facts), name)


def write_ranking(
    store: Store,
    hits: pa.Table,
    html: Path | None,
    picture: Path | None,
    *,
    tau: float,
    kind: str = "soft",
    stage: str | None = None,
    example: Place | None = None,
    remarks: Sequence[str] = (),
    most: int = FIGURES,
) -> str:
    """Write the hits of a ranking as a page, as a strip of pictures, or as both.

    Parameters
    ----------
    store : Store
        The store of the takes.
    hits : pyarrow.Table
        Rows of the kind `ranked_hits`: the hits, or the nearest intervals if there is no hit.
    html, picture : Path or None
        The files, ending in .html and .png; None writes none.
    tau : float
        The threshold of the hits.
    kind : {"soft", "hard"}
        The kind of the learned templates.
    stage : str, optional
        The stage that learned them.
    example : (str, int, int), optional
        The interval that was ranked by, in place of learned templates.
    remarks : sequence of str, optional
        Sentences at the end of the page.
    most : int, optional
        Largest number of figures.

    Returns
    -------
    str
        The sentence about how many hits are shown.
    """
    names = list(dict.fromkeys(hits.column("template").to_pylist()))
    what = f"{example[0]}, frames {example[1]} to {example[2]}" if example is not None else ", ".join(names)
    title = f"Ranked by {what}" if len(what) < 80 else f"Ranked by {len(names)} templates"
    amount = ""
    if html is not None:
        examples = Examples({EXAMPLE: [example]}) if example else template_examples(store, names, kind, stage)
        lead = f"Hits with a distance below {tau:g} in {store.path.resolve().name}, the best first."
        if not any(cost < tau for cost in hits.column("cost").to_pylist()):
            lead = f"There is no hit with a distance below {tau:g}; these are the nearest places."
        amount = write_hits_page(
            store, hits, html, title=title, lead=lead, group="template", examples=examples, remarks=remarks, most=most
        )
    if picture is not None:
        amount = write_strip(store, hits, picture, title=title, group="template", most=most)
    return amount


def template_examples(store: Store, names: Sequence[str], kind: str, stage: str | None = None) -> Examples:
    """Return the clips of learned templates as examples; templates of files have none."""
    try:
        known = stored_templates(store, stage)
    except KinedexError:
        return Examples({})  # no template was learned: all come from files
    chosen = [each.one for each in known if each.one.subclass in names and each.one.kind == kind]
    return Examples({one.subclass: clips_of(store, one) for one in chosen})


def write_search(
    store: Store,
    hits: pa.Table,
    html: Path | None,
    picture: Path | None,
    title: str,
    remarks: Sequence[str] = (),
    most: int = FIGURES,
) -> str:
    """Write the hits of a search as a page, as a strip of pictures, or as both; as `write_ranking` otherwise."""
    amount = ""
    if html is not None:
        lead = f"Intervals of {store.path.resolve().name} that keyframe queries find."
        amount = write_hits_page(store, hits, html, title=title, lead=lead, group="query", remarks=remarks, most=most)
    if picture is not None:
        amount = write_strip(store, hits, picture, title=title, group="query", most=most)
    return amount


def write_strip(store: Store, hits: pa.Table, path: Path, *, title: str, group: str, most: int = FIGURES) -> str:
    """Write hits as rows of key frames side by side, and return the sentence about how many the picture shows.

    Parameters
    ----------
    store : Store
        The store of the takes.
    hits : pyarrow.Table
        Rows with take, start and stop, and cost where there is one, the best first.
    path : Path
        The file, ending in .png.
    title : str
        The line at the top.
    group : str
        The column that a row of the picture begins with.
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
        strip.append(StripRow(f"{row[group]} in {row['take']}", times, positions, row["start"], store.rate_hz))
    draw_strip(strip, joints, title, amount, path)
    return f"{amount}."
