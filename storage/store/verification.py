"""Verification of a store: files against the manifest, parts against each other, the index against the parts."""

from __future__ import annotations

import hashlib
import os
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from kinedex.ops.errors import KinedexError
from kinedex.storage import duck
from kinedex.storage.index.generations import (
    BUILD,
    INDEX_VERSION,
    current_generation,
    file_digest,
    generations,
    index_files,
    read_generation,
    wrong_sizes,
)
from kinedex.storage.index.verification import index_problems
from kinedex.storage.snapshot.manifest import FOLDER, AnyPart, Part, ResultPart, named_files, read_version, versions
from kinedex.storage.snapshot.schemas import (
    PART_FOLDERS,
    RESULT_KINDS,
    frames_schema,
    labels_schema,
    result_schema,
    schema_problem,
)
from kinedex.storage.snapshot.snapshot import Snapshot
from kinedex.storage.store.report_sums import wrong_files


@dataclass(frozen=True)
class Finding:
    """A problem of a store, with its remedy.

    Attributes
    ----------
    file : str
        The file that has the problem, relative to the store.
    problem : str
        Description of the problem.
    remedy : str
        The way out.
    fault : bool
        True if the store is damaged; False if a file is merely out of date or superfluous.
    """

    file: str
    problem: str
    remedy: str
    fault: bool = True

    def __str__(self) -> str:
        return f"{self.file}: {self.problem}; {self.remedy}"


_COPY = "bring the file back from a copy of the store, or ingest the sources into a new store"
_RESULT = "run the stage that made it again"


def verify(store: Snapshot) -> list[Finding]:
    """Check everything that a version of a store records about its files.

    These are every part's size, checksum, row count, schema, takes and order of rows; that the frames of every take
    are 0, 1, …, as many as its row in takes records; that no take is live twice; older manifests; the checksums of
    reports; leftover files; and the index's checksums, counts and bit slices.

    Parameters
    ----------
    store : Snapshot
        The version to check.

    Returns
    -------
    list of Finding
        The problems, empty for a sound store.
    """
    parts = list(_parts(store))
    return [
        *_manifests(store),
        *parts,
        *_live_twice("frames", store.manifest.frames),
        *_live_twice("takes", store.manifest.takes),
        *_reports(store),
        *_leftovers(store),
        *_index(store, sound=not parts),
    ]


def _manifests(store: Snapshot) -> Iterator[Finding]:
    for version in versions(store.path):
        if version != store.manifest.version:
            try:
                read_version(store.path, version)
            except KinedexError as fault:
                problem = str(fault).removeprefix(f"{store.path}/").split(": ", 1)[-1].split(";")[0]
                yield Finding(f"{FOLDER}/{version:06d}.json", problem, "move this old version away", fault=False)


def _parts(store: Snapshot) -> Iterator[Finding]:
    frames = frames_schema(store.feature_set, store.rate_hz)
    counted: dict[int, int] = {}
    dropped: dict[str, int] = {}
    sound = True
    for part in store.manifest.frames:
        found = list(_file(store, part, frames, _COPY)) or list(_frames_rows(store, part, counted, dropped))
        sound &= not found
        yield from found
    for part in store.manifest.takes:
        found = list(_file(store, part, store.manifest.takes_schema, _COPY)) or list(_takes_rows(store, part))
        sound &= not found
        yield from found
    for labels in store.manifest.labels:
        yield from _file(store, labels, labels_schema(), _COPY)
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


def _file(store: Snapshot, part: AnyPart, schema: pa.Schema, remedy: str) -> list[Finding]:
    """Check a part as a file: size, checksum, number of rows, schema."""
    file = store.path / part.path
    try:
        size = file.stat().st_size
        if size != part.bytes:
            return [Finding(part.path, f"has {size} bytes, the manifest records {part.bytes}", remedy)]
        with open(file, "rb") as content:
            if hashlib.file_digest(content, "sha256").hexdigest() != part.sha256:
                return [Finding(part.path, "its content does not fit its checksum", remedy)]
        metadata = pq.read_metadata(file)
    except FileNotFoundError:
        return [Finding(part.path, "is missing", remedy)]
    except (OSError, pa.ArrowException) as fault:
        return [Finding(part.path, f"cannot be read: {str(fault).splitlines()[0]}", remedy)]
    if metadata.num_rows != part.rows:
        return [Finding(part.path, f"has {metadata.num_rows} rows, the manifest records {part.rows}", remedy)]
    problem = schema_problem(metadata.schema.to_arrow_schema(), schema)
    return [Finding(part.path, problem, remedy)] if problem else []


def _frames_rows(store: Snapshot, part: Part, counted: dict[int, int], dropped: dict[str, int]) -> Iterator[Finding]:
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


