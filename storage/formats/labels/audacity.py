"""Read and write label tracks of Audacity: a line for each label, with start, stop and text separated by tabs."""

from __future__ import annotations

from pathlib import Path

from kinedex.ops.errors import SourceError
from kinedex.storage.formats.labels.file_labels import LabelFile, LabelsOfTake, ManualSegment
from kinedex.storage.formats.labels.texts import open_lines, parse_seconds, refuse_long, refuse_many, shown


def write(labels: LabelsOfTake) -> str:
    """Return a label track, with six digits after the point, as Audacity writes them."""
    rows = [f"{labels.seconds(one.start):.6f}\t{labels.seconds(one.stop):.6f}\t{one.label}\n" for one in labels.labels]
    return "".join(rows)


def read(path: str | Path) -> LabelFile:
    """Read a label track of the take that the file is named after.

    Lines that begin with a backslash, which give the frequency range of the label above them, are ignored.

    Parameters
    ----------
    path : str or Path
        The file.

    Raises
    ------
    SourceError
        A line is not a label, has no text, or is a point in time (start = stop), or the file exceeds a limit of
        `storage.formats.labels.texts`; the error names the line.
    """
    take, found = Path(path).stem, list[ManualSegment]()
    for line, whole in enumerate(open_lines(path), 1):
        text = whole.removesuffix("\n")
        if not text.strip() or text.startswith("\\"):
            continue
        parts = text.split("\t", 2)
        if len(parts) < 3:
            raise SourceError(path, f"expected start, stop and label separated by tabs, got '{shown(text)}'", line=line)
        times = [parse_seconds(part.strip()) for part in parts[:2]]
        start, stop = times
        if start is None or stop is None:
            bad = parts[0] if start is None else parts[1]
            raise SourceError(path, f"expected seconds such as 12.5, got '{shown(bad)}'", line=line)
        label = parts[2].strip()
        if not label:
            raise SourceError(path, "the label has no text, which would be its class", line=line)
        if start >= stop:
            raise SourceError(path, f"start {start:g} s must be before stop {stop:g} s", line=line)
        refuse_long(path, len(label), line)
        refuse_many(path, len(found) + 1, line)
        found.append(ManualSegment(take, label, start, stop, str(path), line, in_seconds=True))
    return LabelFile.of_take(path, take, found)
