"""Remove old versions of a store, and all files that no remaining version needs (garbage collection)."""

from __future__ import annotations

import shutil
import time
from bisect import bisect_left
from collections import Counter
from collections.abc import Container, Iterator
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from kinedex.ops.errors import ParameterError, StoreError
from kinedex.storage.durable_files import TEMPORARY, names_in, write_errors
from kinedex.storage.index.generations import (
    BUILDING,
    GENERATION,
    INDEX_VERSION,
    read_generation,
    readable_version,
)
from kinedex.storage.leases import OpenVersion, open_versions, without_readers
from kinedex.storage.lock import NO_WAIT, Lock, Wait
from kinedex.storage.repair.quarantine import FOLDER as QUARANTINE
from kinedex.storage.snapshot.manifest_files import (
    FOLDER,
    manifest_path,
    named_files,
    read_newest,
    read_version,
    versions,
)
from kinedex.storage.snapshot.schemas import PART_FOLDERS
from kinedex.storage.store.history import FILES
from kinedex.storage.store.history import FOLDER as HISTORY

KEPT_VERSIONS = 2
"""The number of newest versions that are kept: the newest one, and another in case its manifest is damaged."""


_OTHER_FOLDERS = (".", HISTORY, FILES, "jobs", f"{QUARANTINE}/*")
"""The folders without parts, whose files are written without the lock of the store, or by a repair."""


@dataclass(frozen=True)
class Garbage:
    """A file or folder that is not needed.

    Attributes
    ----------
    path : str
        Path relative to the store, with /.
    bytes : int
        Disk space that it takes.
    kind : str
        "old version", "frames part", "takes part", "labels part", "results part", "index generation" or
        "unfinished file".
    """

    path: str
    bytes: int
    kind: str


@dataclass(frozen=True)
class CollectedGarbage:
    """The outcome of a garbage collection.

    Attributes
    ----------
    removed : list of Garbage
        Files and folders that were removed, or would be without `dry_run`; versions come first.
    open_versions : list of OpenVersion
        Versions that are kept only because readers have them open.
    """

    removed: list[Garbage]
    open_versions: list[OpenVersion]


def collect_garbage(
    store: str | Path,
    *,
    keep: int = KEPT_VERSIONS,
    older_than_seconds: float = 0.0,
    dry_run: bool = False,
    wait: Wait = NO_WAIT,
) -> CollectedGarbage:
    """Remove old versions of a store and the files that no remaining version needs; foreign files are not touched.

    A version is removed if it is not one of the newest `keep`, is older than the given age, and no reader has it open.
    The newest version with an index, which readers open by default, is always kept. Versions are removed before their
    parts, so that the store is valid if the process is killed at any moment.

    Parameters
    ----------
    store : str or Path
        The store's directory.
    keep : int, optional
        Number of newest versions to keep, at least 1.
    older_than_seconds : float, optional
        Least time in seconds since the commit of a version that is removed; younger versions are kept.
    dry_run : bool, optional
        Remove nothing; only return what would be removed.
    wait : Wait, optional
        The time to wait for a writer or an index build to finish.

    Returns
    -------
    CollectedGarbage
        The removed files, and the versions that readers have open.

    Raises
    ------
    StoreError
        There is no store; a writer or an index build is active; or a remaining version is damaged, so that the parts
        that it needs are unknown. Nothing is removed.
    """
    root = Path(store)
    if keep < 1:
        raise ParameterError("keep", "at least 1", keep)
    read_newest(root)
    with write_errors(root):
        (root / "index").mkdir(exist_ok=True)
    with (
        Lock(root / "lock", "garbage collection", wait),
        Lock(root / "index" / "lock", "garbage collection", wait),
    ):
        old = _old_versions(root, keep, older_than_seconds)
        opened = open_versions(root, old)
        busy = {one.version for one in opened}
        files = {version: manifest_path(root, version) for version in old if version not in busy}
        manifests = {
            version: Garbage(f"{FOLDER}/{path.name}", path.stat().st_size, "old version")
            for version, path in files.items()
        }
        unneeded = _unneeded(root, manifests)
        if not dry_run:
            late = [version for version in manifests if not _remove_version(root, version)]
            if late:  # readers have opened these in the meantime
                opened = open_versions(root, sorted([*busy, *late]))
                manifests = {version: garbage for version, garbage in manifests.items() if version not in late}
                unneeded = _unneeded(root, manifests)
            for garbage in unneeded:
                _remove(root / garbage.path)
    return CollectedGarbage([*manifests.values(), *unneeded], opened)


