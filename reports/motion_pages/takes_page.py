"""Write a page that shows the takes of a store as small moving figures, in groups."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import pyarrow as pa

from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.intervals import shown_seconds
from kinedex.ops.wording import counted
from kinedex.reports.motion_pages import FIGURES
from kinedex.reports.motion_pages.motion_page import Clip, MotionPage, grouped, write_motion_page
from kinedex.storage.store.store import Store

LONGEST_SECONDS = 10.0
"""Longest motion of a figure in seconds; for a longer take, its middle is shown."""

FOLDER = "folder"
"""The name of the grouping by the folder of the file, which is used if no column is suitable."""

_GROUPS = ("class", "actor")
"""The columns by which takes may be grouped; the first column with several values is used."""


def write_takes_page(
    store: Store,
    takes: pa.Table,
    path: Path,
    *,
    group: str | None = None,
    most: int = FIGURES,
) -> str:
    """Write a page of takes, and return the sentence about how many it shows.

    Parameters
    ----------
    store : Store
        The store of the takes.
    takes : pyarrow.Table
        Rows of takes, with all of their columns.
    path : Path
        The file, ending in .html.
    group : str, optional
        The column to group by, or "folder"; by default class, actor or folder, the first with several values.
    most : int, optional
        Largest number of figures; every group has its share of them.

    Raises
    ------
    KinedexError
        Takes have no such column.
    """
    rows = takes.to_pylist()
    if group is not None and group not in (FOLDER, *takes.column_names):
        raise KinedexError(f"--group {group}: takes have no column '{group}'{did_you_mean(group, takes.column_names)}")
    by = group or _group_of(rows)
    clips = {
        _clip(row, store.rate_hz): _value(row, by)
        for row in sorted(rows, key=lambda row: (by != FOLDER and row[by] is None, _value(row, by)))
    }
    groups = grouped(list(clips), clips.__getitem__, most)
    seconds = sum(row["seconds"] for row in rows)
    title = f"Takes of {store.path.resolve().name}"
    lead = f"{counted(len(rows), 'take')}, {seconds / 60:.1f} minutes, by {by}."
    page = MotionPage(title, lead, "take", groups)
    return write_motion_page(store, page, path)


def _group_of(rows: Sequence[dict[str, Any]]) -> str:
    """Return the first column that has several values, some of them in several takes; `FOLDER` if there is none."""
    for name in _GROUPS:
        if 1 < len({row[name] for row in rows}) < max(2, len(rows)):
            return name
    return FOLDER


def _value(row: dict[str, Any], by: str) -> str:
    if by == FOLDER:
        return str(PurePosixPath(row["source"]).parent).replace(".", "(top folder)", 1)
    return f"without {by}" if row[by] is None else str(row[by])


def _clip(row: dict[str, Any], rate_hz: float) -> Clip:
    frames = int(row["frames"])
    shown = min(frames, round(LONGEST_SECONDS * rate_hz))
    start = (frames - shown) // 2
    length = f"{shown_seconds(frames, rate_hz, 1)} s"
    if shown < frames:
        length = f"{shown_seconds(shown, rate_hz, 0)} of {length}, from {shown_seconds(start, rate_hz, 1)} s"
    facts = [length, *(str(row[name]) for name in ("class", "actor") if row.get(name) is not None)]
    return Clip(
        row["name"], start, start + shown, row["name"], (facts[0], ", ".join(facts[1:])) if facts[1:] else (length,)
    )
