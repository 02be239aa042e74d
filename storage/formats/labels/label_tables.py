"""Read and write label files that are tables: CSV with a header, as used for ground truth, and JSON."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from kinedex.ops.errors import SourceError, did_you_mean
from kinedex.storage.formats.csv_tables import CsvTable, csv_line
from kinedex.storage.formats.labels.file_labels import LabelFile, LabelsOfTake, ManualSegment
from kinedex.storage.formats.labels.texts import (
    LONGEST_SECONDS,
    MAX_LABELS,
    label_bytes,
    parse_seconds,
    read_text,
    refuse_long,
    refuse_many,
    shown,
)

NAMES = ("take", "class")
FRAMES = ("start", "stop")
SECONDS = ("start_seconds", "stop_seconds")
COLUMNS = (*NAMES, *FRAMES)
"""The columns of ground truth in CSV."""

OPTIONAL = ("limb", "annotator")
"""Optional columns, and keys in JSON: the limb that a label is about, and the person who made it."""

_WRITTEN = ("take", "class", "subclass", *FRAMES, *SECONDS, "cost", "confidence")
_MAX_DIGITS = 15
_MAX_VALUES = 4 * MAX_LABELS  # lists and objects in a JSON file; they take far more memory than their text


def write_csv(takes: Sequence[LabelsOfTake]) -> str:
    """Return a CSV file of the labels of takes; start and stop are source frames, half-open, as in ground truth.

    A take without labels has a row with only its name. A limb that was examined without finding an error has a row with
    take, limb and annotator only. The columns limb and annotator exist if any label has a value for them. An apostrophe
    is put before names that a spreadsheet would evaluate (`csv_line`).
    """
    rows = [
        {"take": labels.take, **row}
        for labels in takes
        for row in [*_rows(labels), *_covered(labels)] or [dict[str, object]()]
    ]
    columns = (*_WRITTEN, *OPTIONAL) if any(row.get(name) for row in rows for name in OPTIONAL) else _WRITTEN
    return "".join([csv_line(columns), *(csv_line(map(row.get, columns)) for row in rows)])


def write_json(takes: Sequence[LabelsOfTake]) -> str:
    """Return a JSON file of the labels of takes, with the rate and number of frames of each."""
    content = [
        {
            "take": labels.take,
            "source_rate_hz": labels.rate_hz,
            "source_frames": labels.frames,
            "segments": list(_rows(labels)),
            **({"without_errors": list(_covered(labels))} if labels.without_errors else {}),
        }
        for labels in takes
    ]
    return json.dumps({"takes": content}, ensure_ascii=False, indent=1) + "\n"


def _covered(labels: LabelsOfTake) -> Iterator[dict[str, object]]:
    for limb, annotator in labels.without_errors:
        yield {name: text for name, text in zip(OPTIONAL, (limb, annotator), strict=True) if text}


def _rows(labels: LabelsOfTake) -> Iterator[dict[str, object]]:
    for one in labels.labels:
        about = {"limb": one.limb or None, "annotator": one.annotator or None} if one.limb or one.annotator else {}
        times = dict(zip(SECONDS, (round(labels.seconds(edge), 6) for edge in (one.start, one.stop)), strict=True))
        yield {
            "class": one.label,
            "subclass": one.subclass,
            "start": one.start,
            "stop": one.stop,
            **times,
            "cost": None if one.cost is None else round(one.cost, 6),
            "confidence": None if one.confidence is None else round(one.confidence, 6),
            **about,
        }


# ---- CSV -------------------------------------------------------------------------------------------------


def read_csv(path: str | Path) -> LabelFile:
    """Read a CSV file with a header and the columns take, class, start, stop.

    The columns limb and annotator are optional; further columns are ignored. Separator, encoding and decimal comma are
    recognised as in `storage.formats.csv_tables`, so that files of Excel can be read.

    Intervals are half-open, in frames of the source file from 0; a file without start and stop may have start_seconds
    and stop_seconds instead. A row with a take but without class, start and stop records that the take was examined. If
    such a row also has a limb, only the limb was examined; if it has an annotator, by that person.

    Parameters
    ----------
    path : str or Path
        The file.

    Raises
    ------
    SourceError
        A column is missing, a name is empty, a frame is not an integer, a segment does not end after its start, or the
        file exceeds a limit of `storage.formats.labels.texts`; the error names the line.
    """
    rows = list(_csv_rows(str(path), CsvTable.of(path, label_bytes(path))))
    segments = tuple(one for one in rows if isinstance(one, ManualSegment))
    takes = tuple(dict.fromkeys(one.take if isinstance(one, ManualSegment) else one[0] for one in rows))
    covered = dict.fromkeys(one for one in rows if not isinstance(one, ManualSegment) and any(one[1:]))
    return LabelFile(str(path), takes, segments, tuple(covered))


def _csv_rows(path: str, table: CsvTable) -> Iterator[ManualSegment | tuple[str, str, str]]:
    """Yield the segment of each row; for a row without a segment, yield take, limb and annotator."""
    header = table.header
    if not header:
        raise SourceError(path, f"is empty; expected a header with {', '.join(COLUMNS)}", line=1)
    edges = SECONDS if not set(FRAMES) & set(header) and set(SECONDS) & set(header) else FRAMES
    columns = (*NAMES, *edges)
    parse = _frame if edges is FRAMES else _second
    for name in columns:
        if name not in header:
            raise SourceError(path, f"has no column '{name}'{did_you_mean(name, header)}", line=1)
    for count, (line, row) in enumerate(table.rows(), 1):
        refuse_many(path, count, line)
        texts = {name: row[name] for name in columns}
        if not any(texts.values()):
            continue
        take = texts["take"]
        about = {name: row[name] for name in OPTIONAL if name in header}
        for name, text in about.items():
            refuse_long(path, len(text), line, name)
        if take and not any(text for name, text in texts.items() if name != "take"):
            yield take, about.get("limb", ""), about.get("annotator", "")
            continue
        for name in NAMES:
            if not texts[name]:
                raise SourceError(path, f"{name} is empty", line=line)
            refuse_long(path, len(texts[name]), line, name)
        start, stop = (parse(path, line, name, table.number(texts[name])) for name in edges)
        if start >= stop:
            unit = "half-open source frames" if edges is FRAMES else "seconds"
            raise SourceError(path, f"start {start} must be before stop {stop} ({unit})", line=line)
        yield ManualSegment(take, texts["class"], start, stop, path, line, edges is SECONDS, **about)


def _frame(path: str, line: int, name: str, text: str) -> int:
    # no take has so many frames, and Python refuses to parse thousands of digits
    if not text.isdecimal() or len(text) > _MAX_DIGITS:
        raise SourceError(path, f"{name} must be a source frame, a whole number from 0, got '{shown(text)}'", line=line)
    return int(text)


def _second(path: str, line: int, name: str, text: str) -> float:
    value = parse_seconds(text)
    if value is None:
        raise SourceError(path, f"{name} must be seconds from 0, such as 12.5, got '{shown(text)}'", line=line)
    return value


# ---- JSON ------------------------------------------------------------------------------------------------


def read_json(path: str | Path) -> LabelFile:
    """Read {"takes": [{"take": …, "segments": [{"class": …, "start": …, "stop": …}]}]}; further keys are ignored.

    Intervals are half-open, in source frames; a segment without start and stop may have start_seconds and stop_seconds
    instead. A segment may also have the texts limb and annotator. A take may have a list "without_errors" of the limbs
    that were examined without marking an error: objects with limb, annotator or both.

    Parameters
    ----------
    path : str or Path
        The file.

    Raises
    ------
    SourceError
        The file is not JSON (the error names the line), or an element is invalid (the error names the element, such as
        "takes[0].segments[3]").
    """
    text = read_text(path)
    values = text.count("{") + text.count("[")
    if values > _MAX_VALUES:
        raise SourceError(path, f"has {values:,} lists and objects; JSON files of labels have at most {_MAX_VALUES:,}")
    try:
        content = json.loads(text, parse_constant=_no_number)
    except json.JSONDecodeError as fault:
        raise SourceError(path, f"is not JSON: {fault.msg}", line=fault.lineno) from None
    except RecursionError:
        raise SourceError(path, "is nested too deeply: it has hundreds of levels, and labels have six") from None
    except ValueError as fault:
        raise SourceError(path, f"is not JSON: {fault}") from None
    names, found, covered = list[str](), list[ManualSegment](), dict[tuple[str, str, str], None]()
    for number, take in enumerate(_list(path, content, "takes", "the file")):
        place = f"takes[{number}]"
        name = _name(path, take, "take", place)
        names.append(name)
        refuse_many(path, len(names))
        for count, one in enumerate(_list(path, take, "segments", place)):
            refuse_many(path, len(found) + 1)
            found.append(_segment(path, name, one, f"{place}.segments[{count}]"))
        for count, one in enumerate(_list(path, take, "without_errors", place) if "without_errors" in take else ()):
            limb, annotator = _about(path, one, f"{place}.without_errors[{count}]")
            covered[name, limb, annotator] = None
    return LabelFile(str(path), tuple(dict.fromkeys(names)), tuple(found), tuple(covered))


def _about(path: str | Path, value: Any, place: str) -> tuple[str, str]:
    """Return limb and annotator of an object, which must have at least one of them."""
    if not isinstance(value, dict) or not any(value.get(key) for key in OPTIONAL):
        raise SourceError(path, f"{place} must be an object with a limb, an annotator or both")
    limb, annotator = (_name(path, value, key, place) if value.get(key) is not None else "" for key in OPTIONAL)
    return limb, annotator


def _no_number(text: str) -> float:
    raise ValueError(f"{text} is no number of JSON")


def _list(path: str | Path, value: Any, key: str, place: str) -> list[Any]:
    inner = value.get(key) if isinstance(value, dict) else None
    if not isinstance(inner, list):
        raise SourceError(path, f"{place} must be an object with a list '{key}'")
    return inner


def _name(path: str | Path, value: Any, key: str, place: str) -> str:
    name = value.get(key) if isinstance(value, dict) else None
    if not isinstance(name, str) or not name.strip():
        raise SourceError(path, f"{place} must have a name '{key}'")
    refuse_long(path, len(name), place=f"{place}.{key}")
    return _unicode(path, name.strip(), f"{place}.{key}")


def _unicode(path: str | Path, text: str, place: str) -> str:
    try:
        text.encode()
    except UnicodeEncodeError:
        raise SourceError(
            path, f"{place} has half of a character in it (\\ud800 to \\udfff alone); remove it"
        ) from None
    return text


def _segment(path: str | Path, take: str, value: Any, place: str) -> ManualSegment:
    label = _name(path, value, "class", place)
    in_seconds = not set(FRAMES) & value.keys() and bool(set(SECONDS) & value.keys())
    start, stop = (_edge(path, value, key, place, in_seconds) for key in (SECONDS if in_seconds else FRAMES))
    if start >= stop:
        raise SourceError(path, f"{place}: start {start} must be before stop {stop}")
    about = {key: _name(path, value, key, place) for key in OPTIONAL if value.get(key) is not None}
    return ManualSegment(take, label, start, stop, str(path), None, in_seconds, place, **about)


def _edge(path: str | Path, value: dict[str, Any], key: str, place: str, in_seconds: bool) -> float:
    number = value.get(key)
    known = isinstance(number, (int, float) if in_seconds else int) and not isinstance(number, bool)
    most = LONGEST_SECONDS if in_seconds else 10**_MAX_DIGITS - 1
    if number is None or not known or not 0 <= number <= most:
        what = "seconds from 0" if in_seconds else "a source frame, a whole number from 0"
        raise SourceError(path, f"{place}.{key} must be {what}, got {shown(repr(number))}")
    edge: float = number
    return edge