def summary(found: list[Garbage]) -> list[str]:
    """Summarise garbage: a line for each kind with count and size, to be printed after "removed"."""
    counts, sizes = Counter(garbage.kind for garbage in found), Counter[str]()
    for garbage in found:
        sizes[garbage.kind] += garbage.bytes
    lines = [
        f"{count:,} {kind}{'' if count == 1 else 's'}, {shown_bytes(sizes[kind])}" for kind, count in counts.items()
    ]
    return lines or ["nothing: there is no garbage"]


def shown_bytes(count: int) -> str:
    """Format a number of bytes for users, such as "12.3 MB"."""
    size, unit = float(count), "bytes"
    for larger in ("kB", "MB", "GB", "TB"):
        if size < 1000:
            break
        size, unit = size / 1000, larger
    return f"{count} bytes" if unit == "bytes" else f"{size:.1f} {unit}"


def _old_versions(root: Path, keep: int, older_than_seconds: float) -> list[int]:
    """Return the versions that are old enough to be removed and not among the newest `keep`, ascending."""
    found = versions(root)
    readable, _ = readable_version(root, read_version(root, found[-1]))
    old = [version for version in found[:-keep] if version != readable]
    if older_than_seconds:
        limit = time.time() - older_than_seconds
        old = old[: bisect_left(old, limit, key=lambda version: _committed(root, version))]
    return old


def _committed(root: Path, version: int) -> float:
    """Return the commit time of a version in seconds since 1970; if its manifest is damaged, the time of the file."""
    try:
        return datetime.fromisoformat(read_version(root, version).created).timestamp()
    except (StoreError, ValueError):
        return manifest_path(root, version).stat().st_mtime


def _remove_version(root: Path, version: int) -> bool:
    """Remove a version unless a reader has it open; return whether it was removed."""
    with without_readers(root, version) as free:
        if free:
            _remove(manifest_path(root, version))
    return free


def _unneeded(root: Path, gone: Container[int]) -> list[Garbage]:
    """Return the files that are needed by no version, or only by the versions to be removed."""
    stay = [version for version in versions(root) if version not in gone]
    return [*_parts(root, stay), *_unfinished(root), *_generations(root, stay)]


def _parts(root: Path, stay: list[int]) -> Iterator[Garbage]:
    needed = set().union(*(named_files(root, version) for version in stay))
    for folder in PART_FOLDERS:
        kind = f"{folder.split('/')[0]} part"
        for name in names_in(root / folder):
            if name.startswith("part-") and f"{folder}/{name}" not in needed:
                yield Garbage(f"{folder}/{name}", (root / folder / name).stat().st_size, kind)


def unfinished_files(root: Path) -> Iterator[str]:
    """Yield the paths, relative to the store, of temporary files of killed runs or of current writes."""
    patterns = [f"{folder}/{TEMPORARY}*" for folder in (FOLDER, *PART_FOLDERS, *_OTHER_FOLDERS)]
    for pattern in (*patterns, "results/reports/*/.*"):
        for path in sorted(root.glob(pattern)):
            yield path.relative_to(root).as_posix()


def _unfinished(root: Path) -> Iterator[Garbage]:
    for path in unfinished_files(root):
        with suppress(FileNotFoundError):  # the file has been finished in the meantime
            yield Garbage(path, (root / path).stat().st_size, "unfinished file")


def _generations(root: Path, stay: list[int]) -> Iterator[Garbage]:
    """Yield the index generations that belong to no remaining version, and the leftovers of killed builds."""
    contents = {read_version(root, version).content_digest() for version in stay}
    for folder in sorted((root / "index").iterdir()):
        if folder.name.startswith(BUILDING):
            yield Garbage(f"index/{folder.name}", _size(folder), "unfinished file")
        elif folder.name.startswith(GENERATION):
            record = read_generation(folder)
            if record is None or record.index_version != INDEX_VERSION or record.content not in contents:
                yield Garbage(f"index/{folder.name}", _size(folder), "index generation")


def _size(folder: Path) -> int:
    # the size of a file that generations share through hard links is divided by the number of links
    found = (file.stat() for file in folder.rglob("*") if file.is_file())
    return sum(file.st_size // file.st_nlink for file in found)


def _remove(path: Path) -> None:
    with write_errors(path):
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
