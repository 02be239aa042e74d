"""Sources: the motion files of an archive, their skeleton files, and what their paths say."""

from __future__ import annotations

import hashlib
import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ops.errors import SourceError, StoreError

UNREAD = {
    ".fbx": "convert it to BVH first, for instance with Blender (import FBX, export BVH)",
    ".c3d": "markers are not read; export the solved skeleton as BVH or ASF/AMC",
    ".trc": "markers are not read; export the solved skeleton as BVH or ASF/AMC",
    ".htr": "export it as BVH",
    ".bip": "export it as BVH",
    ".glb": "convert it to BVH first, for instance with Blender (import glTF, export BVH)",
}
"""Endings of motion files that kinedex does not read, and the way out."""


@dataclass(frozen=True)
class SourceFile:
    """One motion file of an archive: its path relative to the source root (with /), size, and time of change."""

    root: str
    path: str
    size: int
    mtime_ns: int

    @property
    def absolute(self) -> Path:
        """Where the file lies."""
        return Path(self.root) / self.path

    @property
    def stem(self) -> str:
        """The file's name without folder and ending: the take's name."""
        return Path(self.path).stem

    @property
    def format(self) -> str:
        """The file's ending in small letters, without the dot: "amc" or "bvh" of a motion file."""
        return Path(self.path).suffix[1:].lower()


@dataclass(frozen=True)
class Scan:
    """What a source root holds: motion files and skeleton files, each sorted by path.

    unread: the motion files of formats that kinedex does not read, see `UNREAD`.
    """

    motions: tuple[SourceFile, ...]
    skeletons: tuple[SourceFile, ...]
    unread: tuple[SourceFile, ...] = ()

    @property
    def digest(self) -> str:
        """A hash of every file's path, size and time: equal means that nothing has changed."""
        hasher = hashlib.sha256()
        for file in (*self.motions, *self.skeletons):
            hasher.update(f"{file.path}\0{file.size}\0{file.mtime_ns}\n".encode())
        return hasher.hexdigest()[:16]

    def unread_lines(self) -> list[str]:
        """One line for every format that is there and not read: how many files, and the way out."""
        counts = Counter(f".{file.format}" for file in self.unread)
        return [
            f"{count} {'file' if count == 1 else 'files'} of a format not read ({ending}): {UNREAD[ending]}"
            for ending, count in sorted(counts.items())
        ]


def scan(root: str | Path) -> Scan:
    """List the motion files (.amc, .bvh) and skeleton files (.asf) below a source root, in any letter case.

    Raises
    ------
    StoreError: the root is no folder.
    """
    root = Path(root).expanduser().resolve()
    if not root.is_dir():
        raise StoreError(f"source '{root}' is not a folder: give the folder that holds the motion files")
    motions: list[SourceFile] = []
    skeletons: list[SourceFile] = []
    unread: list[SourceFile] = []
    kinds = {".amc": motions, ".bvh": motions, ".asf": skeletons} | dict.fromkeys(UNREAD, unread)
    for path in _files(root):
        kind = kinds.get(path.suffix.lower())
        if kind is not None:
            stat = path.stat()
            kind.append(SourceFile(str(root), path.relative_to(root).as_posix(), stat.st_size, stat.st_mtime_ns))
    return Scan(tuple(motions), tuple(skeletons), tuple(unread))


def _files(root: Path) -> Iterator[Path]:
    for folder, folders, names in os.walk(root):
        folders.sort()
        yield from (path for name in sorted(names) if (path := Path(folder) / name).is_file())


def checksum(path: Path) -> str:
    """The SHA-256 of a file, in hexadecimal.

    Raises
    ------
    SourceError: it cannot be read.
    """
    hasher = hashlib.sha256()
    try:
        with path.open("rb") as file:
            while block := file.read(1 << 20):
                hasher.update(block)
    except OSError as fault:
        raise SourceError(path, f"cannot be read: {fault.strerror}") from fault
    return hasher.hexdigest()


def skeleton_of(motion: SourceFile, skeletons: Iterable[SourceFile]) -> SourceFile:
    """The skeleton file that belongs to a motion file.

    The same stem, else the longest common name prefix, in the motion's folder; then the same in the folders above, up
    to the source root. Letter case does not count.

    Raises
    ------
    SourceError: none, or a tie; the message names the candidates.
    """
    by_folder: dict[str, list[SourceFile]] = {}
    for skeleton in skeletons:
        by_folder.setdefault(Path(skeleton.path).parent.as_posix(), []).append(skeleton)
    folder = Path(motion.path).parent
    stem = motion.stem.casefold()
    seen: list[str] = []
    while True:
        here = by_folder.get(folder.as_posix(), [])
        seen += [skeleton.path for skeleton in here]
        lengths = {s: _shared_prefix(stem, s.stem.casefold()) for s in here}
        same = [s for s in here if s.stem.casefold() == stem]
        best = same or [s for s in here if lengths[s] > 0 and lengths[s] == max(lengths.values())]
        if len(best) == 1:
            return best[0]
        if best:
            names = ", ".join(s.path for s in best)
            raise SourceError(motion.absolute, f"several skeletons fit its name equally well: {names}; rename one")
        if folder == folder.parent or folder.as_posix() == ".":
            break
        folder = folder.parent
    found = f"found only {', '.join(seen)}" if seen else "found none in its folder nor above, up to the source root"
    raise SourceError(motion.absolute, f"no ASF skeleton whose name begins like '{motion.stem}': {found}")


def _shared_prefix(a: str, b: str) -> int:
    return next((i for i, (x, y) in enumerate(zip(a, b, strict=False)) if x != y), min(len(a), len(b)))


def path_groups(path: str, patterns: Sequence[re.Pattern[str]]) -> Mapping[str, str] | None:
    """What a path says: the named groups of the first pattern that it matches, or None where none does."""
    for pattern in patterns:
        found = pattern.search(path)
        if found:
            return {name: value for name, value in found.groupdict().items() if value is not None}
    return None
