"""Find the changes of a source since a store read it: files that are new, changed, moved or removed."""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import pyarrow as pa

from kinedex.catalog.capture_sessions import is_undecided
from kinedex.catalog.feature_definitions import PRIMITIVES
from kinedex.catalog.features import FeatureSet
from kinedex.catalog.skeletons.mappings import Mappings
from kinedex.ops.errors import KinedexError, SourceError
from kinedex.pipelines.engine.code_digest import code_digest, part_digest, plugin_digest
from kinedex.pipelines.ingestion.analysis import analyse, known_features, measured_quality, unknown_feature_warnings
from kinedex.pipelines.ingestion.file_batches import Task
from kinedex.pipelines.ingestion.file_failures import Failure, file_failure, scan_failure
from kinedex.pipelines.ingestion.known_files import (
    FileContent,
    KnownFile,
    KnownFiles,
    Naming,
    Row,
    SkeletonSums,
    TakeNames,
    file_name,
    file_names,
    person_name,
)
from kinedex.pipelines.ingestion.metadata import EVERYWHERE, missed_patterns
from kinedex.storage.formats.motion.reader import Reader, ReadSettings
from kinedex.storage.formats.motion.reader_table import persons_of, read_body, readers_by_ending
from kinedex.storage.formats.motion.scanned_files import SkippedFile, SourceFile
from kinedex.storage.formats.motion.sources import Scan, path_groups
from kinedex.storage.snapshot.manifest import Manifest
from kinedex.storage.snapshot.schemas import RECORDED_FORMATS
from kinedex.storage.store.verification import damaged_frames
from kinedex.storage.store.writer import StoreWriter

KIND = "files whose takes were removed (`kinedex takes readmit` reads them again)"
"""The description of files whose takes were removed, in the list of skipped files."""


@dataclass(frozen=True)
class SourceChanges:
    """The changes of a source.

    Attributes
    ----------
    tasks : list of Task
        The files to read, in the order of their take ids.
    unchanged : dict of str to KnownFile
        Path → the known file, for files that need not be read.
    damaged : list of int
        The ids of takes whose part of the store is damaged.
    restated : list of dict
        New rows of unchanged takes whose file has another path or modification time.
    gone : list of int
        The ids of takes whose file no longer exists.
    surplus : list of int
        The ids of takes of persons that their unchanged files do not contain.
    renamed : list of (int, str, str)
        The id, old name and new name of takes whose file would get another name.
    failures : list of Failure
        Files that cannot be read or named.
    skeletons : pyarrow.Table
        Rows of `skeleton_files`.
    names : TakeNames
        The names of all takes, to which those of persons are added.
    known : dict of str to KnownFile
        Path → the file from which the store has takes.
    by_path : dict of str to str
        Path → name of new files that are named by their paths, because others have the same stem.
    recipes : dict of str to str
        Path → recipe of the files.
    undecided : list of Task
        Unchanged files whose axis or rate may change, because other files of their folders decide it.
    """

    tasks: list[Task]
    unchanged: dict[str, KnownFile]
    damaged: list[int]
    restated: list[Row]
    gone: list[int]
    surplus: list[int]
    renamed: list[tuple[int, str, str]]
    failures: list[Failure]
    skeletons: pa.Table
    names: TakeNames
    known: dict[str, KnownFile]
    by_path: dict[str, str]
    recipes: dict[str, str]
    undecided: list[Task]


def compare_source(
    writer: StoreWriter,
    feature_set: FeatureSet,
    mappings: Mappings,
    found: Scan,
    naming: Naming,
    patterns: Sequence[str],
    given: ReadSettings,
    given_skeletons: Mapping[str, str],
) -> SourceChanges:
    """Compare a source with a store, by size and modification time; only files that seem to be changed are read.

    A file is identified by its path, so that its takes keep their names, or by its content if it was moved. A file
    whose take is in a damaged part of the store counts as changed.

    Parameters
    ----------
    writer : StoreWriter
        The writer of the store, which gives new takes their ids.
    feature_set : FeatureSet
        The features that takes are analysed with.
    mappings : Mappings
        The skeleton mappings.
    found : Scan
        The files of the source.
    naming : {"stem", "path", "file"}
        The rule for the names of takes.
    patterns : sequence of str
        Regular expressions for paths, whose named groups become columns.
    given : ReadSettings
        Settings of the user for reading files.
    given_skeletons : mapping of str to str
        The skeleton files that the user gives motion files, see `Scan.chosen_skeleton`.
    """
    work = _Comparison(writer, found, naming)
    work.find_files()
    work.name_files()
    damaged = {take for part in damaged_frames(writer.store) for take in part.live}
    compiled = [re.compile(pattern) for pattern in patterns]
    made_by = recipes(feature_set, mappings, given)
    skeleton_sums = SkeletonSums(writer.store.result("skeleton_files"))
    for motion in found.motions:
        if motion.path not in work.names:
            continue
        try:
            skeleton, doubts = found.chosen_skeleton(motion, given_skeletons)
            groups = path_groups(motion.path, compiled)
            of_skeleton = skeleton_sums.of(skeleton) if skeleton is not None else ""
            made = work.recipes[motion.path] = recipe_of(made_by[motion.format], of_skeleton)
            warnings = (*missed_patterns(groups, compiled), *doubts)
            task = Task(work.names[motion.path], -1, motion, skeleton, dict(groups or {}), made, warnings)
            if not work.is_unchanged(motion, partial(has_recipe, made_by[motion.format], of_skeleton), damaged):
                work.tasks.append(task)
            elif (file := work.unchanged[motion.path]).place == (motion.root, motion.path):
                kept = [row for row in file.rows if is_undecided(row) and not file.rows_at(motion, [row])]
                work.undecided += [_task_of(row, task) for row in kept]
        except SourceError as fault:
            work.failures.append(file_failure(motion, fault))
    return work.result(sorted(damaged), skeleton_sums.table())


