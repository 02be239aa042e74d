"""Read label files and folders of them, and find the differences between two."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa

from kinedex.ops.errors import KinedexError
from kinedex.pipelines.labels.segments import Difference, Segment, differences, placed_files
from kinedex.pipelines.labels.unmatched_labels import UnmatchedLabels
from kinedex.storage.formats.labels.formats import FORMATS, read_labels
from kinedex.storage.formats.labels.segments import LabelFile
from kinedex.storage.formats.labels.tables import OPTIONAL
from kinedex.storage.store.store import Store

_SECONDS = 0.0015
"""Times, in seconds, that differ by at most this are equal, because some formats have milliseconds."""

_SCHEMA = pa.schema(
    [(name, pa.string()) for name in ("take", "change", "class", "new_class")]
    + [(name, pa.float64()) for name in ("start", "stop", "new_start", "new_stop")]
    + [(name, pa.string()) for name in ("unit", *OPTIONAL)]
)


def label_files(paths: Iterable[Path]) -> list[LabelFile]:
    """Read label files, and all label files in folders.

    Parameters
    ----------
    paths : iterable of Path
        Files, and folders, whose files are read by their extensions.

    Raises
    ------
    KinedexError
        A folder has no label file.
    SourceError
        A file cannot be read.
    """
    found: list[Path] = []
    for path in paths:
        if path.is_dir():
            inside = sorted(file for file in path.rglob("*") if file.suffix.lower().removeprefix(".") in FORMATS)
            if not inside:
                raise KinedexError(f"{path}: no file of this folder is a label file")
            found += inside
        else:
            found.append(path)
    return [read_labels(path) for path in found]


@dataclass(frozen=True)
class Differences:
    """The differences between label files.

    Attributes
    ----------
    rows : pyarrow.Table
        Columns take, change, class, new_class, start, stop, new_start, new_stop and unit; limb and annotator if a
        segment has one of them.
    unit : str
        The unit of all rows: "frames" of the store's rate, "source frames" or "seconds".
    remarks : tuple of str
        Takes and segments that were excluded.
    unmatched : tuple of UnmatchedLabels
        The labels that match no take of the store, file by file.
    """

    rows: pa.Table
    unit: str
    remarks: tuple[str, ...] = ()
    unmatched: tuple[UnmatchedLabels, ...] = ()


def label_differences(before: Path, after: Path, store: Store | None = None, *, every: bool = False) -> Differences:
    """Return the differences between label files as rows.

    Parameters
    ----------
    before, after : Path
        A label file, or a folder of them.
    store : Store, optional
        The store of their takes; rows are then in its frames, and files of all formats can be compared. Without one,
        the rows have the unit of the files.
    every : bool, optional
        True to include segments that are equal.

    Raises
    ------
    KinedexError
        One file has seconds and the other source frames, and no store is given; or the store has none of the takes.
    """
    files = [label_files([path]) for path in (before, after)]
    remarks: list[str] = []
    unmatched: list[UnmatchedLabels] = []
    if store is not None:
        placed = [placed_files(store, side) for side in files]
        old, new = (list(side.segments) for side in placed)
        unit, remarks = "frames", [remark for side in placed for remark in side.remarks]
        unmatched = [one for side in placed for one in side.unmatched]
    else:
        units = {one.in_seconds for side in files for file in side for one in file.segments}
        if len(units) > 1:
            raise KinedexError(
                f"{before} and {after}: one of them counts seconds and the other source frames, which only a store can "
                "compare: give it with --store STORE"
            )
        old, new = (
            [
                Segment(one.take, one.label, one.start, one.stop, "", one.limb, one.annotator)
                for file in side
                for one in file.segments
            ]
            for side in files
        )
        unit = "seconds" if True in units else "source frames"
    found = differences(old, new, _SECONDS if unit == "seconds" else 0.0)
    rows = [_row(one, unit) for one in found if every or one.change != "same"]
    return Differences(known_columns(rows, _SCHEMA), unit, tuple(dict.fromkeys(remarks)), tuple(unmatched))


def known_columns(rows: list[dict[str, object]], schema: pa.Schema) -> pa.Table:
    """Return rows as a table; the columns limb and annotator are included only if a row has one of them."""
    table = pa.Table.from_pylist(rows, schema=schema)
    empty = all(table.column(name).null_count == table.num_rows for name in OPTIONAL)
    return table.drop_columns(list(OPTIONAL)) if empty else table


def _row(one: Difference, unit: str) -> dict[str, object]:
    """Return a difference as a row; an added segment has no values before, a removed one none after."""
    known = one.after or one.before
    assert known is not None
    row: dict[str, object] = {"change": one.change, "unit": unit}
    row |= {"limb": known.limb or None, "annotator": known.annotator or None}
    if one.before is not None:
        row |= {"take": one.before.take, "class": one.before.label, "start": one.before.start, "stop": one.before.stop}
    if one.after is not None:
        row |= {"take": one.after.take, "new_class": one.after.label}
        row |= {"new_start": one.after.start, "new_stop": one.after.stop}
    return row
