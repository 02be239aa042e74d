"""Find and read published generations of the index, and choose the one that fits a version of the store."""

from __future__ import annotations

import json
import os
import re
from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from itertools import chain
from pathlib import Path

from kinedex.ops.errors import StoreError
from kinedex.storage.durable_files import xxh3_of
from kinedex.storage.remedies import build_index, upgrade
from kinedex.storage.snapshot.manifest import Manifest
from kinedex.storage.snapshot.manifest_files import content_digest_of, json_checksum, read_version, versions
from kinedex.storage.snapshot.schemas import FORMAT_VERSION

INDEX_VERSION = 6
"""Version of the index's tables and other files; an index of another version is rebuilt."""

KEPT = 8
"""The number of newest generations that a build keeps; those of versions that readers have open are kept as well. Each
is a copy of the whole file, so their number is limited. `kinedex gc` removes those that no remaining version needs.
"""

BUILDING, GENERATION = ".building-", "gen-"
"""Prefixes of the folders of unfinished and of published generations."""

_NAME = re.compile(rf"{GENERATION}(\d+)(?:-(\d+))?")

FILE, RECORD = "index.duckdb", "generation.json"
"""The files of a generation: the index and its record; the files of bit slices are beside them (`slices_name`)."""


@dataclass(frozen=True)
class ShardPart:
    """The takes of one frames part that are in a shard.

    Attributes
    ----------
    sha256 : str
        Checksum of the part.
    takes : tuple of (int, int)
        Half-open ranges of take ids.
    """

    sha256: str
    takes: tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class Shard:
    """Rows of the index that were made together, from the live takes of some frames parts.

    Attributes
    ----------
    number : int
        Value of the column `shard` in `stored_vocabulary`.
    parts : tuple of ShardPart
        The parts from which the shard was made, with the takes that it still has.
    frames : int
        Number of frames of its takes.
    built_frames : int
        Number of frames when the shard was made; the rows of takes that were removed later have been deleted.
    slices_bytes : int
        Size of the file of its bit slices (`storage.index.slice_files`), which is never rewritten.
    slices_xxh3 : str
        XXH3 of that file.
    """

    number: int
    parts: tuple[ShardPart, ...]
    frames: int
    built_frames: int
    slices_bytes: int
    slices_xxh3: str

    @property
    def take_ids(self) -> Iterator[int]:
        """The ids of the takes of the shard."""
        return chain.from_iterable(range(first, stop) for part in self.parts for first, stop in part.takes)


@dataclass(frozen=True)
class Generation:
    """The record of a published index (`generation.json`).

    Attributes
    ----------
    index_version : int
        `INDEX_VERSION` of the kinedex that built it.
    manifest_version : int
        Version of the store that it was built for.
    content : str
        `Manifest.content_digest` of the takes that it indexes.
    feature_set_digest : str
        Digest of the feature set of the words.
    rate_hz : float
        Analysis frames per second.
    surface : str
        `storage.index.index_views.views_digest` of its views and macros.
    shards : tuple of Shard
        The shards that hold its rows.
    rows : dict of str to int
        Number of rows of each view.
    valid_frames : int
        Number of frames that have a word, over all takes.
    bytes : int
        Size of the DuckDB file.
    xxh3 : str
        XXH3 of the DuckDB file.
    whole_bytes_per_frame : float
        Bytes per frame when the file was last written completely.
    built : str
        Time of the build, ISO 8601 in UTC.
    built_frames : int
        Number of frames that were newly indexed for this generation.
    build_seconds : float
        Duration of the build.
    takes : str
        `Manifest.takes_digest` of the version whose rows are in its table `takes`.
    """

    index_version: int
    manifest_version: int
    content: str
    feature_set_digest: str
    rate_hz: float
    surface: str
    shards: tuple[Shard, ...]
    rows: dict[str, int]
    valid_frames: int
    bytes: int
    xxh3: str
    whole_bytes_per_frame: float
    built: str
    built_frames: int
    build_seconds: float
    takes: str = ""

    @property
    def frames(self) -> int:
        """The total number of frames of the indexed takes."""
        return sum(shard.frames for shard in self.shards)

    def to_json(self) -> str:
        """Return the text of `generation.json`, which ends with a checksum of its content."""
        values = asdict(self)
        return json.dumps(values | {"checksum": json_checksum(values)}, indent=1)

    @classmethod
    def from_json(cls, text: str) -> Generation:
        """Parse the text of `generation.json`; raise ValueError, TypeError or KeyError if it is damaged."""
        values = json.loads(text)
        if values.pop("checksum") != json_checksum(values):
            raise ValueError("its content does not fit its checksum")
        values["shards"] = tuple(_shard(shard) for shard in values["shards"])
        return cls(**values)


def _shard(values: dict[str, object]) -> Shard:
    parts = values["parts"]
    if not isinstance(parts, list):
        raise ValueError("parts must be a list")
    known = tuple(ShardPart(part["sha256"], tuple((first, stop) for first, stop in part["takes"])) for part in parts)
    return Shard(**{**values, "parts": known})  # type: ignore[arg-type]


