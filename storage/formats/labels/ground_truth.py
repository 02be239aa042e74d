"""Find and read files of manual segments, which serve as ground truth."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from kinedex.ops.errors import KinedexError
from kinedex.storage.formats.labels.formats import ENDINGS, read_labels
from kinedex.storage.formats.labels.segments import LabelFile as LabelFile
from kinedex.storage.formats.labels.segments import ManualSegment as ManualSegment
from kinedex.storage.formats.labels.tables import COLUMNS


def ground_truth_files(pattern: str, roots: Iterable[str | Path]) -> list[Path]:
    """Find the label files of a pattern, sorted.

    Parameters
    ----------
    pattern : str
        A glob relative to each source root, such as "**/ground_truth.csv", or an absolute path or glob.
    roots : iterable of str or Path
        The folders that the archive's takes come from.

    Raises
    ------
    KinedexError
        There is no such file, or a root does not exist; the message names the folders that were searched.
    """
    folders, below = _places(pattern, roots)
    found = _found(folders, below)
    if not found:
        raise KinedexError(
            f"ground truth: no file '{below}' below {', '.join(map(str, folders)) or 'any source folder'}. "
            f"It is a CSV file with the columns {', '.join(COLUMNS)} (source frames, half-open), or labels of another "
            f"kind: {ENDINGS}; where there is none, set `ground_truth` of this stage to none, as with "
            "`--set evaluate.ground_truth=none` for the stage evaluate"
        )
    return found


def any_ground_truth(pattern: str, roots: Iterable[str | Path]) -> bool:
    """Return whether a pattern finds label files; parameters and errors are those of `ground_truth_files`."""
    return bool(_found(*_places(pattern, roots)))


def _places(pattern: str, roots: Iterable[str | Path]) -> tuple[list[Path], str]:
    """Return the folders to search, and the glob relative to them."""
    path = Path(pattern).expanduser()
    if path.is_absolute():
        return [Path(path.anchor)], str(path.relative_to(path.anchor))
    return [Path(root).expanduser() for root in roots], pattern


def _found(folders: Sequence[Path], pattern: str) -> list[Path]:
    gone = [str(folder) for folder in folders if not folder.is_dir()]
    if gone:
        raise KinedexError(f"ground truth: the source folder {gone[0]} is no longer there; give an absolute path")
    try:
        return sorted({file for folder in folders for file in folder.glob(pattern) if file.is_file()})
    except (ValueError, OSError) as fault:
        raise KinedexError(f"ground truth: '{pattern}' does not work as a path or glob: {fault}") from None


def read_ground_truth(path: str | Path) -> LabelFile:
    """Read takes and their manual segments from a label file: CSV, JSON, ELAN, WebVTT or Audacity.

    In a format without take names, the file's name is the take's. Frames are of the source rate, from 0, and half-open;
    seconds become the nearest source frame once the take's rate is known (`ManualSegment.source_frames`).

    Parameters
    ----------
    path : str or Path
        The file.

    Raises
    ------
    SourceError
        The file is damaged; the error names the line.
    """
    return read_labels(path)
