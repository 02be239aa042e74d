"""Checking a store: every file against the manifest, the parts against each other, the index against the parts."""

from __future__ import annotations

import hashlib
import os
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from kinedex.ops.errors import KinedexError
from kinedex.storage import index
from kinedex.storage.index.checks import problems
from kinedex.storage.index.generations import generations
from kinedex.storage.sql import duck
from kinedex.storage.store.manifest import FOLDER, Part, ResultPart, named_files, read_version, versions
from kinedex.storage.store.schemas import RESULT_KINDS, frames_schema, result_schema, schema_problem, takes_schema
from kinedex.storage.store.store import Store


@dataclass(frozen=True)
class Finding:
    """Something about a store that is not as it should be.

    file: the file it is about, relative to the store. remedy: the way out.
    fault: whether the store is damaged; otherwise something is merely out of date or in the way.
    """

    file: str
    problem: str
    remedy: str
    fault: bool = True

    def __str__(self) -> str:
        return f"{self.file}: {self.problem}; {self.remedy}"


_COPY = "bring the file back from a copy of the store, or ingest the sources into a new store"
_RESULT = "run the stage that made it again"


def verify(store: Store) -> list[Finding]:
    """Check everything that the newest version of a store says of itself.

    Every part's size, checksum, row count, schema, takes, order of rows; that the frames of every take are 0, 1, …, as
    many as the take says; that no take is live twice; older manifests; leftover files; the index's checksums, counts
    and bit slices.

    Returns
    -------
    The findings, empty for a sound store.
    """
    parts = list(_parts(store))
    return [
        *_manifests(store),
        *parts,
        *_live_twice("frames", store.manifest.frames),
        *_live_twice("takes", store.manifest.takes),
        *_leftovers(store),
        *_index(store, sound=not parts),
    ]


def _manifests(store: Store) -> Iterator[Finding]:
    for version in versions(store.path):
        if version != store.manifest.version:
            try:
                read_version(store.path, version)
            except KinedexError as fault:
                problem = str(fault).removeprefix(f"{store.path}/").split(": ", 1)[-1].split(";")[0]
                yield Finding(f"{FOLDER}/{version:06d}.json", problem, "move this old version away", fault=False)


def _parts(store: Store) -> Iterator[Finding]:
    frames = frames_schema(store.feature_set, store.rate_hz)
    counted: dict[int, int] = {}
    dropped: dict[str, int] = {}
    sound = True
    for part in store.manifest.frames:
        found = list(_file(store, part, frames, _COPY)) or list(_frames_rows(store, part, counted, dropped))
        sound &= not found
        yield from found
    for part in store.manifest.takes:
        found = list(_file(store, part, takes_schema(), _COPY)) or list(_takes_rows(store, part))
        sound &= not found
        yield from found
    for kind, parts in store.manifest.results.items():
        for result in parts:
            if kind not in RESULT_KINDS:
                yield Finding(result.path, f"no kind of result is named '{kind}'", _RESULT)
            else:
                yield from _file(store, result, result_schema(kind), _RESULT) or _result_rows(store, result)
    if sound:
        yield from _takes_against_frames(store, counted)
        for part in store.manifest.frames:
            if dropped[part.path] != part.dropped_rows:
                problem = f"{dropped[part.path]} of its rows are of dropped takes, not {part.dropped_rows}"
                yield Finding(part.path, problem, _COPY)


def _file(store: Store, part: Part | ResultPart, schema: pa.Schema, remedy: str) -> list[Finding]:
    """What is wrong with a part as a file; its rows are looked at only where nothing is."""
    file = store.path / part.path
    try:
        size = file.stat().st_size
        if size != part.bytes:
            return [Finding(part.path, f"has {size} bytes, the manifest says {part.bytes}", remedy)]
        with open(file, "rb") as content:
            if hashlib.file_digest(content, "sha256").hexdigest() != part.sha256:
                return [Finding(part.path, "its content does not fit its checksum", remedy)]
        metadata = pq.read_metadata(file)
    except FileNotFoundError:
        return [Finding(part.path, "is missing", remedy)]
    except (OSError, pa.ArrowException) as fault:
        return [Finding(part.path, f"cannot be read: {str(fault).splitlines()[0]}", remedy)]
    if metadata.num_rows != part.rows:
        return [Finding(part.path, f"has {metadata.num_rows} rows, the manifest says {part.rows}", remedy)]
    problem = schema_problem(metadata.schema.to_arrow_schema(), schema)
    return [Finding(part.path, problem, remedy)] if problem else []


