"""Published generations of the index: what each says of itself, and which one fits a version of the store."""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from itertools import chain
from pathlib import Path

from kinedex.ops.errors import StoreError
from kinedex.storage.store.manifest import Manifest, versions

INDEX_VERSION = 4
"""Version of the index's tables and of its other files; an index of another version is built again."""

KEPT = 8
"""How many generations a build leaves, its own among them, for readers that have an older version open. Each is a copy
of the file, so that there must be a bound; `kinedex gc` removes what no version that stays needs."""

BUILD = "run the stage `index` of its pipeline (`kinedex run … --force index`)"

BUILDING, GENERATION = ".building-", "gen-"
"""How the folders of unfinished and of published indexes are named."""

_NAME = re.compile(rf"{GENERATION}(\d+)(?:-(\d+))?")

FILE, SAYS = "index.duckdb", "generation.json"
"""The files of a generation: the index itself, and what it says of itself; bit slices lie beside (`slices_name`)."""


@dataclass(frozen=True)
class ShardPart:
    """What a shard holds of one frames part: the part's checksum, and takes as half-open ranges of ids."""

    sha256: str
    takes: tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class Shard:
    """Rows of the index that were made together, from the live takes of some frames parts.

    number: what the column `shard` of its words says. frames: of its takes. built_frames: when it was made; what it has
    lost since was deleted. slices_bytes, slices_sha256: the file of its bit slices (`storage.index.slices`), which
    stays as it was made.
    """

    number: int
    parts: tuple[ShardPart, ...]
    frames: int
    built_frames: int
    slices_bytes: int
    slices_sha256: str

    @property
    def take_ids(self) -> Iterator[int]:
        """The takes of the shard."""
        return chain.from_iterable(range(first, stop) for part in self.parts for first, stop in part.takes)


@dataclass(frozen=True)
class Generation:
    """What a published index says of itself (`generation.json`).

    content: `Manifest.content_digest` of the takes that it indexes. surface: `storage.index.tables.surface` of its
    views and macros. rows: of each view. valid_frames: frames of all takes that have a word. whole_bytes_per_frame:
    size of the file when it was last written whole. built_frames: those that were indexed anew for this generation.
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
    sha256: str
    whole_bytes_per_frame: float
    built: str
    built_frames: int
    build_seconds: float

    @property
    def frames(self) -> int:
        """The frames of all its takes."""
        return sum(shard.frames for shard in self.shards)

    def to_json(self) -> str:
        """As it stands in `generation.json`."""
        return json.dumps(asdict(self), indent=1)

    @classmethod
    def from_json(cls, text: str) -> Generation:
        """The inverse of `to_json`; a ValueError, TypeError or KeyError where the text is none of its making."""
        values = json.loads(text)
        values["shards"] = tuple(_shard(shard) for shard in values["shards"])
        return cls(**values)


def _shard(values: dict[str, object]) -> Shard:
    parts = values["parts"]
    if not isinstance(parts, list):
        raise ValueError("parts must be a list")
    known = tuple(ShardPart(part["sha256"], tuple((first, stop) for first, stop in part["takes"])) for part in parts)
    return Shard(**{**values, "parts": known})  # type: ignore[arg-type]


def current(store: Path, manifest: Manifest) -> Path | None:
    """The newest generation that indexes exactly the live takes of this version; None where there is none."""
    content = manifest.content_digest()
    found = None
    # one that is there may be replaced before it is looked at; no name is ever given twice
    while found != (found := generations(store)):
        for generation in found:
            says = read_generation(generation)
            if says is not None and says.content == content and _sound(generation, says):
                return generation
    return None


_OTHER = "it is damaged, or was built by another version of kinedex"


def _sound(generation: Path, says: Generation | None) -> bool:
    """Whether a generation is of this version and has files of the right size."""
    return (
        says is not None and says.index_version == INDEX_VERSION and next(wrong_sizes(generation, says), None) is None
    )


def wrong_sizes(generation: Path, says: Generation) -> Iterator[tuple[str, str]]:
    """The files of a generation that are missing or too short or long, and what is wrong with each."""
    for name, (wanted, _) in files(says).items():
        size = _size(generation / name)
        if size != wanted:
            yield name, "is missing" if size is None else f"has {size} bytes, the index says {wanted}"


def _size(file: Path) -> int | None:
    try:
        return file.stat().st_size
    except FileNotFoundError:
        return None


def slices_name(number: int) -> str:
    """The name of the file that holds the bit slices of a shard."""
    return f"shard-{number:06d}.slices"


def files(says: Generation) -> dict[str, tuple[int, str]]:
    """The files of a generation that readers open: name → bytes and SHA-256."""
    slices = {slices_name(shard.number): (shard.slices_bytes, shard.slices_sha256) for shard in says.shards}
    return {FILE: (says.bytes, says.sha256), **slices}


def read_generation(generation: Path) -> Generation | None:
    """What a generation says of itself; None where that cannot be read."""
    try:
        return Generation.from_json((generation / SAYS).read_text(encoding="utf-8"))
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return None


def is_whole(generation: Path) -> bool:
    """Whether the files are, byte by byte, those that were published."""
    says = read_generation(generation)
    return says is not None and all(
        file_digest(generation / name) == sha256 for name, (_, sha256) in files(says).items()
    )


def file_digest(file: Path) -> str:
    """The SHA-256 of a file; an empty text where it cannot be read."""
    try:
        with open(file, "rb") as content:
            return hashlib.file_digest(content, "sha256").hexdigest()
    except OSError:
        return ""


def missing(store: Path, manifest: Manifest) -> StoreError:
    """The error for a version of a store whose index is missing or does not fit its takes."""
    newest = max(versions(store), default=0)
    if newest > manifest.version:
        return StoreError(
            f"{store}: version {manifest.version}, which is open here, has no index, and version {newest} has been "
            "published since; open the store again"
        )
    state = "missing"
    if found := generations(store):
        sound = _sound(found[0], read_generation(found[0]))
        state = f"stale: {'the takes have changed since it was built' if sound else _OTHER}"
    return StoreError(f"{store}: the index is {state}; {BUILD}")


def generations(store: Path) -> list[Path]:
    """The folders of all published generations, newest first."""
    folder = store / "index"
    names = os.listdir(folder) if folder.is_dir() else []
    return [folder / name for name in sorted(names, key=_age, reverse=True) if name.startswith(GENERATION)]


def new_generation(store: Path, version: int) -> Path:
    """The folder of the next generation of a version, whose name none has had: `gen-000012`, then `gen-000012-2`."""
    number = max((_age(folder.name)[1] for folder in generations(store) if is_of(folder, version)), default=0)
    return store / "index" / (f"{GENERATION}{version:06d}" + (f"-{number + 1}" if number else ""))


def is_of(generation: Path, version: int) -> bool:
    """Whether a generation was made of this version, as its name says."""
    return _age(generation.name)[0] == version


def _age(name: str) -> tuple[int, int, str]:
    """Version and number of a generation's name, by which generations are sorted."""
    match = _NAME.fullmatch(name)
    return (int(match[1]), int(match[2] or 1), name) if match else (0, 0, name)
