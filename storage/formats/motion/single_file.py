"""Read one motion file outside of a store, with the skeleton file that belongs to it."""

from __future__ import annotations

from pathlib import Path

from kinedex.catalog.capture_sessions import MARKERS
from kinedex.catalog.skeletons.mappings import Mappings
from kinedex.ops.errors import KinedexError, SourceError, did_you_mean
from kinedex.storage.formats.motion.packed_files import archive, file_exists, files_in, split_ending
from kinedex.storage.formats.motion.reader import MotionFile
from kinedex.storage.formats.motion.reader_table import is_known_by_ending, motion_endings, persons_of
from kinedex.storage.formats.motion.scanned_files import SourceFile
from kinedex.storage.formats.motion.skeleton_files import skeleton_of
from kinedex.storage.formats.motion.sources import UNREAD
from kinedex.storage.formats.motion.static_files import static_trial_of, trials_by_folder
from kinedex.storage.formats.motion.unpacked_files import unpacked

ABOVE = 3
"""The number of folders above an AMC file that are searched for its ASF file if no source root is given."""


def motion_ending(file: Path) -> str:
    """Return the extension of a motion file in lower case, such as ".bvh".

    Raises
    ------
    KinedexError
        The path is a folder, or there is no such file.
    SourceError
        Files of this format are not read.
    """
    ending = split_ending(file.name)[1].lower()
    if file.is_dir():
        raise KinedexError(f"{file}: is a folder; give a file of it, or read them all: kinedex ingest STORE {file}")
    if not file_exists(file):
        raise KinedexError(f"{file}: no such file")
    if ending == ".zip":
        raise KinedexError(
            f"{file}: is an archive; give a file of it, such as {_example(file)}, or read all: kinedex ingest STORE "
            f"{file.parent}"
        )
    if ending not in motion_endings():
        raise SourceError(file, f"is not read: {UNREAD.get(ending) or 'kinedex reads ' + ', '.join(motion_endings())}")
    return ending


def file_beside(motion: Path, source: Path | None = None) -> Path | None:
    """Find the skeleton file of an AMC file, or the static trial of a file of markers, by the same rules as ingest.

    Parameters
    ----------
    motion : Path
        The motion file.
    source : Path, optional
        The source root, up to which folders are searched for a skeleton.

    Raises
    ------
    KinedexError
        The file does not lie below the source root.
    SourceError
        No skeleton file matches an AMC file, or several match equally well.
    """
    ending = split_ending(motion.name)[1].lower()
    if ending == ".amc":
        return skeleton_beside(motion, source)
    if ending[1:] not in MARKERS:
        return None
    motion = motion.resolve()
    files = [_source(motion.parent, path) for path in files_in(motion.parent) if path.name != motion.name]
    trial = static_trial_of(_source(motion.parent, motion), trials_by_folder(files))
    return trial.absolute if trial is not None else None


def skeleton_beside(amc: Path, source: Path | None = None) -> Path:
    """Find the skeleton file of an AMC file by the same rule as ingest.

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
        No skeleton file matches, or several match equally well.
    """
    amc = amc.resolve()
    root = source.resolve() if source is not None else [amc.parent, *amc.parent.parents][: ABOVE + 1][-1]
    if not amc.is_relative_to(root):
        raise KinedexError(f"--source {source}: {amc} does not lie below it")
    skeletons = []
    for folder in (folder for folder in amc.parents if folder.is_relative_to(root)):
        skeletons += [_source(root, path) for path in files_in(folder) if split_ending(path.name)[1].lower() == ".asf"]
    return skeleton_of(_source(root, amc), skeletons).absolute


def chosen_person(file: Path, skeleton: Path | None, mappings: Mappings, person: str) -> str:
    """Return the person to read in a file; empty for a file with one person.

    Parameters
    ----------
    file : Path
        The motion file.
    skeleton : Path, optional
        Its skeleton file.
    mappings : Mappings
        Skeleton mappings in which the file's nodes are looked up.
    person : str
        The person that the user has chosen, or an empty text.

    Raises
    ------
    SourceError
        The file contains several persons and none is chosen, or it does not contain the chosen one.
    """
    with unpacked(file, skeleton) as copy:
        persons = persons_of(MotionFile(copy.path, copy.skeleton), mappings)
    if person in persons or (not persons and not person):
        return person
    if not persons:
        raise SourceError(file, f"holds one person, who has no name; leave out the person '{person}'")
    names = ", ".join(f"'{name}'" for name in persons)
    if person:
        raise SourceError(file, f"holds no person '{person}'{did_you_mean(person, persons)} (it holds {names})")
    raise SourceError(file, f"holds {len(persons)} persons, {names}; give one of them as the person")


def _example(file: Path) -> Path:
    """Return the path of a motion file in an archive, as an example; the path is made up if none is found."""
    names = archive(file).members
    return file / next((name for name in names if is_known_by_ending(split_ending(name)[1].lower())), "walk.bvh")


def _source(root: Path, path: Path) -> SourceFile:
    return SourceFile(str(root), path.relative_to(root).as_posix(), 0, 0)