def _frames_rows(store: Store, part: Part, counted: dict[int, int], dropped: dict[str, int]) -> Iterator[Finding]:
    table = pq.read_table(store.path / part.path, columns=["take_id", "frame"])
    takes, frames = table.column("take_id").to_numpy(), table.column("frame").to_numpy()
    if np.any(np.diff(takes) < 0):
        yield Finding(part.path, "its rows are not sorted by take_id", _COPY)
        return
    ids, starts, lengths = np.unique(takes, return_index=True, return_counts=True)
    expected = np.arange(len(takes)) - np.repeat(starts, lengths)
    wrong = np.flatnonzero(frames != expected)
    if len(wrong):
        take, frame = int(takes[wrong[0]]), int(expected[wrong[0]])
        yield Finding(part.path, f"take {take} lacks frame {frame}, or has it in the wrong place", _COPY)
    unknown = set(ids.tolist()) - set(part.take_ids)
    if unknown:
        yield Finding(part.path, f"holds take {min(unknown)}, which the manifest does not list for it", _COPY)
    has = dict(zip(ids.tolist(), lengths.tolist(), strict=True))
    counted.update({take: has.get(take, 0) for take in part.live})
    dropped[part.path] = sum(has.get(take, 0) for take in part.dropped)


def _takes_rows(store: Store, part: Part) -> Iterator[Finding]:
    held = pq.read_table(store.path / part.path, columns=["take_id"]).column("take_id").to_pylist()
    if sorted(held) != sorted(part.take_ids):
        yield Finding(part.path, "its takes are not those that the manifest lists for it", _COPY)


def _result_rows(store: Store, part: ResultPart) -> list[Finding]:
    runs = pc.unique(pq.read_table(store.path / part.path, columns=["run"]).column("run")).to_pylist()
    return [Finding(part.path, f"holds rows of the runs {runs}, not {part.run}", _RESULT)] if runs != [part.run] else []


def _takes_against_frames(store: Store, counted: dict[int, int]) -> Iterator[Finding]:
    manifest = f"{FOLDER}/{store.manifest.version:06d}.json"
    takes = store.takes()
    rows = dict(zip(takes["take_id"].to_list(), takes["frames"].to_list(), strict=True))
    for take in sorted(counted.keys() ^ rows.keys()):
        lacks = "row in takes" if take in counted else "frames"
        yield Finding(manifest, f"take {take} has no {lacks}", _COPY)
    for take in sorted(counted.keys() & rows.keys()):
        if counted[take] != rows[take]:
            yield Finding(manifest, f"take {take} has {counted[take]} frames, takes says {rows[take]}", _COPY)
    for name, count in takes["name"].value_counts().filter(pl.col("count") > 1).iter_rows():
        yield Finding(manifest, f"{count} takes are named {name}", _COPY)
    if rows and max(rows) >= store.manifest.next_take_id:
        yield Finding(manifest, f"next_take_id {store.manifest.next_take_id} is taken already", _COPY)


def _live_twice(what: str, parts: Sequence[Part]) -> Iterator[Finding]:
    homes = Counter(take for part in parts for take in part.live)
    for take, count in sorted(homes.items()):
        if count > 1:
            paths = [part.path for part in parts if take in part.live]
            yield Finding(paths[1], f"take {take} is live here and in {paths[0]} ({what})", _COPY)


def _leftovers(store: Store) -> Iterator[Finding]:
    try:
        named = set().union(*(named_files(store.path, version) for version in versions(store.path)))
    except KinedexError:
        return  # reported above; what a damaged manifest names is not known
    for folder in ("frames", "takes", *(f"results/{kind}" for kind in RESULT_KINDS)):
        for name in sorted(os.listdir(store.path / folder)) if (store.path / folder).is_dir() else ():
            if f"{folder}/{name}" not in named:
                remedy = "the next writer removes what a killed run has left" if _ours(name) else "remove it"
                yield Finding(f"{folder}/{name}", "no manifest names this file", remedy, fault=False)


def _ours(name: str) -> bool:
    return name.startswith((".tmp-", "part-"))


def _index(store: Store, *, sound: bool) -> Iterable[Finding]:
    """What is wrong with the index; it is compared with the words of the parts only where these are sound."""
    published = generations(store.path)
    if not published:
        return
    generation = index.current(store.path, store.manifest)
    if generation is None:
        newest = f"index/{published[0].name}"
        says = index.read_generation(published[0])
        if says is None or says.index_version != index.INDEX_VERSION:
            yield Finding(newest, "the index is damaged or of another version", index.BUILD)
        elif says.content == store.manifest.content_digest():
            for name, problem in index.wrong_sizes(published[0], says):
                yield Finding(f"{newest}/{name}", f"the index is damaged: the file {problem}", index.BUILD)
        else:
            yield Finding(newest, "the index is stale: the takes have changed since", index.BUILD, fault=False)
        return
    says = index.read_generation(generation)
    assert says is not None
    folder = f"index/{generation.name}"
    wrong = [name for name, (_, sha256) in index.files(says).items() if index.file_digest(generation / name) != sha256]
    for name in wrong:
        yield Finding(f"{folder}/{name}", "its content does not fit its checksum", index.BUILD)
    # the checksums fit, so that a build would find nothing to make anew
    remove = f"remove the folder {folder}, then {index.BUILD}"
    try:
        for name, problem in problems(store, generation, says, words=sound) if not wrong else ():
            yield Finding(f"{folder}/{name}", problem, remove)
    except (KinedexError, duck.Error) as fault:
        yield Finding(folder, f"cannot be read: {str(fault).splitlines()[0]}", remove)