def _takes_rows(store: Snapshot, part: Part) -> Iterator[Finding]:
    held = pq.read_table(store.path / part.path, columns=["take_id"]).column("take_id").to_pylist()
    if sorted(held) != sorted(part.take_ids):
        yield Finding(part.path, "its takes are not those that the manifest lists for it", _COPY)


def _result_rows(store: Snapshot, part: ResultPart) -> list[Finding]:
    runs = pc.unique(pq.read_table(store.path / part.path, columns=["run"]).column("run")).to_pylist()
    return [Finding(part.path, f"holds rows of the runs {runs}, not {part.run}", _RESULT)] if runs != [part.run] else []


def _takes_against_frames(store: Snapshot, counted: dict[int, int]) -> Iterator[Finding]:
    manifest = f"{FOLDER}/{store.manifest.version:06d}.json"
    rows = store.take_frames
    for take in sorted(counted.keys() ^ rows.keys()):
        lacks = "row in takes" if take in counted else "frames"
        yield Finding(manifest, f"take {take} has no {lacks}", _COPY)
    for take in sorted(counted.keys() & rows.keys()):
        if counted[take] != rows[take]:
            yield Finding(manifest, f"take {take} has {counted[take]} frames, takes records {rows[take]}", _COPY)
    for name, count in Counter(store.take_rows.column("name").to_pylist()).items():
        if count > 1:
            yield Finding(manifest, f"{count} takes are named {name}", _COPY)
    if rows and max(rows) >= store.manifest.next_take_id:
        yield Finding(manifest, f"next_take_id {store.manifest.next_take_id} is taken already", _COPY)


def _live_twice(what: str, parts: Sequence[Part]) -> Iterator[Finding]:
    homes = Counter(take for part in parts for take in part.live)
    for take, count in sorted(homes.items()):
        if count > 1:
            paths = [part.path for part in parts if take in part.live]
            yield Finding(paths[1], f"take {take} is live here and in {paths[0]} ({what})", _COPY)


def _reports(store: Snapshot) -> Iterator[Finding]:
    if store.manifest.version == max(versions(store.path)):
        # later runs have written over the reports of older versions
        for name, problem in wrong_files(store.path, store.manifest.stages.values()):
            yield Finding(name, problem, _RESULT, fault=problem != "is missing")


def _leftovers(store: Snapshot) -> Iterator[Finding]:
    try:
        named = set().union(*(named_files(store.path, version) for version in versions(store.path)))
    except KinedexError:
        return  # reported above; the parts that a damaged manifest names are not known
    for folder in PART_FOLDERS:
        for name in sorted(os.listdir(store.path / folder)) if (store.path / folder).is_dir() else ():
            if f"{folder}/{name}" not in named:
                remedy = "a killed run has left it, and the next writer removes it" if _ours(name) else "remove it"
                yield Finding(f"{folder}/{name}", "no manifest names this file", remedy, fault=False)


def _ours(name: str) -> bool:
    return name.startswith((".tmp-", "part-"))


def _index(store: Snapshot, *, sound: bool) -> Iterable[Finding]:
    """Check the index; its content is compared with the words of the parts only where these are sound."""
    if not generations(store.path):
        return
    generation = current_generation(store.path, store.manifest)
    if generation is None:
        yield from _unusable_index(store)
        return
    record = read_generation(generation)
    assert record is not None
    folder = f"index/{generation.name}"
    wrong = [name for name, (_, xxh3) in index_files(record).items() if file_digest(generation / name) != xxh3]
    for name in wrong:
        yield Finding(f"{folder}/{name}", "its content does not fit its checksum", BUILD)
    # a build keeps an index whose checksums fit
    remove = f"remove the folder {folder}, then {BUILD}"
    try:
        for name, problem in index_problems(store, generation, record, words=sound) if not wrong else ():
            yield Finding(f"{folder}/{name}", problem, remove)
    except (KinedexError, duck.Error) as fault:
        yield Finding(folder, f"cannot be read: {str(fault).splitlines()[0]}", remove)


def _unusable_index(store: Snapshot) -> Iterator[Finding]:
    """Report why the newest index does not serve this version."""
    newest = generations(store.path)[0]
    folder = f"index/{newest.name}"
    record = read_generation(newest)
    if record is None or record.index_version != INDEX_VERSION:
        yield Finding(folder, "the index is damaged or of another version", BUILD)
    elif record.content == store.manifest.content_digest():
        for name, problem in wrong_sizes(newest, record):
            yield Finding(f"{folder}/{name}", f"the index is damaged: the file {problem}", BUILD)
    else:
        yield Finding(folder, "the index is stale: the takes have changed since", BUILD, fault=False)
