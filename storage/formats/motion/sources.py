"""List the sources of an archive: motion files, their skeletons, groups named by paths, and files of other kinds."""

from __future__ import annotations

import hashlib
import os
import re
import stat
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

from kinedex.catalog.capture_sessions import MARKERS
from kinedex.ops.errors import SourceError, StoreError
from kinedex.storage.formats.motion.packed_files import (
    Member,
    archive,
    container_of,
    opened,
    packed_size,
    split_ending,
)
from kinedex.storage.formats.motion.reader_table import is_known_by_ending, is_motion_file, motion_endings
from kinedex.storage.formats.motion.scanned_files import SkippedFile, SourceFile, UnreadableFile, readable
from kinedex.storage.formats.motion.skeleton_files import (
    SkeletonFolder,
    given_skeleton,
    nearest_skeleton,
    skeleton_doubt,
    skeletons_by_folder,
)
from kinedex.storage.formats.motion.static_files import static_trial_of, trials_by_folder
from kinedex.storage.formats.motion.text_blocks import BLOCK
from kinedex.storage.formats.motion.unpacked_files import is_utf16, recognised

NO_MOTION = "tables or data in which no reader finds motion"
"""The kind of files with an extension of some reader but content that no reader recognises."""

_SYSTEM, _OTHER = "hidden files and files of the system", "files of other kinds"

_ENDINGS = {
    "labels": ".eaf .pfsx .etf .textgrid .srt .vtt",
    "images or films": ".png .jpg .jpeg .gif .bmp .tif .tiff .webp .svg .ico .heic .avi .mp4 .m4v .mov .mkv .mpg .mpeg "
    ".webm .wmv .mts",
    "sound": ".wav .mp3 .ogg .flac .aiff .m4a .mid",
    "texts": ".txt .md .rst .tex .bib .log .pdf .doc .docx .odt .rtf .ppt .pptx .htm .html .url",
    "archives, which are not unpacked": ".tar .tgz .gz .bz2 .xz .zst .7z .rar",
    "archives that hold no files": ".zip",
    "tables": ".csv .tsv .xls .xlsx .ods .parquet .db .sqlite",
    "data": ".json .jsonl .yaml .yml .xml .toml .ini .cfg .mat .h5 .hdf5 .npy .npz .pkl .pickle .pt .pth .bin .dat",
    "files of capture software": ".x1d .x2d .x2e .xcp .mcp .mkr .vsk .vst .vpf .enf .system .history .cal .prj "
    ".qca .mvna .mox .ttp .ttproj .motive",
    "models or meshes": ".osim .obj .ply .stl .mtl .vtp .skp .urdf",
    "programs": ".py .ipynb .m .r .c .h .cpp .cs .java .js .ts .sh .bat .exe .dll .so .pyc",
}
_KINDS = {ending: kind for kind, endings in _ENDINGS.items() for ending in endings.split()}
_TEXT_NAMES = ("license", "licence", "copying", "notice", "readme", "authors", "contributors", "changelog", "makefile")
_SYSTEM_NAMES = ("thumbs.db", "desktop.ini")


def is_of_system(name: str) -> bool:
    """Return whether a file was made by the operating system, not the user: macOS writes ._x.bvh beside x.bvh."""
    return name.startswith(("._", "~$")) or name.lower() in _SYSTEM_NAMES


def kind_of(name: str) -> str:
    """Return the kind of a file that is not motion, by its name; "files of other kinds" if it is unknown."""
    ending = os.path.splitext(name)[1].lower()
    if is_of_system(name) or name.startswith("."):
        return _SYSTEM
    return "texts" if name.lower() in _TEXT_NAMES else _KINDS.get(ending, _OTHER)


UNREAD = {
    ".htr": "export it as BVH",
    ".bip": "export it as BVH",
    ".tak": "export it from Motive as CSV, BVH or C3D",
    ".qtm": "export it from Qualisys Track Manager as TSV or C3D",
    ".mvn": "export it from Xsens MVN as MVNX or BVH",
    ".blend": "export it from Blender as BVH or FBX",
    ".max": "export it from 3ds Max as BVH or FBX",
    ".ma": "export it from Maya as FBX",
    ".mb": "export it from Maya as FBX",
}
"""A dict from extension of motion files that kinedex cannot read to advice on conversion."""


SIDECARS = (".yaml", ".yml")
"""Endings of files that describe a motion file of the same name in the same folder."""

