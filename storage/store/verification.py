"""Verify a store: files against the manifest, parts against each other, the index against the parts."""

from __future__ import annotations

import hashlib
import shlex
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from kinedex.ops.errors import KinedexError, Remedy, StoreError
from kinedex.storage import duckdb_sql
from kinedex.storage.durable_files import names_in
from kinedex.storage.index.generations import (
    INDEX_VERSION,
    RECORD,
    current_generation,
    file_digest,
    generations,
    index_files,
    read_generation,
    wrong_sizes,
)
from kinedex.storage.index.verification import index_problems
from kinedex.storage.remedies import repair, upgrade, upgrade_with_damage
from kinedex.storage.repair.quarantine import FOLDER as QUARANTINE
from kinedex.storage.repair.quarantine import LIST, quarantines
from kinedex.storage.snapshot.label_journal import FOLDER as JOURNAL
from kinedex.storage.snapshot.label_journal import read_journals
from kinedex.storage.snapshot.manifest import AnyPart, Part, ResultPart
from kinedex.storage.snapshot.manifest_files import FOLDER, DamagedManifest, named_files, read_version, versions
from kinedex.storage.snapshot.schemas import (
    FORMAT_VERSION,
    PART_FOLDERS,
    RESULT_KINDS,
    frames_schema,
    labels_schema,
    result_schema,
    schema_problem,
)
from kinedex.storage.snapshot.snapshot import Snapshot
from kinedex.storage.store.garbage_collection import unfinished_files
from kinedex.storage.store.history import history_problems, wrong_files
from kinedex.storage.store.limb_checks import imu_problems, limb_error_problems, limb_problems
from kinedex.storage.store.reconstruction_checks import pose_problems, reconstruction_problems

Kind = Literal[
    "manifest", "frames", "takes", "content", "labels", "results", "report", "leftover", "index", "quarantine"
]


@dataclass(frozen=True)
class Finding:
    """A problem of a store, with its remedy.

    Attributes
    ----------
    file : str
        The file that has the problem, relative to the store.
    problem : str
        Description of the problem.
    remedy : Remedy
        The remedy.
    kind : str
        "manifest", "frames", "takes", "labels", "results", "report", "index", "leftover" or "quarantine"; "content" if
        takes and frames contradict each other although their files are undamaged.
    fault : bool
        True if the store is damaged; False if a file is merely out of date or superfluous.
    takes : tuple of int
        Ids of the takes whose frames or rows are affected.
    """

    file: str
    problem: str
    remedy: Remedy
    kind: Kind
    fault: bool = True
    takes: tuple[int, ...] = ()

    def __str__(self) -> str:
        return f"{self.file}: {self.problem}; {self.remedy.text}"


def verify(store: Snapshot, checked: Callable[[], object] = lambda: None) -> list[Finding]:
    """Check everything that a version of a store records about its files.

    For every part, the size, checksum, number of rows, schema, takes and order of rows are checked. The frames of every
    take must be 0, 1, …, as many as the take's row records, and no take may be live twice. Pose databases must be
    complete, and the results of takes made from depth, limb errors and their runs must be consistent. Older manifests,
    the checksums of reports, the history of runs, and the checksums, counts and bit slices of the index are checked as
    well. Leftover and quarantined files are reported.

    Parameters
    ----------
    store : Snapshot
        The version to check.
    checked : callable, optional
        Called after each part that was read.

    Returns
    -------
    list of Finding
        The problems; empty for an undamaged store. `kinedex repair` is the remedy for all of them except notes on
        earlier repairs.
    """
    return _Verification(store, checked).findings()


def damaged_frames(store: Snapshot) -> list[Part]:
    """Return the parts of frames that are missing or do not match their checksum."""
    found = []
    for part in store.manifest.frames:
        try:
            store.checked.part(part)
        except StoreError:
            found.append(part)
    return found


