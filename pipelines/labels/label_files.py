"""Read label files, compare two of them, and collect the labels of takes that are written to label files."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import polars as pl
import pyarrow as pa

from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.intervals import source_frame
from kinedex.pipelines.annotation.annotation_tables import annotated_takes
from kinedex.pipelines.labels.file_segments import SegmentDifference, placed_files, segment_differences
from kinedex.pipelines.labels.row_selection import Rejections
from kinedex.pipelines.labels.unmatched_labels import UnmatchedLabels
from kinedex.storage.formats.labels.file_labels import Label, LabelFile, LabelsOfTake
from kinedex.storage.formats.labels.formats import FORMATS, read_labels
from kinedex.storage.formats.labels.label_tables import OPTIONAL
from kinedex.storage.snapshot.stored_labels import is_of_limbs
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
class FileDifferences:
    """The differences between label files.

    Attributes
    ----------
    rows : pyarrow.Table
        Columns take, change, class, new_class, start, stop, new_start, new_stop and unit; limb and annotator if a
        segment has one of them.
    unit : str
        The unit of all rows: "frames" of the store's rate, "source frames" or "seconds".
    remarks : tuple of str
        Remarks on takes and segments that were excluded.
    unmatched : tuple of UnmatchedLabels
        The labels that match no take of the store, file by file.
    """

    rows: pa.Table
    unit: str
    remarks: tuple[str, ...] = ()
    unmatched: tuple[UnmatchedLabels, ...] = ()


def label_differences(before: Path, after: Path, store: Store | None = None, *, every: bool = False) -> FileDifferences:
    """Return the differences between label files as rows.

    Parameters
    ----------
    before, after : Path
        A label file, or a folder of them.
    store : Store, optional
        The store of the labelled takes. With a store, rows have its frames as unit, and files of all formats can be
        compared; without a store, rows have the unit of the files.
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
        old, new = ([one for file in side for one in file.segments] for side in files)
        unit = "seconds" if True in units else "source frames"
    found = segment_differences(old, new, _SECONDS if unit == "seconds" else 0.0)
    rows = [_row(one, unit) for one in found if every or one.change != "same"]
    return FileDifferences(known_columns(rows, _SCHEMA), unit, tuple(dict.fromkeys(remarks)), tuple(unmatched))


def known_columns(rows: list[dict[str, object]], schema: pa.Schema) -> pa.Table:
    """Return rows as a table; the columns limb and annotator are included only if a row has one of them."""
    table = pa.Table.from_pylist(rows, schema=schema)
    empty = all(table.column(name).null_count == table.num_rows for name in OPTIONAL)
    return table.drop_columns(list(OPTIONAL)) if empty else table


def _row(one: SegmentDifference, unit: str) -> dict[str, object]:
    """Return a difference as a row; an added segment has no values before, a removed one none after."""
    row: dict[str, object] = {"change": one.change, "unit": unit}
    row |= {"limb": one.shown.limb or None, "annotator": one.shown.annotator or None}
    if one.before is not None:
        row |= {"take": one.before.take, "class": one.before.label, "start": one.before.start, "stop": one.before.stop}
    if one.after is not None:
        row |= {"take": one.after.take, "new_class": one.after.label}
        row |= {"new_start": one.after.start, "new_stop": one.after.stop}
    return row


@dataclass(frozen=True)
class AnnotationLabels:
    """Annotations as labels, with the number of rejected ones.

    Attributes
    ----------
    takes : list of LabelsOfTake
        One for each annotated take, including those without labels, in the order of their names.
    rejected : int
        The number of annotations excluded because a person has rejected them.
    """

    takes: list[LabelsOfTake]
    rejected: int


def annotation_labels(
    store: Store, stage: str, takes: Sequence[str] = (), where: str | None = None
) -> AnnotationLabels:
    """Return the annotations of a stage for each take, except those that a person has rejected.

    Parameters
    ----------
    store : Store
        The store to read.
    stage : str
        "<pipeline>/<stage>".
    takes : sequence of str
        The names of the takes to return; by default all.
    where : str, optional
        A SQL filter over the columns of takes.

    Raises
    ------
    KinedexError
        A take was not annotated by this stage, or has been replaced since then.
    """
    annotated = annotated_takes(store, stage)
    unknown = sorted(set(takes) - set(annotated["name"]))
    if unknown:
        raise KinedexError(
            f"stage {stage} did not annotate '{unknown[0]}'{did_you_mean(unknown[0], annotated['name'])}"
        )
    if takes:
        annotated = annotated.filter(pl.col("name").is_in(list(takes)))
    if where is not None:
        annotated = annotated.filter(pl.col("take_id").is_in(store.takes(where)["take_id"].to_list()))
        if not annotated.height:
            raise KinedexError(f"the filter `{where}` selects no take that stage {stage} annotated")
    record = store.manifest.stages[stage]
    found: dict[str, list[Label]] = defaultdict(list)
    rows = {str(row["name"]): row for row in annotated.iter_rows(named=True)}
    rejections, rejected = Rejections(store), 0
    for one in store.result("annotations", run=record.run).to_pylist():
        if one["take"] not in rows:
            continue
        if rejections.include(one):
            rejected += 1
        else:
            found[one["take"]].append(_label(one, rows[one["take"]]))
    return AnnotationLabels([_of_take(row, found[name], record.finished) for name, row in rows.items()], rejected)


