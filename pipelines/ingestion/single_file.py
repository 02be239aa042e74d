"""Reading one motion file outside of an archive, with the skeleton file that belongs to it."""

from __future__ import annotations

from pathlib import Path

from kinedex.ops.errors import KinedexError, SourceError
from kinedex.storage.formats.motion.reader_table import motion_endings
from kinedex.storage.formats.motion.sources import UNREAD, SourceFile, skeleton_of

ABOVE = 3
"""So many folders above an AMC file are searched for its ASF file where no source root is given."""


def motion_ending(file: Path) -> str:
    """Return the ending of a motion file in small letters, such as ".bvh".

    Raises
    ------
    KinedexError
        The path is a folder, or there is no such file.
    SourceError
        Files of this format are not read.
    """
    ending = file.suffix.lower()
    if file.is_dir():
        raise KinedexError(f"{file}: is a folder; give a file of it, or read them all: kinedex ingest STORE {file}")
    if not file.is_file():
        raise KinedexError(f"{file}: no such file")
    if ending not in motion_endings():
        raise SourceError(file, f"is not read: {UNREAD.get(ending) or 'kinedex reads ' + ', '.join(motion_endings())}")
    return ending


def skeleton_beside(amc: Path, source: Path | None = None) -> Path:
    """Find the skeleton file of an AMC file by the rule of ingest.

    Parameters
    ----------
    amc : Path
        The motion file.
    source : Path, optional
        The source root, up to which folders are searched; by default the third folder above the file.

    Raises
    ------
    KinedexError
        The file does not lie below the source root.
    SourceError
        No skeleton file fits, or several fit equally well.
    """
    amc = amc.resolve()
    root = source.resolve() if source is not None else [amc.parent, *amc.parent.parents][: ABOVE + 1][-1]
    if not amc.is_relative_to(root):
        raise KinedexError(f"--source {source}: {amc} does not lie below it")
    skeletons = []
    for folder in (folder for folder in amc.parents if folder.is_relative_to(root)):
        skeletons += [_source(root, path) for path in sorted(folder.glob("*")) if path.suffix.lower() == ".asf"]
    return skeleton_of(_source(root, amc), skeletons).absolute


def _source(root: Path, path: Path) -> SourceFile:
    return SourceFile(str(root), path.relative_to(root).as_posix(), 0, 0)