class _Verification:
    """The state of one verification of a version of a store."""

    def __init__(self, store: Snapshot, checked: Callable[[], object]) -> None:
        self.store = store
        self.checked = checked
        self.manifest = store.manifest
        self.is_current = store.manifest.format_version == FORMAT_VERSION
        # `repair` refuses a store of an older format
        self.remedy = repair(store.path) if self.is_current else upgrade_with_damage(store.path)
        self.counted: dict[int, int] = {}  # take → frames in the parts
        self.dropped: dict[str, int] = {}  # part → rows of dropped takes

    def findings(self) -> list[Finding]:
        parts = list(self._parts())
        return [
            *self._manifests(),
            *parts,
            *self._live_twice("frames", self.manifest.frames),
            *self._live_twice("takes", self.manifest.takes),
            *self._reports(),
            *self._leftovers(),
            *(self._found("leftover", file, problem) for file, problem in history_problems(self.store.path)),
            *self._index(sound=not parts),
            *self._quarantines(),
        ]

    def _found(self, kind: Kind, file: str, problem: str, *, fault: bool = True, takes: Iterable[int] = ()) -> Finding:
        return Finding(file, problem, self.remedy, kind, fault, tuple(takes))

    def _manifests(self) -> Iterator[Finding]:
        for version in versions(self.store.path):
            if version != self.manifest.version:
                try:
                    read_version(self.store.path, version)
                except KinedexError as fault:
                    problem = str(fault)
                    if isinstance(fault, DamagedManifest):
                        problem = f"the manifest is damaged: {fault.problem}"
                    yield self._found("manifest", f"{FOLDER}/{version:06d}.json", problem, fault=False)

    def _parts(self) -> Iterator[Finding]:
        frames = frames_schema(self.store.feature_set, self.store.rate_hz)
        sound = True
        for part in self.manifest.frames:
            found = list(self._file("frames", part, frames)) or list(self._frames_rows(part))
            sound &= not found
            yield from found
        for part in self.manifest.takes:
            found = list(self._file("takes", part, self.manifest.takes_schema)) or list(self._takes_rows(part))
            sound &= not found
            yield from found
        for labels in self.manifest.labels:
            yield from self._file("labels", labels, labels_schema())
        for journal in read_journals(self.store.path) if self.is_current else ():
            for line in journal.damaged:
                file = journal.path.relative_to(self.store.path).as_posix()
                yield self._found("labels", file, f"line {line} of the journal of labels is damaged")
        yield from self._results()
        if sound:
            yield from self._takes_against_frames()
            for part in self.manifest.frames:
                if self.dropped[part.path] != part.dropped_rows:
                    problem = f"{self.dropped[part.path]} of its rows are of dropped takes, not {part.dropped_rows}"
                    yield self._found("frames", part.path, problem, takes=part.live)

    def _results(self) -> Iterator[Finding]:
        sound = True
        for kind, parts in self.manifest.results.items():
            for result in parts:
                if kind not in RESULT_KINDS:
                    yield self._found("results", result.path, f"no kind of result is named '{kind}'")
                else:
                    found = self._file("results", result, result_schema(kind)) or self._result_rows(result)
                    sound &= not found
                    yield from found
        # the rows of tracking, reconstruction and sensors must be consistent with each other
        checks = (pose_problems, reconstruction_problems, imu_problems, limb_problems, limb_error_problems)
        for problems in checks if sound else ():
            for file, problem in problems(self.store):
                yield self._found("results", file, problem)

    def _file(self, kind: Kind, part: AnyPart, schema: pa.Schema) -> list[Finding]:
        """Check a part as a file: size, checksum, number of rows, schema."""
        problem = _file_problem(self.store.path / part.path, part, schema)
        self.checked()
        takes = part.live if isinstance(part, Part) else ()
        return [self._found(kind, part.path, problem, takes=takes)] if problem else []

    def _frames_rows(self, part: Part) -> Iterator[Finding]:
        table = pq.read_table(self.store.path / part.path, columns=["take_id", "frame"])
        takes, frames = table.column("take_id").to_numpy(), table.column("frame").to_numpy()
        if np.any(np.diff(takes) < 0):
            yield self._found("frames", part.path, "its rows are not sorted by take_id", takes=part.live)
            return
        ids, starts, lengths = np.unique(takes, return_index=True, return_counts=True)
        expected = np.arange(len(takes)) - np.repeat(starts, lengths)
        wrong = np.flatnonzero(frames != expected)
        if len(wrong):
            take, frame = int(takes[wrong[0]]), int(expected[wrong[0]])
            problem = f"take {take} lacks frame {frame}, or has it in the wrong place"
            yield self._found("frames", part.path, problem, takes=part.live)
        unknown = set(ids.tolist()) - set(part.take_ids)
        if unknown:
            problem = f"holds take {min(unknown)}, which the manifest does not list for it"
            yield self._found("frames", part.path, problem, takes=part.live)
        has = dict(zip(ids.tolist(), lengths.tolist(), strict=True))
        self.counted.update({take: has.get(take, 0) for take in part.live})
        self.dropped[part.path] = sum(has.get(take, 0) for take in part.dropped)

    def _takes_rows(self, part: Part) -> Iterator[Finding]:
        held = pq.read_table(self.store.path / part.path, columns=["take_id"]).column("take_id").to_pylist()
        if sorted(held) != sorted(part.take_ids):
            yield self._found(
                "takes", part.path, "its takes are not those that the manifest lists for it", takes=part.live
            )

    def _result_rows(self, part: ResultPart) -> list[Finding]:
        runs = pc.unique(pq.read_table(self.store.path / part.path, columns=["run"]).column("run")).to_pylist()
        problem = f"holds rows of the runs {runs}, not {part.run}"
        return [self._found("results", part.path, problem)] if runs != [part.run] else []

    def _takes_against_frames(self) -> Iterator[Finding]:
        counted, rows = self.counted, self.store.take_frames
        for take in sorted(counted.keys() ^ rows.keys()):
            lacks = "row in takes" if take in counted else "frames"
            yield self._content(f"take {take} has no {lacks}", take)
        for take in sorted(counted.keys() & rows.keys()):
            if counted[take] != rows[take]:
                yield self._content(f"take {take} has {counted[take]} frames, takes records {rows[take]}", take)
        for name, count in Counter(self.store.take_rows.column("name").to_pylist()).items():
            if count > 1:
                named = pc.equal(self.store.take_rows.column("name"), name)
                ids = self.store.take_rows.filter(named).column("take_id").to_pylist()
                yield self._content(f"{count} takes are named {name}", *ids)
        if rows and max(rows) >= self.manifest.next_take_id:
            yield self._content(f"next_take_id {self.manifest.next_take_id} is taken already")

    def _content(self, problem: str, *takes: int) -> Finding:
        return self._found("content", f"{FOLDER}/{self.manifest.version:06d}.json", problem, takes=takes)

    def _live_twice(self, what: str, parts: Sequence[Part]) -> Iterator[Finding]:
        homes = Counter(take for part in parts for take in part.live)
        for take, count in sorted(homes.items()):
            if count > 1:
                paths = [part.path for part in parts if take in part.live]
                problem = f"take {take} is live here and in {paths[0]} ({what})"
                yield self._found("content", paths[1], problem, takes=[take])

    def _reports(self) -> Iterator[Finding]:
        if self.manifest.version == max(versions(self.store.path)):
            # later runs have overwritten the reports of older versions
            for name, problem in wrong_files(self.store.path, self.manifest.stages.values()):
                yield self._found("report", name, problem, fault=problem != "is missing")

    def _leftovers(self) -> Iterator[Finding]:
        path = self.store.path
        try:
            named = {JOURNAL}.union(*(named_files(path, version) for version in versions(path)))
        except KinedexError:
            return  # reported above; the parts that a damaged manifest names are unknown
        for folder in PART_FOLDERS:
            for name in names_in(path / folder):
                if f"{folder}/{name}" not in named:
                    ours = name.startswith((".tmp-", "part-"))
                    problem = "no manifest names this file" + (", which a killed run has left" if ours else "")
                    yield self._found("leftover", f"{folder}/{name}", problem, fault=False)
        for name in unfinished_files(path):
            if name.rpartition("/")[0] not in PART_FOLDERS:
                yield self._found("leftover", name, "is unfinished: a run was killed, or is at work", fault=False)

    def _index(self, *, sound: bool) -> Iterator[Finding]:
        """Check the index; compare its content with the words of the parts only if the parts are undamaged."""
        if not generations(self.store.path):
            return
        generation = current_generation(self.store.path, self.manifest)
        if generation is None:
            yield from self._unusable_index()
            return
        record = read_generation(generation)
        assert record is not None
        folder = f"index/{generation.name}"
        files = index_files(record).items()
        wrong = [name for name, (_, xxh3) in files if file_digest(generation / name) != xxh3]
        for name in wrong:
            yield self._found("index", f"{folder}/{name}", "its content does not fit its checksum")
        try:
            for name, problem in index_problems(self.store, generation, record, words=sound) if not wrong else ():
                yield self._found("index", f"{folder}/{name}", problem)
        except (KinedexError, duckdb_sql.Error) as fault:
            yield self._found("index", folder, f"cannot be read: {str(fault).splitlines()[0]}")

    def _unusable_index(self) -> Iterator[Finding]:
        """Report why the newest index cannot be used for this version."""
        newest = generations(self.store.path)[0]
        folder = f"index/{newest.name}"
        record = read_generation(newest)
        if not self.is_current:
            problem = "the index is damaged, or that of an older kinedex, which this one cannot read"
            yield Finding(folder, problem, upgrade(self.store.path), "index", fault=False)
        elif record is None or record.index_version != INDEX_VERSION:
            yield self._found("index", f"{folder}/{RECORD}", "the index is damaged or of another version")
        elif record.content == self.manifest.content_digest():
            for name, problem in wrong_sizes(newest, record):
                yield self._found("index", f"{folder}/{name}", f"the index is damaged: the file {problem}")
        else:
            yield self._found("index", folder, "the index is stale: the takes have changed since", fault=False)

    def _quarantines(self) -> Iterator[Finding]:
        for one in quarantines(self.store.path):
            folder = f"{QUARANTINE}/{one.name}"
            look = Remedy(f"{LIST} there lists them; remove the folder once nothing of it is needed")
            if one.files or one.takes:
                problem = f"keeps {len(one.files)} files that were damaged and lists {len(one.takes)} takes as lost"
                yield Finding(folder, problem, look, "quarantine", fault=False)
            for run in one.runs:
                if not run.done:
                    command = run.command(self.store.path)
                    again = Remedy(f"`{shlex.join(command)}` makes them again", command)
                    problem = f"the results of {', '.join(run.stages)} were damaged and are not there"
                    yield Finding(folder, problem, again, "quarantine", fault=False)


def _file_problem(file: Path, part: AnyPart, schema: pa.Schema) -> str | None:
    """Return the problem of the file of a part; None if there is none."""
    try:
        size = file.stat().st_size
        if size != part.bytes:
            return f"has {size} bytes, the manifest records {part.bytes}"
        with open(file, "rb") as content:
            sha256 = hashlib.file_digest(content, "sha256").hexdigest()
        if sha256 != part.sha256:
            return "its content does not fit its checksum"
        metadata = pq.read_metadata(file)
    except FileNotFoundError:
        return "is missing"
    except (OSError, pa.ArrowException) as fault:
        return f"cannot be read: {str(fault).splitlines()[0]}"
    if metadata.num_rows != part.rows:
        return f"has {metadata.num_rows} rows, the manifest records {part.rows}"
    return schema_problem(metadata.schema.to_arrow_schema(), schema)