class _Comparison:
    """A comparison, in progress, of the files of a source with the takes of a store."""

    def __init__(self, writer: StoreWriter, found: Scan, naming: Naming) -> None:
        self.writer = writer
        self.found = found
        self.naming = naming
        self.root = found.motions[0].root
        rows = writer.store.take_rows.to_pylist()
        self.files = KnownFiles(rows)
        self.tracks = [row["name"] for row in rows if row["format"] in RECORDED_FORMATS]
        self.known: dict[str, KnownFile] = {}
        self.places: set[tuple[str, str]] = set()
        self.contents = {motion.path: FileContent(motion) for motion in found.motions}
        self.motions = list(found.motions)
        self.names: dict[str, str] = {}
        self.take_names = TakeNames(naming, {})
        self.by_path: dict[str, str] = {}
        self.recipes: dict[str, str] = {}
        self.tasks: list[Task] = []
        self.undecided: list[Task] = []
        self.unchanged: dict[str, KnownFile] = {}
        self.restated: list[Row] = []
        self.surplus: list[int] = []
        self.renamed: list[tuple[int, str, str]] = []
        self.failures = [scan_failure(refused) for refused in found.refused]

    def find_files(self) -> None:
        """Match the files of the source with the files of the store's takes, first by path, then by content."""
        refused: set[str] = set()
        for motion in self.found.motions:
            if (file := self.files.at_place(motion)) is not None:
                self.known[motion.path] = file
        self.places = {file.place for file in self.known.values()}
        for motion in self.found.motions:
            if motion.path in self.known:
                continue
            try:
                content = self.contents[motion.path]
                file = self.files.of_same_content(content, file_names(self.naming, motion.path), self.places)
            except SourceError as fault:
                self.failures.append(file_failure(motion, fault))
                refused.add(motion.path)
                continue
            if file is not None and self._keeps_names(file):
                self.known[motion.path] = file
                self.places.add(file.place)
        self.motions = [motion for motion in self.found.motions if motion.path not in refused]

    def name_files(self) -> None:
        """Name the files; known files keep their names, unless the naming rule has changed."""
        paths = {file.place: path for path, file in self.known.items()}
        owners = {row["name"]: paths.get(file.place, "") for file in self.files for row in file.rows}
        owners |= dict.fromkeys(self.tracks, "")
        keep = {path: file.name for path, file in self.known.items() if self._keeps_names(file)}
        names = TakeNames(self.naming, owners)
        self.names = names.add_files([motion.path for motion in self.motions], keep)
        self.take_names = names
        for motion in self.motions:
            path = motion.path
            if path not in self.names:
                taken = f"other takes have every name that its take could have, such as '{path}'; rename it"
                self.failures.append(file_failure(motion, SourceError(motion.absolute, taken)))
            elif path not in self.known and self.names[path] != file_names(self.naming, path)[0]:
                self.by_path[path] = self.names[path]
        for path, file in list(self.known.items()):
            if path in keep or path not in self.names:
                continue
            name = self.names[path]
            rows = tuple(row for row in file.rows if file_name(row) == name)
            self.known.pop(path)
            if rows:
                self.known[path] = replace(file, rows=rows)
            others = (row for row in file.rows if row not in rows)
            self.renamed += [
                (row["take_id"], row["name"], person_name(name, row.get("person") or "")) for row in others
            ]

    def _keeps_names(self, file: KnownFile) -> bool:
        """Return whether the takes of a file were named by the current rule, or have the names that it would give."""
        source = self.writer.manifest.sources.get(file.root)
        same_rule = source is not None and source.settings.get("name") == self.naming
        return same_rule or file.name == file_names(self.naming, file.path)[0]

    def is_unchanged(self, motion: SourceFile, is_made_so: Callable[[Row], bool], damaged: set[int]) -> bool:
        """Return whether a file need not be read; if so, add the new rows of its takes to `restated`."""
        file = self.known.get(motion.path)
        rows = file.current_rows(self.contents[motion.path], is_made_so, damaged) if file is not None else ()
        if file is None or not rows:
            return False
        self.unchanged[motion.path] = file
        self.restated += file.rows_at(motion, rows)
        if not file.is_elsewhere(motion):
            self.surplus += [row["take_id"] for row in file.rows if row not in rows]
        return True

    def result(self, damaged: list[int], skeletons: pa.Table) -> SourceChanges:
        """Return the changes, after all files have been compared."""
        ids = self.writer.assign_take_ids(task.name for task in self.tasks)
        tasks = sorted((replace(task, take_id=ids[task.name]) for task in self.tasks), key=lambda task: task.take_id)
        # the roots of this archive before and after it was moved
        others = (file for path, file in self.known.items() if path == file.path and file.root != self.root)
        former = {self.root, *(file.root for file in others if not file.is_there)}
        here = {(self.root, motion.path) for motion in self.found.motions} | self.places
        absent = [file for file in self.files if file.root in former and file.place not in here]
        vanished = [file for file in absent if file.root == self.root or not file.is_there]
        gone = [row["take_id"] for file in vanished if not self.found.hidden(file.path) for row in file.rows]
        return SourceChanges(
            tasks, self.unchanged, damaged, self.restated, gone, self.surplus, self.renamed, self.failures, skeletons,
            self.take_names, self.known, self.by_path, self.recipes, self.undecided,
        )  # fmt: skip