def readable_version(store: Path, newest: Manifest) -> tuple[int, Path | None]:
    """Return the newest version that has an index, and its index; or the newest version and None if none has one.

    If a newer index is damaged, or was made by another version of kinedex, the newest version and None are returned.
    Versions with the takes of one index are consecutive, so that few manifests are read, however many there are.

    Parameters
    ----------
    store : Path
        The store's directory.
    newest : Manifest
        Its newest version.
    """
    generation = current_generation(store, newest)
    if generation is not None:
        return newest.version, generation
    known = {newest.version: newest.content_digest()}
    for folder in generations(store):
        record = read_generation(folder)
        if record is not None and _sound(folder, record):
            version = _last_version(store, record, newest, known)
            if version is not None:
                return version, folder
        elif folder.is_dir():
            # this index may belong to the newest version: report the damage instead of returning an older version
            break
    return newest.version, None


def _last_version(store: Path, record: Generation, newest: Manifest, known: dict[int, str]) -> int | None:
    """Return the last version whose takes are those of an index; None if there is none.

    `known` caches the digests of versions; digests read here are added to it.
    """
    later = [version for version in versions(store) if version >= record.manifest_version]

    def is_other(version: int) -> bool:
        if version not in known:
            known[version] = content_digest_of(store, version, newest)
        return known[version] != record.content

    count = bisect_left(later, True, key=is_other)
    return later[count - 1] if count else None


def current_generation(store: Path, manifest: Manifest) -> Path | None:
    """Return the newest generation that indexes exactly the live takes of a version; None if there is none."""
    content = manifest.content_digest()
    found = None
    # a listed generation may be replaced before it is read; names are never reused
    while found != (found := generations(store)):
        for generation in found:
            record = read_generation(generation)
            if record is not None and record.content == content and _sound(generation, record):
                return generation
    return None


def _sound(generation: Path, record: Generation | None) -> bool:
    """Return whether a generation has the current index version and files of the recorded sizes."""
    return (
        record is not None
        and record.index_version == INDEX_VERSION
        and next(wrong_sizes(generation, record), None) is None
    )


def wrong_sizes(generation: Path, record: Generation) -> Iterator[tuple[str, str]]:
    """Yield name and fault of each file of a generation that is missing or has another size than recorded."""
    for name, (wanted, _) in index_files(record).items():
        size = _size(generation / name)
        if size != wanted:
            yield name, "is missing" if size is None else f"has {size} bytes, the index records {wanted}"


def _size(file: Path) -> int | None:
    try:
        return file.stat().st_size
    except FileNotFoundError:
        return None


def slices_name(number: int) -> str:
    """Return the name of the file that holds the bit slices of a shard."""
    return f"shard-{number:06d}.slices"


def index_files(record: Generation) -> dict[str, tuple[int, str]]:
    """Return a dict from name to (size in bytes, XXH3) for the files of a generation that readers open."""
    slices = {slices_name(shard.number): (shard.slices_bytes, shard.slices_xxh3) for shard in record.shards}
    return {FILE: (record.bytes, record.xxh3), **slices}


def read_generation(generation: Path) -> Generation | None:
    """Return the record of a generation; None if it cannot be read."""
    try:
        return Generation.from_json((generation / RECORD).read_text(encoding="utf-8"))
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return None


def is_whole(generation: Path) -> bool:
    """Return whether the files still have the checksums with which they were published."""
    record = read_generation(generation)
    return record is not None and all(
        file_digest(generation / name) == xxh3 for name, (_, xxh3) in index_files(record).items()
    )


def file_digest(file: Path) -> str:
    """Return the XXH3 of a file; empty if it cannot be read."""
    try:
        return xxh3_of(file)[0]
    except OSError:
        return ""


def missing_index(store: Path, manifest: Manifest) -> StoreError:
    """Return the error for a version of a store whose index is missing or does not fit its takes."""
    if manifest.format_version != FORMAT_VERSION:
        return StoreError(
            f"{store}: the index is missing, or is that of an older kinedex; it cannot be built in a store of format "
            f"{manifest.format_version}, which is only read",
            remedy=upgrade(store),
        )
    newest = max(versions(store), default=0)
    if newest > manifest.version:
        version, generation = readable_version(store, read_version(store, newest))
        if generation is not None:
            return StoreError(
                f"{store}: version {manifest.version}, which is open here, has no index; the newest version that has "
                f"one is {version}: open the store again without naming a version"
            )
    state = "missing"
    if found := generations(store):
        record = read_generation(found[0])
        damaged = found[0] / RECORD if record is None else found[0]
        state = "stale: " + (
            "the takes have changed since it was built"
            if _sound(found[0], record)
            else f"{damaged} is damaged, or was built by another version of kinedex"
        )
    return StoreError(f"{store}: the index is {state}", remedy=build_index(store))


def generations(store: Path) -> list[Path]:
    """Return the folders of all published generations, newest first."""
    folder = store / "index"
    names = os.listdir(folder) if folder.is_dir() else []
    return [folder / name for name in sorted(names, key=_age, reverse=True) if name.startswith(GENERATION)]


def new_generation(store: Path, version: int) -> Path:
    """Return a new folder name for the next generation of a version: `gen-000012`, then `gen-000012-2`."""
    number = max((_age(folder.name)[1] for folder in generations(store) if is_of(folder, version)), default=0)
    return store / "index" / (f"{GENERATION}{version:06d}" + (f"-{number + 1}" if number else ""))


def is_of(generation: Path, version: int) -> bool:
    """Return whether a generation's name is one of this version."""
    return _age(generation.name)[0] == version


def _age(name: str) -> tuple[int, int, str]:
    """Return the sort key of a generation's name: version, number, name."""
    match = _NAME.fullmatch(name)
    return (int(match[1]), int(match[2] or 1), name) if match else (0, 0, name)
