"""Write pages of moving figures from Python."""

from __future__ import annotations

import os
from pathlib import Path

import polars as pl
import pyarrow as pa

from kinedex.library.arguments import checked
from kinedex.library.store import Store
from kinedex.ops.errors import KinedexError, ParameterError

GROUPS = ("template", "query", "class")
"""Columns by which intervals are grouped by default; the first one that the table has is used."""


@checked
def write_page(
    store: Store,
    intervals: pl.DataFrame | pa.Table,
    path: str | os.PathLike[str],
    *,
    title: str = "",
    group: str | None = None,
    figures: int = 60,
) -> Path:
    """Write a page of moving figures of intervals of takes: hits, annotations, labels, or rows of a SQL query.

    The page is one file with a player and needs no network. For hits of learned templates, the player shows the nearest
    example beside the hit, aligned to it in time.

    Parameters
    ----------
    store : Store
        The store of the takes.
    intervals : polars.DataFrame or pyarrow.Table
        Rows with take (name), start and stop (frames), the most important first; the column `cost` is shown if it
        exists.
    path : str or os.PathLike
        The file, ending in .html.
    title : str, optional
        Heading of the page; by default the number of intervals.
    group : str, optional
        The column to group by; by default template, query or class, the first one that exists.
    figures : int, optional
        Largest number of figures; every group has its share of them. The page states how many it shows.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    KinedexError
        A take is not in the store, frames are beyond its end, or the folder of the file does not exist.
    ParameterError
        Columns are missing, or the file does not end in .html.

    Examples
    --------
    >>> hits = store.rank("squat1Reps", top=3)
    >>> kinedex.write_page(store, hits, folder / "squats.html").name
    'squats.html'
    """
    from kinedex.ops.wording import counted
    from kinedex.reports.motion_pages.hits_page import HitsPage, template_examples, write_hits_page

    file = Path(path)
    if file.suffix.lower() not in (".html", ".htm"):
        raise ParameterError("path", "a file ending in .html", str(file))
    rows = pl.DataFrame(intervals)
    missing = [name for name in ("take", "start", "stop", group) if name is not None and name not in rows.columns]
    if missing:
        raise ParameterError("intervals", f"a data frame with a column '{missing[0]}'", rows.columns)
    if figures < 1:
        raise ParameterError("figures", "at least 1", figures)
    _check_intervals(store, rows)
    by = group or next((name for name in GROUPS if name in rows.columns), None)
    if by is None:
        by = "group"
        rows = rows.with_columns(pl.lit("intervals").alias(by))
    examples = None
    if by == "template":
        examples = template_examples(store.stored, rows["template"].unique(maintain_order=True).to_list(), "soft")
    lead = f"Intervals of takes of {store.path.resolve().name}."
    about = HitsPage(title or counted(len(rows), "interval"), lead, by, examples)
    write_hits_page(store.stored, rows.to_arrow(), about, file, figures)
    return file


def _check_intervals(store: Store, intervals: pl.DataFrame) -> None:
    """Raise a KinedexError for the first interval that is not in the store."""
    frames = dict(store.takes().select("name", "frames").iter_rows())
    for take, start, stop in intervals.select("take", "start", "stop").iter_rows():
        if take not in store:
            store[take]  # raises an error with the nearest name
        if not 0 <= start < stop <= frames[take]:
            raise KinedexError(f"{take}: frames {start} to {stop} are no interval of its {frames[take]} frames")