def stored_labels(store: Store, takes: Sequence[str] = (), where: str | None = None) -> list[LabelsOfTake]:
    """Return the labels by people that a store holds, for each take.

    Negative labels are excluded, except those of limbs, by which label files record that an annotator has examined a
    limb, or all limbs of the take, without marking an error.

    Parameters
    ----------
    store : Store
        The store to read.
    takes : sequence of str
        The names of the takes to return; by default all that have labels.
    where : str, optional
        A SQL filter over the columns of takes.
    """
    rows = {str(row["name"]): row for row in store.takes(where).iter_rows(named=True)}
    found: dict[str, list[Label]] = defaultdict(list)
    covered: dict[str, list[tuple[str, str]]] = defaultdict(list)
    made = "1970-01-01T00:00:00+00:00"
    for one in sorted(store.labels().to_pylist(), key=lambda one: (one["take"], one["start"], one["stop"])):
        if one["take"] not in rows or (takes and one["take"] not in takes):
            continue
        if one["verdict"] == "positive":
            found[one["take"]].append(_label(one, rows[one["take"]]))
            made = max(made, one["created"].isoformat(timespec="seconds"))
        elif is_of_limbs(one):
            found[one["take"]] += []
            covered[one["take"]].append((one["limb"] or "", one["annotator"] or ""))
    unknown = sorted(set(takes) - set(found))
    if unknown:
        raise KinedexError(f"no label is of '{unknown[0]}'{did_you_mean(unknown[0], found)}")
    return [_of_take(row, found[name], made, covered[name]) for name, row in rows.items() if name in found]


def classes_of_takes(store: Store, takes: Sequence[str] = (), where: str | None = None) -> list[LabelsOfTake]:
    """Return the class of each take, which comes from its path or a table, as one label of all frames of the take.

    Parameters
    ----------
    store : Store
        The store to read.
    takes : sequence of str
        The names of the takes to return; by default all that have a class.
    where : str, optional
        A SQL filter over the columns of takes.

    Raises
    ------
    KinedexError
        One of `takes` has no class, or no take has one.
    """
    rows = store.takes(where).filter(pl.col("class").is_not_null()).sort("name")
    unknown = sorted(set(takes) - set(rows["name"]))
    if unknown:
        raise KinedexError(f"'{unknown[0]}' is no take with a class{did_you_mean(unknown[0], rows['name'])}")
    if not rows.height:
        raise KinedexError(
            f"{store.path}: no take of these has a class; the class of a take comes from its path, by `patterns` of "
            "ingest (`kinedex init DIR` proposes some), or from a table of metadata"
        )
    return [
        _of_take(row, [Label(row["class"], 0, int(row["source_frames"]))], store.manifest.created)
        for row in rows.iter_rows(named=True)
        if not takes or row["name"] in takes
    ]


def _of_take(
    take: Mapping[str, Any], labels: Iterable[Label], made: str, covered: Iterable[tuple[str, str]] = ()
) -> LabelsOfTake:
    rate_hz, frames = float(take["source_rate_hz"]), int(take["source_frames"])
    return LabelsOfTake(str(take["name"]), rate_hz, frames, tuple(labels), made, tuple(covered))


def _label(one: Mapping[str, Any], take: Mapping[str, Any]) -> Label:
    """Return a row of annotations or labels as a label in source frames."""
    rates = take["source_rate_hz"], take["rate_hz"], take["source_frames"]
    start, stop = (source_frame(one[edge], *rates) for edge in ("start", "stop"))
    given = one.get("subclass") or None, one.get("cost"), one["confidence"]
    about = one.get("limb") or "", one.get("annotator") or ""
    return Label(one["class"], start, max(stop, start + 1), *given, *about)
