"""Ground truth: manual segments from CSV files, read with the file and line of every fault."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from ops.errors import KinedexError, SourceError, did_you_mean

COLUMNS = ("take", "class", "start", "stop")

_MOST_DIGITS = 15


@dataclass(frozen=True)
class ManualSegment:
    """Source frames [start, stop) of a take that a person labelled; where it stands in its file."""

    take: str
    label: str
    start: int
    stop: int
    path: str
    line: int

    def error(self, message: str) -> SourceError:
        """An error that names the segment's file and line."""
        return SourceError(self.path, message, line=self.line)


def ground_truth_files(pattern: str, roots: Iterable[str | Path]) -> list[Path]:
    """Find the CSV files of a pattern, sorted.

    Parameters
    ----------
    pattern: a glob relative to each source root, such as "**/ground_truth.csv", or an absolute path or glob.
    roots: the folders that the archive's takes come from.

    Raises
    ------
    KinedexError: none found, or a root is gone; the message says where was looked.
    """
    folders = [Path(root).expanduser() for root in roots]
    path = Path(pattern).expanduser()
    if path.is_absolute():
        folders, pattern = [Path(path.anchor)], str(path.relative_to(path.anchor))
    gone = [str(folder) for folder in folders if not folder.is_dir()]
    if gone:
        raise KinedexError(f"ground truth: the source folder {gone[0]} is no longer there; give an absolute path")
    try:
        found = sorted({file for folder in folders for file in folder.glob(pattern) if file.is_file()})
    except (ValueError, OSError) as fault:
        raise KinedexError(f"ground truth: '{pattern}' does not work as a path or glob: {fault}") from None
    if not found:
        raise KinedexError(
            f"ground truth: no file '{pattern}' below {', '.join(map(str, folders)) or 'any source folder'}. "
            f"It is a CSV file with the columns {', '.join(COLUMNS)} (source frames, half-open); where there "
            "is none: `--set evaluate.ground_truth=none`"
        )
    return found


def read_ground_truth(path: str | Path) -> list[ManualSegment]:
    """Read a CSV file with a header and the columns take, class, start, stop; further columns are left alone.

    Frames are of the source rate, from 0, and half-open. UTF-8, with or without a byte order mark.

    Raises
    ------
    SourceError: file and line of a missing column, an empty name, a frame that is no whole number, or a segment
        that does not end after it starts.
    """
    try:
        with open(path, encoding="utf-8-sig", newline="") as file:
            return list(_rows(str(path), csv.DictReader(file)))
    except OSError as fault:
        raise SourceError(path, f"cannot be read: {fault.strerror}") from fault
    except UnicodeDecodeError as fault:
        raise SourceError(path, f"is not UTF-8 text (byte {fault.start})") from None
    except csv.Error as fault:
        raise SourceError(path, f"is not a CSV file: {fault}") from None


def _rows(path: str, reader: csv.DictReader[str]) -> Iterator[ManualSegment]:
    header = [(name or "").strip() for name in reader.fieldnames or ()]
    if not header:
        raise SourceError(path, f"is empty; expected a header with {', '.join(COLUMNS)}", line=1)
    reader.fieldnames = header
    for name in COLUMNS:
        if name not in header:
            raise SourceError(path, f"has no column '{name}'{did_you_mean(name, header)}", line=1)
    for row in reader:
        line = reader.line_num
        texts = {name: (row[name] or "").strip() for name in COLUMNS}
        if not any(texts.values()):
            continue
        for name in ("take", "class"):
            if not texts[name]:
                raise SourceError(path, f"{name} is empty", line=line)
        start, stop = _frame(path, line, "start", texts["start"]), _frame(path, line, "stop", texts["stop"])
        if start >= stop:
            raise SourceError(path, f"start {start} must be before stop {stop} (half-open source frames)", line=line)
        yield ManualSegment(texts["take"], texts["class"], start, stop, path, line)


def _frame(path: str, line: int, name: str, text: str) -> int:
    # no take has so many frames, and Python refuses to read thousands of digits
    if not text.isdecimal() or len(text) > _MOST_DIGITS:
        got = text if len(text) <= 40 else f"{text[:40]}… ({len(text)} characters)"
        raise SourceError(path, f"{name} must be a source frame, a whole number from 0, got '{got}'", line=line)
    return int(text)