_MAX_ENDINGS = 6


@dataclass(frozen=True)
class Scan:
    """The content of a source root: every file is in one of the tuples, each sorted by path.

    Attributes
    ----------
    motions : tuple of SourceFile
        Motion files.
    skeletons : tuple of SourceFile
        Skeleton files.
    unread : tuple of SourceFile
        Motion files of formats that kinedex does not read, see `UNREAD`.
    refused : tuple of UnreadableFile
        Possible motion files that cannot be read or lie outside the root.
    passed_over : tuple of SkippedFile
        All other files.
    sidecars : tuple of SourceFile
        YAML files with the name of a motion file in the same folder, which describe its takes.
    """

    motions: tuple[SourceFile, ...]
    skeletons: tuple[SourceFile, ...]
    unread: tuple[SourceFile, ...] = ()
    refused: tuple[UnreadableFile, ...] = ()
    passed_over: tuple[SkippedFile, ...] = ()
    sidecars: tuple[SourceFile, ...] = ()

    @property
    def count(self) -> int:
        """The number of files; a folder that cannot be read counts as one file."""
        files = (self.motions, self.skeletons, self.unread, self.refused, self.passed_over, self.sidecars)
        return sum(map(len, files))

    def hidden(self, path: str) -> bool:
        """Return whether a path is in a folder that the scan could not read, so that its content is unknown."""
        return any(path == refused.path or path.startswith(f"{refused.path}/") for refused in self.refused)

    @cached_property
    def _skeletons_in(self) -> dict[str, SkeletonFolder]:
        return skeletons_by_folder(self.skeletons)

    def skeleton_of(self, motion: SourceFile) -> SourceFile:
        """Return the skeleton file that belongs to a motion file, as the function `skeleton_of` does."""
        return nearest_skeleton(motion, self._skeletons_in)

    @cached_property
    def _static_trials(self) -> Mapping[tuple[str, str], list[SourceFile]]:
        return trials_by_folder(self.motions)

    def chosen_skeleton(
        self, motion: SourceFile, given: Mapping[str, str]
    ) -> tuple[SourceFile | None, tuple[str, ...]]:
        """Return the skeleton file of an AMC file, or the static trial of a file of markers, if it has one.

        A warning comes with it if the names of an AMC file and of its skeleton do not fit each other.

        Parameters
        ----------
        motion : SourceFile
            The motion file.
        given : mapping of str to str
            The skeleton files that settings give, see `given_skeleton`; for other motion files the rule of
            `skeleton_of` counts.
        """
        if motion.format in MARKERS:
            same = [file for file in self.motions if file.format == motion.format] if given else []
            trial = given_skeleton(motion, same, given, motion.format)
            return (trial if trial not in (None, motion) else static_trial_of(motion, self._static_trials)), ()
        if motion.format != "amc":
            return None, ()
        if (skeleton := given_skeleton(motion, self.skeletons, given)) is not None:
            return skeleton, ()
        skeleton = self.skeleton_of(motion)
        doubt = skeleton_doubt(motion.absolute, skeleton.absolute)
        return skeleton, () if doubt is None else (doubt,)

    @cached_property
    def digest(self) -> str:
        """A hash of path, size and time of motion files, skeletons and sidecars, and of path and fault of refused ones.

        Equal hashes mean that nothing has changed that an ingest reads.
        """
        hasher = hashlib.sha256()
        for file in (*self.motions, *self.skeletons, *self.sidecars):
            hasher.update(f"{file.path}\0{file.size}\0{file.mtime_ns}\n".encode())
        for refused in self.refused:
            hasher.update(f"{refused.path}\0{refused.fault.reason}\n".encode())
        return hasher.hexdigest()[:16]

    def unread_lines(self) -> list[str]:
        """Return a line for every format that cannot be read: the number of files, and how to convert them."""
        counts = Counter(f".{file.format}" for file in self.unread)
        return [
            f"{count} {'file' if count == 1 else 'files'} of a format not read ({ending}): {UNREAD[ending]}"
            for ending, count in sorted(counts.items())
        ]

    def passed_over_lines(self) -> list[str]:
        """Return a line for every kind of file that is not motion: the number of files, and their extensions."""
        kinds: dict[str, Counter[str]] = {}
        for file in self.passed_over:
            kinds.setdefault(file.kind, Counter())[file.ending or "without an ending"] += 1
        lines = []
        for kind, endings in sorted(kinds.items(), key=lambda item: (-item[1].total(), item[0])):
            few = ", ".join(f"{readable(ending)} {count:,}" for ending, count in endings.most_common(_MAX_ENDINGS))
            more = len(endings) - _MAX_ENDINGS
            lines.append(f"passed over as {kind}: {endings.total():,} ({few}{f' and {more} more' * (more > 0)})")
        return lines


