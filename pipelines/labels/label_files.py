"""Label files and folders of them: what they hold, and the differences of two."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import pyarrow as pa

from kinedex.ops.errors import KinedexError
from kinedex.pipelines.labels.segments import Segment, differences
from kinedex.storage.formats.labels.formats import FORMATS, read_labels
from kinedex.storage.formats.labels.segments import LabelFile

_SECONDS = 0.0015
"""Times of two formats that are at most so far apart are the same: some have milliseconds."""

_SCHEMA = pa.schema(
    [(name, pa.string()) for name in ("take", "change", "class", "new_class")]
    + [(name, pa.float64()) for name in ("start", "stop", "new_start", "new_stop")]
    + [("unit", pa.string())]
)


def label_files(paths: Iterable[Path]) -> list[LabelFile]:
    """Read label files, and all of those in folders.

    Parameters
    ----------
    paths : iterable of Path
        Files, and folders, whose files are read by their endings.

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


def difference_table(before: Path, after: Path, *, every: bool = False) -> pa.Table:
    """Return the differences of label files as rows.

    Parameters
    ----------
    before, after : Path
        A label file, or a folder of them.
    every : bool, optional
        True includes segments that are the same.

    Raises
    ------
    KinedexError
        The one counts seconds and the other source frames.
    """
    files = [label_files([path]) for path in (before, after)]
    units = {one.in_seconds for side in files for file in side for one in file.segments}
    if len(units) > 1:
        raise KinedexError(
            f"{before} and {after}: one of them counts seconds and the other source frames, which only a store can "
            "compare: `kinedex labels export` writes both in one format"
        )
    old, new = (
        [Segment(one.take, one.label, one.start, one.stop) for file in side for one in file.segments] for side in files
    )
    in_seconds = True in units
    rows = [
        {
            "take": (one.after or one.before).take,  # type: ignore[union-attr]
            "change": one.change,
            **({"class": one.before.label, "start": one.before.start, "stop": one.before.stop} if one.before else {}),
            **(
                {"new_class": one.after.label, "new_start": one.after.start, "new_stop": one.after.stop}
                if one.after
                else {}
            ),
            "unit": "seconds" if in_seconds else "source frames",
        }
        for one in differences(old, new, _SECONDS if in_seconds else 0.0)
        if every or one.change != "same"
    ]
    return pa.Table.from_pylist(rows, schema=_SCHEMA)
