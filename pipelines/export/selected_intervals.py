"""Select the intervals of a request: whole takes, annotations, labels, saved hits, ranges, or rows of SQL."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from kinedex.ops.errors import KinedexError, SourceError, did_you_mean
from kinedex.ops.intervals import nearest_frame
from kinedex.ops.wording import counted, name_list
from kinedex.pipelines.export.request import IntervalSource
from kinedex.pipelines.labels.row_selection import Rejections
from kinedex.storage.formats.csv_tables import unguarded
from kinedex.storage.snapshot.stored_labels import is_of_limbs
from kinedex.storage.store.store import Store

_KNOWN = ("take", "start", "stop", "class", "subclass", "confidence")
_PLACE = re.compile(r"(\d+(?:\.\d*)?|\.\d+)\s*(s?)")


@dataclass(frozen=True)
class SelectedInterval:
    """An interval [start, stop) of a take in analysis frames, with its origin.

    Attributes
    ----------
    take : str
        Name of the take.
    start, stop : int
        The frames.
    label : str or None
        The class.
    confidence : float or None
        The confidence of the annotation or label.
    origin : str
        Source of the interval: take, annotation, label, hit, range or sql.
    stage : str or None
        The stage "<pipeline>/<stage>" that found it.
    run : str or None
        Id of the run of that stage.
    more : dict
        The other columns of a SQL query.
    """

    take: str
    start: int
    stop: int
    label: str | None = None
    confidence: float | None = None
    origin: str = "take"
    stage: str | None = None
    run: str | None = None
    more: dict[str, Any] = field(default_factory=dict, compare=False)

    @property
    def place(self) -> tuple[str, int, int, str]:
        """The take, frames and class, which identify an interval."""
        return self.take, self.start, self.stop, self.label or ""


@dataclass(frozen=True)
class SelectedIntervals:
    """The distinct intervals of a request, sorted by take, start, stop and class, with remarks on excluded ones."""

    intervals: tuple[SelectedInterval, ...]
    remarks: tuple[str, ...]


def selected_intervals(store: Store, what: IntervalSource) -> SelectedIntervals:
    """Find the intervals of a request.

    Parameters
    ----------
    store : Store
        The store to read.
    what : IntervalSource
        The request.

    Raises
    ------
    KinedexError
        The request names something that the store does not have, or selects nothing; the message names the condition
        that excludes everything.
    """
    for name in what.takes:
        store.take_id(name)
    lengths = {row["name"]: int(row["frames"]) for row in store.takes_table(what.where).to_pylist()}
    if what.where is not None and not lengths:
        raise KinedexError(f"the filter `{what.where}` selects no take of {store.path}")
    remarks: list[str] = []
    found = list(_SOURCES[what.kind](store, what, remarks))
    if not found:
        raise KinedexError(f"{store.path}: nothing to export: {_NONE[what.kind]}")
    steps: list[tuple[str, Callable[[SelectedInterval], bool]]] = [
        ("of the takes that are named", lambda one: not what.takes or one.take in what.takes),
        (f"of takes that the filter `{what.where}` selects", lambda one: what.where is None or one.take in lengths),
    ]
    if what.classes:
        shown = ", ".join(what.classes)
        steps.append(
            (f"of class {shown}", lambda one: {one.label, one.more.get("subclass")} & {*what.classes} != set())
        )
    if what.min_confidence is not None:
        least = what.min_confidence
        steps.append((f"with a confidence of {least:g} or more", lambda one: (one.confidence or 0.0) >= least))
    for words, fits in steps:
        rest = [one for one in found if fits(one)]
        if not rest:
            raise KinedexError(_nothing_left(store, what, found, words))
        found = rest
    return SelectedIntervals(tuple(_inside(store, found)), tuple(remarks))


def _nothing_left(store: Store, what: IntervalSource, found: list[SelectedInterval], words: str) -> str:
    classes = sorted({one.label for one in found if one.label})
    hint = did_you_mean(what.classes[0], classes) if what.classes and words.startswith("of class") else ""
    return f"{store.path}: nothing to export: none of {counted(len(found), 'interval')} is {words}{hint}"


def _require_inside(take: str, start: int, stop: int, length: int) -> None:
    if not 0 <= start < stop <= length:
        raise KinedexError(f"{take}[{start}:{stop}] is no interval of this take, which has frames 0 to {length}")


def _inside(store: Store, found: Iterable[SelectedInterval]) -> list[SelectedInterval]:
    """Return distinct intervals, sorted; raise an error if one is not inside its take."""
    lengths = {name: store.take_frames[take_id] for name, take_id in store.take_ids.items()}
    once: dict[tuple[str, int, int, str], SelectedInterval] = {}
    for one in sorted(found, key=lambda one: (one.place, -(one.confidence or 0.0))):
        if one.take not in lengths:
            raise KinedexError(f"no take is named '{one.take}'{did_you_mean(one.take, lengths)}")
        _require_inside(one.take, one.start, one.stop, lengths[one.take])
        once.setdefault(one.place, one)
    return list(once.values())


def _takes(store: Store, what: IntervalSource, remarks: list[str]) -> Iterator[SelectedInterval]:
    for row in store.take_rows.to_pylist():
        yield SelectedInterval(row["name"], 0, int(row["frames"]), row["class"])


def _annotations(store: Store, what: IntervalSource, remarks: list[str]) -> Iterator[SelectedInterval]:
    # imported here because it imports numba, which takes longer than exporting one take
    from kinedex.pipelines.annotation.annotation_tables import annotated_takes, annotation_stage

    stage = annotation_stage(store, what.pipeline)
    annotated_takes(store, stage)  # raises an error if takes were replaced since then
    run = store.manifest.stages[stage].run
    rejections = Rejections(store)
    rows = store.result("annotations", run=run).to_pylist()
    if rejected := sum(map(rejections.include, rows)):
        remarks.append(f"{counted(rejected, 'annotation')} excluded, which a person has rejected")
    for row in rows:
        if rejections.include(row):
            continue
        yield SelectedInterval(
            row["take"], row["start"], row["stop"], row["class"], row["confidence"], "annotation", stage, run,
            {"subclass": row["subclass"]},
        )  # fmt: skip


def _labels(store: Store, what: IntervalSource, remarks: list[str]) -> Iterator[SelectedInterval]:
    rows = [row for row in store.labels().to_pylist() if row["verdict"] == "positive" and not is_of_limbs(row)]
    lengths = {name: store.take_frames[take_id] for name, take_id in store.take_ids.items()}
    gone = [row for row in rows if row["stop"] > lengths.get(row["take"], 0)]
    if gone:
        names = sorted({row["take"] for row in gone})
        remarks.append(
            f"{counted(len(gone), 'label')} excluded, whose takes are gone or shorter now: {name_list(names)}"
        )
    changed = sorted({row["take"] for row in rows if row["checksum"] != store.checksums.get(row["take"])})
    if changed := [name for name in changed if name in lengths]:
        remarks.append(
            f"labels may have moved, since files were changed after they were labelled: {name_list(changed)}"
        )
    for row in rows:
        if row["stop"] <= lengths.get(row["take"], 0):
            confidence = row["confidence"]
            yield SelectedInterval(row["take"], row["start"], row["stop"], row["class"], confidence, "label")


def _hits(store: Store, what: IntervalSource, remarks: list[str]) -> Iterator[SelectedInterval]:
    rows = store.result("hits").to_pylist()
    names = sorted({row["saved_as"] for row in rows})
    if what.name not in names:
        shown = did_you_mean(str(what.name), names) if names else "; `kinedex search … --save NAME` saves hits"
        raise KinedexError(f"{store.path}: no hits were saved as '{what.name}'{shown}")
    for row in rows:
        if row["saved_as"] == what.name:
            yield SelectedInterval(row["take"], row["start"], row["stop"], row["query"], None, "hit", None, row["run"])


def _ranges(store: Store, what: IntervalSource, remarks: list[str]) -> Iterator[SelectedInterval]:
    path = Path(what.name or "")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as fault:
        raise SourceError(path, f"cannot be read: {fault.strerror}") from None
    except UnicodeDecodeError as fault:
        raise SourceError(path, f"is not UTF-8 text (byte {fault.start})") from None
    head = text.partition("\n")[0]
    lines = csv.reader(io.StringIO(text, newline=""), delimiter=";" if ";" in head and "," not in head else ",")
    names = [cell.strip().lower() for cell in next(lines, [])]
    if missing := [name for name in ("take", "start", "stop") if name not in names]:
        raise SourceError(path, f"has no column '{missing[0]}'; a file of ranges has take,start,stop[,class]", line=1)
    for cells in lines:
        if not any(cell.strip() for cell in cells):
            continue
        row = dict(zip(names, map(unguarded, cells), strict=False))
        try:
            yield _row(store, row, "range")
        except KinedexError as fault:
            raise SourceError(path, str(fault), line=lines.line_num) from None


def _sql(store: Store, what: IntervalSource, remarks: list[str]) -> Iterator[SelectedInterval]:
    table = store.sql(str(what.name))
    if "take" not in table.column_names:
        raise KinedexError(
            f"--sql: the result has no column 'take'{did_you_mean('take', table.column_names)}; it needs take, and may "
            "have start, stop, class, confidence and others, which become columns of metadata.csv"
        )
    if ("start" in table.column_names) != ("stop" in table.column_names):
        raise KinedexError(
            "--sql: the result has one of the columns start and stop; it needs both, or none for whole takes"
        )
    for row in table.to_pylist():
        yield _row(store, row, "sql")


def _row(store: Store, row: dict[str, Any], origin: str) -> SelectedInterval:
    """Return the interval in a row of a file or of a SQL query."""
    take = str(row["take"])
    length = store.take_frames[store.take_id(take)]
    start, stop = _frame(store, row.get("start"), "start", 0), _frame(store, row.get("stop"), "stop", length)
    _require_inside(take, start, stop, length)
    label = row.get("class")
    more = {name: value for name, value in row.items() if name not in _KNOWN or name == "subclass"}
    confidence = row.get("confidence")
    try:
        certain = None if confidence in (None, "") else float(str(confidence))
        if certain is not None and not math.isfinite(certain):
            raise ValueError
    except ValueError:
        raise KinedexError(f"confidence must be a number, got '{confidence}'") from None
    return SelectedInterval(take, start, stop, None if label in (None, "") else str(label), certain, origin, more=more)


def _frame(store: Store, value: object, name: str, default: int) -> int:
    if value is None:
        return default
    if isinstance(value, int) and not isinstance(value, bool):
        return value
    match = _PLACE.fullmatch(str(value).strip())
    if match is None or (not match[2] and not float(match[1]).is_integer()):
        raise KinedexError(f"{name} must be a frame (45) or seconds (1.5s), got '{value}'")
    return nearest_frame(float(match[1]), store.rate_hz) if match[2] else int(float(match[1]))


_SOURCES: dict[str, Callable[[Store, IntervalSource, list[str]], Iterator[SelectedInterval]]] = {
    "takes": _takes, "annotations": _annotations, "labels": _labels, "hits": _hits, "ranges": _ranges, "sql": _sql,
}  # fmt: skip

_NONE = {
    "takes": "the store has no takes",
    "annotations": "the annotation found no segment, or a person has rejected all of them",
    "labels": "nobody has labelled anything; `kinedex labels --help` shows how labels come in",
    "hits": "the search found nothing",
    "ranges": "the file has no rows",
    "sql": "the query returns no rows",
}
