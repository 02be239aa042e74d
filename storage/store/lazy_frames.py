"""Scan tables of a store as lazy frames of polars, over exactly the files and live rows of one version."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import polars as pl

from kinedex.catalog.sql.result_views import ALL
from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.storage.snapshot.schemas import RESULT_KINDS
from kinedex.storage.snapshot.snapshot import Snapshot
from kinedex.storage.snapshot.visible_results import all_parts, origin_of, shown_parts
from kinedex.storage.store.store import data_frame

SCANNED = ("takes", "frames", *RESULT_KINDS, *(f"{ALL}{kind}" for kind in RESULT_KINDS))
"""The views that `scan` can read."""


def scan(store: Snapshot, view: str) -> pl.LazyFrame:
    """Return the rows of a view as a lazy frame, which reads only the columns and row groups that a query needs.

    Parameters
    ----------
    store : Snapshot
        The version to read; its parts are checked first.
    view : str
        "takes", "frames", or a view of results, with or without the prefix `all_`.

    Raises
    ------
    KinedexError
        The view cannot be scanned; the message suggests the nearest name.
    """
    if view not in SCANNED:
        raise KinedexError(f"no view '{view}' can be scanned{did_you_mean(view, SCANNED)}")
    if view == "takes":
        return data_frame(store.take_rows).lazy()
    if view == "frames":
        return _frames(store)
    kind = view.removeprefix(ALL)
    parts = (all_parts if kind != view else shown_parts)(store.manifest, kind)
    empty = data_frame(store.result_view(kind).slice(0, 0)).lazy()
    scans = [
        _files([store.checked.part(part)]).with_columns(
            pl.lit(value, pl.String).alias(name) for name, value in origin_of(store.manifest, kind, part).items()
        )
        for part in parts
    ]
    # parts of an older kinedex lack some columns
    return pl.concat([empty, *scans], how="diagonal").select(empty.collect_schema().names())


def _frames(store: Snapshot) -> pl.LazyFrame:
    parts = [(store.checked.part(part), part.dropped) for part in store.manifest.frames]
    whole = [file for file, dropped in parts if not dropped]
    scans = [_files(whole)] if whole else []
    # rows of replaced or removed takes stay in their part until compaction
    scans += [_files([file]).filter(~pl.col("take_id").is_in(list(dropped))) for file, dropped in parts if dropped]
    if not scans:
        raise KinedexError(f"{store.path} holds no frames")
    return pl.concat(scans)


def _files(files: Iterable[Path]) -> pl.LazyFrame:
    """Return a scan of exactly these files: no path is read as a glob or a partition key."""
    return pl.scan_parquet(list(files), glob=False, hive_partitioning=False)