def _task_of(row: Row, task: Task) -> Task:
    """Return the task that reads an unchanged take again."""
    person, persons = row.get("person"), row.get("persons") or 1
    return replace(task, take_id=row["take_id"], name=row["name"], person=person, persons=persons)


def recipe_of(made_by: str, skeleton: str, groups: Mapping[str, str] | None = None) -> str:
    """Return the recipe of a take: a hash of everything that its frames depend on, except its file.

    Parameters
    ----------
    made_by : str
        The recipe of its format, one of `recipes`.
    skeleton : str
        The checksum of its skeleton file; empty if it has none.
    groups : mapping of str to str, optional
        The named groups of its path, which were part of the recipe in earlier development versions.
    """
    return digest([made_by, skeleton, sorted((groups or {}).items())])


def has_recipe(made_by: str, skeleton: str, row: Mapping[str, Any]) -> bool:
    """Return whether a take was made with a recipe, the hash of what it depends on; earlier forms count as well."""
    made = row["recipe"].partition(" ")[0]
    if made == recipe_of(made_by, skeleton):
        return True
    groups = {name: row[name] for name in EVERYWHERE if row[name] is not None} | json.loads(row["groups"] or "{}")
    return bool(made == recipe_of(made_by, skeleton, groups))


def recipes(feature_set: FeatureSet, mappings: Mappings, settings: ReadSettings) -> dict[str, str]:
    """Return, for each file extension, a hash of everything that its takes depend on, except their files.

    If the hash changes, takes are read again. The format of an .npz file is known only when it is read, so the settings
    of all readers of an extension count.
    """
    code = code_digest(read_body, persons_of, analyse, unknown_feature_warnings, known_features, measured_quality)
    return {
        ending[1:]: digest(
            [features_digest(feature_set), code, *(_reader_recipe(reader, mappings, settings) for reader in readers)]
        )
        for ending, readers in readers_by_ending().items()
    }


def _reader_recipe(reader: Reader, mappings: Mappings, settings: ReadSettings) -> list[object]:
    plugin = plugin_digest(reader.distribution, type(reader)) if reader.distribution else ""
    return [mappings.digest(reader.format), reader.relevant_settings(settings), plugin]


def features_digest(feature_set: FeatureSet) -> str:
    """Return a hash of a feature set, and of the plugins that define its primitives."""
    plugins = [part_digest(PRIMITIVES, name) for name in feature_set.plugin_primitives]
    return digest([feature_set.digest, *plugins]) if plugins else feature_set.digest


def digest(parts: object) -> str:
    """Return a short hash of JSON values."""
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:16]


def removed_below(source: str | Path, manifest: Manifest | None) -> tuple[str, ...]:
    """Return the paths of the removed files of a source folder, sorted."""
    root = os.path.realpath(Path(source).expanduser())
    return () if manifest is None else manifest.removed_files.get(root, ())


def without_removed(found: Scan, manifest: Manifest | None) -> Scan:
    """Return a scan without the motion files whose takes were removed; they are listed as skipped.

    Raises
    ------
    KinedexError
        No other motion file remains.
    """
    root = found.motions[0].root
    removed = frozenset(removed_below(root, manifest))
    if not removed:
        return found
    motions = tuple(motion for motion in found.motions if motion.path not in removed)
    if not motions:
        raise KinedexError(
            f"{root}: the takes of all its motion files were removed from the store; `kinedex takes readmit` lists them"
        )
    passed = [SkippedFile(motion.path, KIND) for motion in found.motions if motion.path in removed]
    others = tuple(sorted((*found.passed_over, *passed), key=lambda one: one.path))
    return replace(found, motions=motions, passed_over=others)