def scan(root: str | Path) -> Scan:
    """List the files below a source root: motion files, skeleton files (.asf), sidecars, and all others.

    Links to folders are not followed, which avoids loops; a linked folder inside the root is found at its own path.
    Links to files are followed inside the root. Broken links, links out of the root, and files without access are
    listed as refused: nothing outside the root is read. The files of .zip archives are listed like those of folders;
    what cannot be read there is listed as refused. Every other file is listed with its kind.

    Parameters
    ----------
    root : str or Path
        The source root.

    Raises
    ------
    StoreError
        The root is not a folder, or its own path is not UTF-8.
    """
    root = Path(os.path.realpath(Path(root).expanduser()))
    if readable(str(root)) != str(root):
        raise StoreError(f"source '{readable(str(root))}' is not UTF-8 text: rename the folder, or link to it")
    if not root.is_dir():
        holds = "archive" if root.suffix.lower() == ".zip" else "motion files"
        raise StoreError(f"source '{root}' is not a folder: give the folder that holds the {holds}")
    found: dict[str, list[Any]] = {name: [] for name in _LISTS}
    kinds = dict.fromkeys(UNREAD, "unread") | {".asf": "skeletons"} | dict.fromkeys(motion_endings(), "motions")
    entries = list(_with_members(root, found["refused"], found["passed_over"]))
    beside = {(entry.folder, entry.stem) for entry in entries if kinds.get(entry.ending) == "motions"}
    packed = _packed_motions(entry for entry in entries if kinds.get(entry.ending) == "motions")
    for entry in entries:
        described = entry.ending in SIDECARS and (entry.folder, entry.stem) in beside
        kind = "sidecars" if described else kinds.get(entry.ending)
        if entry.member is not None and entry.ending == ".zip":
            kind = "motions"  # of which it may hold some: it is refused, not passed over
        path = readable(entry.relative)
        if kind is None or is_of_system(entry.name):
            found["passed_over"].append(SkippedFile(path, kind_of(entry.name)))
            continue
        try:
            file = _source_file(root, entry, path)
            if kind != "motions" or _is_motion(entry, packed):
                found[kind].append(file)
            else:
                found["passed_over"].append(SkippedFile(path, NO_MOTION))
        except SourceError as fault:
            found["refused"].append(UnreadableFile(path, fault))
    return Scan(*(tuple(found[name]) for name in _LISTS))


_LISTS = tuple(one.name for one in fields(Scan))


class _Entry(NamedTuple):
    """A file below the root, or one in an archive there: its paths, its name divided, and its record in the archive."""

    place: str
    relative: str
    folder: str
    name: str
    stem: str
    ending: str
    member: Member | None = None
    mtime_ns: int = 0

    @property
    def is_packed(self) -> bool:
        """True for a file in an archive, and for one that ends with .gz."""
        return self.member is not None or self.name[-3:].lower() == ".gz"


def _with_members(root: Path, refused: list[UnreadableFile], passed: list[SkippedFile]) -> Iterator[_Entry]:
    """Yield all files below the root, and the files in archives instead of these; collect what cannot be listed."""
    above = len(os.path.join(root, ""))
    for folder, name in _entries(root, refused):
        place = os.path.join(folder, name)
        relative = place[above:].replace(os.sep, "/")
        stem, ending = split_ending(name)
        entry = _Entry(place, relative, folder, name, stem, ending.lower())
        if entry.ending != ".zip" or is_of_system(name):
            yield entry
            continue
        path = readable(relative)
        try:
            _source_file(root, entry, path)
            found = archive(Path(place))
        except SourceError as fault:
            refused.append(UnreadableFile(path, fault))
            continue
        if not found.members and not found.refused:
            passed.append(SkippedFile(path, kind_of(name)))
        for odd, reason in sorted(found.refused.items()):
            shown = "/".join(part for part in odd.split("/") if part not in ("", ".", ".."))
            named = SourceError(readable(place), f"{odd!r} {reason}")
            refused.append(UnreadableFile(f"{path}/{readable(shown)}", named))
        for inside, member in sorted(found.members.items()):
            within, last = os.path.split(os.path.join(place, inside))
            stem, ending = split_ending(last)
            paths = os.path.join(within, last), f"{relative}/{inside}"
            yield _Entry(*paths, within, last, stem, ending.lower(), member, found.mtime_ns)


