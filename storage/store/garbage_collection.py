"""Garbage collection: old versions of a store, and every file that no version that is kept needs, are removed."""

from __future__ import annotations

import os
import shutil
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from kinedex.ops.errors import ParameterError
from kinedex.storage import index
from kinedex.storage.store.disk import writing
from kinedex.storage.store.lock import Lock
from kinedex.storage.store.manifest import (
    FOLDER,
    TEMPORARY,
    manifest_path,
    named_files,
    read_newest,
    read_version,
    versions,
)
from kinedex.storage.store.schemas import RESULT_KINDS

KEPT_VERSIONS = 2
"""How many of the newest versions stay: the newest, and one to fall back to should its manifest be damaged."""


@dataclass(frozen=True)
class Garbage:
    """A file or folder that is not needed: its path relative to the store, its bytes, and what it is.

    what: "old version", "frames part", "takes part", "results part", "index generation", "unfinished file".
    """

    path: str
    bytes: int
    what: str


def collect(store: str | Path, *, keep: int = KEPT_VERSIONS, dry_run: bool = False) -> list[Garbage]:
    """Remove what the newest versions of a store do not need; files that kinedex has not made are not touched.

    Versions go before their parts, so that killed at any moment it leaves a sound store. Whoever has an older version
    open can no longer read from it what is removed.

    Parameters
    ----------
    store: the store's directory.
    keep: how many of the newest versions stay, at least 1.
    dry_run: only say what would be removed.

    Returns
    -------
    What was removed, versions first.

    Raises
    ------
    StoreError: no store there; a writer or an index build is at work; a version that stays is damaged, so that what it
        needs is not known. Nothing is removed then.
    """
    root = Path(store)
    if keep < 1:
        raise ParameterError("keep", "at least 1", keep)
    read_newest(root)
    with writing(root):
        (root / "index").mkdir(exist_ok=True)
    with Lock(root / "lock", "garbage collection"), Lock(root / "index" / "lock", "garbage collection"):
        found = [*_old_versions(root, keep), *_parts(root, keep), *_unfinished(root), *_generations(root, keep)]
        if not dry_run:
            for garbage in found:
                _remove(root / garbage.path)
    return found


def summary(found: list[Garbage]) -> list[str]:
    """What was found in a few lines, each to follow "removed": how many of each kind, and their bytes."""
    counts, sizes = Counter(garbage.what for garbage in found), Counter[str]()
    for garbage in found:
        sizes[garbage.what] += garbage.bytes
    lines = [
        f"{count:,} {what}{'' if count == 1 else 's'}, {shown_bytes(sizes[what])}" for what, count in counts.items()
    ]
    return lines or ["nothing: there is no garbage"]


def shown_bytes(count: int) -> str:
    """A number of bytes for people."""
    size, unit = float(count), "bytes"
    for larger in ("kB", "MB", "GB", "TB"):
        if size < 1000:
            break
        size, unit = size / 1000, larger
    return f"{count} bytes" if unit == "bytes" else f"{size:.1f} {unit}"


def _old_versions(root: Path, keep: int) -> Iterator[Garbage]:
    for version in versions(root)[:-keep]:
        path = manifest_path(root, version)
        yield Garbage(f"{FOLDER}/{path.name}", path.stat().st_size, "old version")


def _parts(root: Path, keep: int) -> Iterator[Garbage]:
    needed = set().union(*(named_files(root, version) for version in versions(root)[-keep:]))
    for folder in ("frames", "takes", *(f"results/{kind}" for kind in RESULT_KINDS)):
        what = f"{folder.split('/')[0]} part"
        for name in sorted(os.listdir(root / folder)) if (root / folder).is_dir() else ():
            if name.startswith("part-") and f"{folder}/{name}" not in needed:
                yield Garbage(f"{folder}/{name}", (root / folder / name).stat().st_size, what)


def _unfinished(root: Path) -> Iterator[Garbage]:
    for folder in (FOLDER, "frames", "takes", *(f"results/{kind}" for kind in RESULT_KINDS)):
        for path in sorted((root / folder).glob(f"{TEMPORARY}*")):
            yield Garbage(path.relative_to(root).as_posix(), path.stat().st_size, "unfinished file")


def _generations(root: Path, keep: int) -> Iterator[Garbage]:
    """The index generations that fit no version that stays, and what killed builds have left."""
    contents = {read_version(root, version).content_digest() for version in versions(root)[-keep:]}
    for folder in sorted((root / "index").iterdir()):
        if folder.name.startswith(index.BUILDING):
            yield Garbage(f"index/{folder.name}", _size(folder), "unfinished file")
        elif folder.name.startswith(index.GENERATION):
            says = index.read_generation(folder)
            if says is None or says.index_version != index.INDEX_VERSION or says.content not in contents:
                yield Garbage(f"index/{folder.name}", _size(folder), "index generation")


def _size(folder: Path) -> int:
    # what other generations link to as well counts for each of them its share
    found = (file.stat() for file in folder.rglob("*") if file.is_file())
    return sum(file.st_size // file.st_nlink for file in found)


def _remove(path: Path) -> None:
    with writing(path):
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
