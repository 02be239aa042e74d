"""Find the skeleton file that belongs to a motion file, by their names and folders or by settings."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path

from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.packed_files import split_ending
from kinedex.storage.formats.motion.scanned_files import SourceFile


def skeleton_of(motion: SourceFile, skeletons: Iterable[SourceFile]) -> SourceFile:
    """Return the skeleton file that belongs to a motion file.

    It has the name of the motion file, or a name whose parts all begin the motion's: `01.asf` is the skeleton of
    `01_14.amc`, and `01_1.asf` is not. Of several the one with the most parts counts. Without such a file, the only
    skeleton file of a folder counts if its name consists of words such as "skeleton" or "actor", or names the folder;
    `skeleton_doubt` says so. The motion's folder comes first, then the folders above, up to the source root. Letter
    case does not count.

    Parameters
    ----------
    motion : SourceFile
        The motion file.
    skeletons : iterable of SourceFile
        All skeleton files.

    Raises
    ------
    SourceError
        No file fits, or several do; the message names the candidates.
    """
    return nearest_skeleton(motion, skeletons_by_folder(skeletons))


def given_skeleton(
    motion: SourceFile, skeletons: Iterable[SourceFile], given: Mapping[str, str], form: str = "asf"
) -> SourceFile | None:
    """Return the skeleton file that settings give a motion file, or None if they give it none.

    Parameters
    ----------
    motion : SourceFile
        The motion file.
    skeletons : iterable of SourceFile
        All skeleton files, or all files that may be static trials.
    given : mapping of str to str
        Pattern with * and ? → path of a skeleton file; both below the source, or names of files. The first pattern that
        the motion's path or name matches counts.
    form : str, optional
        The format of the files that it may be given.

    Raises
    ------
    SourceError
        There is no such skeleton file, or there are several of this name.
    """
    name = os.path.basename(motion.path)
    of_form = {one: to for one, to in given.items() if split_ending(to)[1].lower() == f".{form}"}
    wanted = next((to for one, to in of_form.items() if fnmatchcase(motion.path, one) or fnmatchcase(name, one)), None)
    if wanted is None:
        return None
    skeletons = list(skeletons)
    found = [file for file in skeletons if file.path == wanted]
    found = found or [file for file in skeletons if os.path.basename(file.path) == wanted]
    if len(found) != 1:
        more = f" and {len(found or skeletons) - _MAX_SEEN} more" if len(found or skeletons) > _MAX_SEEN else ""
        those = (", ".join(file.path for file in (found or skeletons)[:_MAX_SEEN]) or "none") + more
        kind = "skeleton" if form == "asf" else "static trial"
        many = f"several {kind}s have this name" if found else f"the source has no such {kind}"
        raise SourceError(motion.absolute, f"`skeleton_files` gives it '{wanted}', but {many}: it has {those}")
    return found[0]


def skeleton_doubt(motion: Path, skeleton: Path) -> str | None:
    """Return a warning if the name of a motion file does not confirm its skeleton file; None if it does."""
    if _begins(*(name_parts(split_ending(file.name)[0]) for file in (motion, skeleton))):
        return None
    return (
        f"its skeleton {skeleton.name} is taken because there is no other, its name does not say so: if these are the "
        "bones of somebody else, give the right ones by `skeleton_files`"
    )


@dataclass
class SkeletonFolder:
    """The skeleton files of one folder, also by the parts of their names."""

    files: list[SourceFile] = field(default_factory=list)
    of_parts: dict[tuple[str, ...], list[SourceFile]] = field(default_factory=dict)


def skeletons_by_folder(skeletons: Iterable[SourceFile]) -> dict[str, SkeletonFolder]:
    folders: dict[str, SkeletonFolder] = {}
    for skeleton in skeletons:
        folder = folders.setdefault(os.path.dirname(skeleton.path), SkeletonFolder())
        folder.files.append(skeleton)
        folder.of_parts.setdefault(name_parts(skeleton.stem), []).append(skeleton)
    return folders


_NAME_PART = re.compile(r"[^\W\d_]+|\d+")
_CAMEL = re.compile(r"(?<=[a-z])(?=[A-Z])")
_ANY_SUBJECT = frozenset(
    "actor asf base body bone bones character default figure human model motion person performer rig skel skeleton "
    "skeletons subject template".split()
)


def name_parts(stem: str) -> tuple[str, ...]:
    """Return the words and numbers of a name in lower case: bd, walk and 01 of `bdWalk_01`."""
    return tuple(part.casefold() for part in _NAME_PART.findall(_CAMEL.sub(" ", stem))) or (stem.casefold(),)


def _begins(motion: tuple[str, ...], skeleton: tuple[str, ...]) -> bool:
    return motion[: len(skeleton)] == skeleton


def nearest_skeleton(motion: SourceFile, folders: Mapping[str, SkeletonFolder]) -> SourceFile:
    """Find a skeleton by the rule of `skeleton_of`, first by the motion's own name."""
    at = os.path.dirname(motion.path)
    seen: list[str] = []
    while True:
        here = folders.get(at, _NO_SKELETONS)
        best = _namesakes(motion, here) or _only_one(motion, here, at)
        if len(best) == 1:
            return best[0]
        if best:
            names = ", ".join(s.path for s in best)
            raise SourceError(motion.absolute, f"several skeletons fit its name equally well: {names}; rename one")
        seen += [skeleton.path for skeleton in here.files]
        if not at:
            break
        at = os.path.dirname(at)
    example = re.split(r"[-_. ]", motion.stem)[0] or motion.stem
    above = " or in a folder above" if os.path.dirname(motion.path) else ""
    found, way_out = "found none in its folder nor above, up to the source root", ""
    if seen:
        more = f" and {len(seen) - _MAX_SEEN} more" if len(seen) > _MAX_SEEN else ""
        found = f"found only {', '.join(seen[:_MAX_SEEN])}{more}"
        name = os.path.basename(motion.path)
        way_out = (
            f', or if it is one of these, name it: `--set \'ingest.skeleton_files={{"{name}": "{seen[0]}"}}\'` of '
            "kinedex run, where * and ? stand for any characters"
        )
    raise SourceError(
        motion.absolute,
        f"no ASF skeleton whose whole name begins '{motion.stem}': {found}; put e.g. '{example}.asf' beside it"
        f"{above}{way_out}",
    )


_NO_SKELETONS = SkeletonFolder()
_MAX_SEEN = 6  # most candidates that an error names


def _namesakes(motion: SourceFile, folder: SkeletonFolder) -> list[SourceFile]:
    """Return the skeletons of a folder whose whole name begins that of a motion, those with the most parts."""
    parts = name_parts(motion.stem)
    for count in range(len(parts), 0, -1):
        if (found := folder.of_parts.get(parts[:count])) is not None:
            stem = motion.stem.casefold()
            return [file for file in found if file.stem.casefold() == stem] or found
    return []


def _only_one(motion: SourceFile, folder: SkeletonFolder, path: str) -> list[SourceFile]:
    """Return the only skeleton of a folder if its name is that of the folder, or names no subject; else nothing."""
    if len(folder.files) != 1:
        return []
    own, named = name_parts(motion.stem), name_parts(folder.files[0].stem)
    if _ANY_SUBJECT.issuperset(named):
        return folder.files
    other_number = own[0].isdigit() and named[0].isdigit()  # 02_05.amc in the folder 01 may be of subject 02
    return folder.files if path and named == name_parts(os.path.basename(path)) and not other_number else []