def _packed_motions(entries: Iterable[_Entry]) -> frozenset[Path]:
    """Return the paths of packed files that readers recognise by their content, among those that need it."""
    folders: dict[str, list[Path]] = {}
    for entry in entries:
        sound = entry.member is None or not entry.member.reason
        if entry.is_packed and sound and not is_of_system(entry.name) and not is_known_by_ending(entry.ending):
            folders.setdefault(entry.folder, []).append(Path(entry.place))
    return frozenset(path for paths in folders.values() for path in recognised(paths))


def _is_motion(entry: _Entry, packed: frozenset[Path]) -> bool:
    if entry.is_packed:
        return is_known_by_ending(entry.ending) or Path(entry.place) in packed
    if is_motion_file(entry.place):
        return True
    path = Path(entry.place)
    return is_utf16(path) and bool(recognised([path]))


def _entries(root: Path, refused: list[UnreadableFile]) -> Iterator[tuple[str, str]]:
    """Yield folder and name of every entry below the root that is not a folder; collect unreadable folders."""

    def refuse(path: str, message: str) -> None:
        shown = readable(Path(path).relative_to(root).as_posix())
        refused.append(UnreadableFile(shown, SourceError(readable(path), message)))

    def unreadable(fault: OSError) -> None:
        refuse(os.fsdecode(fault.filename), f"the folder cannot be read: {fault.strerror}")

    for folder, folders, names in os.walk(root, onerror=unreadable):
        folders.sort()
        for name in folders:
            path = os.path.join(folder, name)
            if os.path.islink(path) and not (target := Path(os.path.realpath(path))).is_relative_to(root):
                refuse(path, f"is a link to {readable(str(target))}, outside the source; {_BRING_IN}")
        yield from ((folder, name) for name in sorted(names))


_BRING_IN = "copy what it leads to into the source, or ingest that folder as a source of its own"


def _source_file(root: Path, entry: _Entry, shown: str) -> SourceFile:
    path, on_disk = entry.place, "" if shown == entry.relative else entry.relative
    if entry.member is not None:
        if entry.member.reason:
            raise SourceError(readable(path), entry.member.reason)
        return SourceFile(str(root), shown, entry.member.record.file_size, entry.mtime_ns, on_disk)
    try:
        found = os.lstat(path)
        if stat.S_ISLNK(found.st_mode):
            target = Path(os.path.realpath(path))
            if not target.is_relative_to(root):
                raise SourceError(
                    readable(path), f"is a link to {readable(str(target))}, outside the source; {_BRING_IN}"
                )
            found = os.stat(path)
    except OSError as fault:
        # removed since the folder was listed, a broken link, or a cycle of links
        raise SourceError(readable(path), f"cannot be read: {fault.strerror}") from None
    if not stat.S_ISREG(found.st_mode):
        raise SourceError(readable(path), "is no file (but a pipe, a device or a socket, or a link to a folder)")
    size = packed_size(Path(path)) if entry.is_packed else found.st_size
    return SourceFile(str(root), shown, size, found.st_mtime_ns, on_disk)


def checksum(path: Path) -> str:
    """Return the SHA-256 of a file in hexadecimal; that of a packed file is computed from its unpacked bytes.

    Raises
    ------
    SourceError
        It cannot be read.
    """
    if container_of(path) is not None:
        hasher = hashlib.sha256()
        with opened(path) as packed:
            while data := packed.read(BLOCK):
                hasher.update(data)
        return hasher.hexdigest()
    try:
        with path.open("rb", buffering=0) as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as fault:
        raise SourceError(readable(str(path)), f"cannot be read: {fault.strerror}") from fault


def path_groups(path: str, patterns: Sequence[re.Pattern[str]]) -> Mapping[str, str] | None:
    """Return the named groups of the first pattern that a path matches; None if it matches none."""
    for pattern in patterns:
        found = pattern.search(path)
        if found:
            return {name: value for name, value in found.groupdict().items() if value is not None}
    return None
