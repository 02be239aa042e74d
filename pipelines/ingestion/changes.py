"""Changes of a source since a store read it: files that are new, changed, moved or gone."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import pyarrow as pa

from kinedex.catalog.features import PRIMITIVES, FeatureSet
from kinedex.catalog.skeletons.mappings import Mappings
from kinedex.ops.errors import SourceError
from kinedex.pipelines.engine.code_digest import code_digest, part_digest, plugin_digest
from kinedex.pipelines.ingestion.analysis import analyse, blind, known_features
from kinedex.pipelines.ingestion.failures import Failure, failure, refusal
from kinedex.pipelines.ingestion.file_batches import Task
from kinedex.pipelines.ingestion.skeleton_checksums import SkeletonSums
from kinedex.storage.formats.motion.reader import Reader, ReadSettings
from kinedex.storage.formats.motion.reader_table import read_body, readers_by_ending
from kinedex.storage.formats.motion.sources import Scan, SourceFile, checksum, path_groups
from kinedex.storage.store.verification import damaged_frames
from kinedex.storage.store.writer import StoreWriter

Naming = Literal["stem", "path", "file"]
"""The name of a take: the stem of its file, its path without the ending, or with it."""


@dataclass(frozen=True)
class Changes:
    """The changes of a source.

    Attributes
    ----------
    tasks : list of Task
        The files to read, in the order of their take ids.
    unchanged : int
        The number of unchanged files.
    damaged : list of int
        The ids of takes whose part of the store is damaged.
    restated : list of dict
        New rows of unchanged takes whose file has another place or time.
    gone : list of int
        The ids of takes without a file.
    renamed : list of (int, str, str)
        Id, old and new name of takes whose file would get another name.
    failures : list of Failure
        Files that cannot be read or named.
    skeletons : pyarrow.Table
        Rows of `skeleton_files`.
    """

    tasks: list[Task]
    unchanged: int
    damaged: list[int]
    restated: list[dict[str, Any]]
    gone: list[int]
    renamed: list[tuple[int, str, str]]
    failures: list[Failure]
    skeletons: pa.Table


def compare(
    writer: StoreWriter,
    feature_set: FeatureSet,
    mappings: Mappings,
    found: Scan,
    naming: Naming,
    patterns: Sequence[str],
    given: ReadSettings,
) -> Changes:
    """Compare a source with a store, by size and time; only files that seem to be changed are read for it.

    A file whose take lies in a damaged part of the store counts as changed.

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
    given : Given
        Settings of the user for reading files.
    """
    known = {row["name"]: row for row in writer.store.takes().iter_rows(named=True)}
    damaged = {take for part in damaged_frames(writer.store) for take in part.live}
    compiled = [re.compile(pattern) for pattern in patterns]
    made_by = recipes(feature_set, mappings, given)
    skeleton_sums = SkeletonSums(writer.store.result("skeleton_files"))
    tasks: list[Task] = []
    restated: list[dict[str, Any]] = []
    failures = [refusal(refused) for refused in found.refused]
    unchanged = 0
    former = {found.motions[0].root}  # the roots of this archive, now and before it was moved
    names: dict[str, list[str]] = {}
    for motion in found.motions:
        names.setdefault(_name(naming, motion), []).append(motion.path)
    for motion in found.motions:
        name = _name(naming, motion)
        if len(names[name]) > 1:
            failures.append(failure(motion, _namesake(name, motion, names[name]), clash=name))
            continue
        try:
            skeleton = found.skeleton_of(motion) if motion.format == "amc" else None
            groups = path_groups(motion.path, compiled)
            of_skeleton = skeleton_sums.of(skeleton) if skeleton is not None else ""
            made = recipe_of(made_by[motion.format], of_skeleton, groups)
            row = known.get(name)
            read_so = row is not None and row["recipe"] == made and row["take_id"] not in damaged
            if row is not None and _moved(row, motion):
                former.add(row["source_root"])
            elif row is not None and read_so and _same_content(row, motion):
                unchanged += 1
                restated += _restated(row, motion)
                continue
            elif row is not None and not _same_place(row, motion) and not _same_content(row, motion):
                raise _stranger(row, motion)
            warnings = () if groups is not None or not compiled else ("its path matches no pattern of the config",)
            tasks.append(Task(name, -1, motion, skeleton, dict(groups or {}), made, warnings))
        except SourceError as fault:
            failures.append(failure(motion, fault))
    ids = writer.assign_take_ids(task.name for task in tasks)
    tasks = sorted((replace(task, take_id=ids[task.name]) for task in tasks), key=lambda task: task.take_id)
    absent = (row for name, row in known.items() if name not in names and row["source_root"] in former)
    vanished = [row for row in absent if not found.hidden(row["source"])]
    called = {path: name for name, paths in names.items() for path in paths}
    renamed = [(row["take_id"], row["name"], called[row["source"]]) for row in vanished if row["source"] in called]
    gone = [row["take_id"] for row in vanished if row["source"] not in called]
    return Changes(tasks, unchanged, sorted(damaged), restated, gone, renamed, failures, skeleton_sums.table())


def recipe_of(made_by: str, skeleton: str, groups: Mapping[str, str] | None) -> str:
    """Return the recipe of a take: a hash of all that its row and its frames depend on besides its file.

    Parameters
    ----------
    made_by : str
        The recipe of its format, one of `recipes`.
    skeleton : str
        The checksum of its skeleton file; empty where it has none.
    groups : mapping of str to str or None
        The named groups of its path.
    """
    return digest([made_by, skeleton, sorted((groups or {}).items())])


def recipes(feature_set: FeatureSet, mappings: Mappings, settings: ReadSettings) -> dict[str, str]:
    """Return for each ending a hash of all that its takes depend on besides their files; takes are read again for it.

    The format of an .npz is known when it is read: settings that count for any reader of an ending count for all.
    """
    code = code_digest(read_body, analyse, blind, known_features)
    return {
        ending[1:]: digest(
            [features_digest(feature_set), code, *(_reader_recipe(reader, mappings, settings) for reader in readers)]
        )
        for ending, readers in readers_by_ending().items()
    }


def _reader_recipe(reader: Reader, mappings: Mappings, settings: ReadSettings) -> list[object]:
    plugin = plugin_digest(reader.distribution, type(reader)) if reader.distribution else ""
    return [mappings.digest(reader.format), reader.relevant_settings(settings), plugin]


def _name(naming: Naming, motion: SourceFile) -> str:
    if naming == "stem":
        return motion.stem
    return motion.path if naming == "file" else str(Path(motion.path).with_suffix(""))


def _namesake(name: str, motion: SourceFile, paths: Sequence[str]) -> SourceError:
    """Return the error of files whose takes would have the same name, with a rule of naming that distinguishes them."""
    rule = "path" if len({Path(path).with_suffix("") for path in paths}) == len(paths) else "file"
    others = [path for path in paths if path != motion.path]
    also = ", ".join(others[:2]) + (f" and {len(others) - 2} more" if len(others) > 2 else "")
    many, rename = ("two", "one") if len(paths) == 2 else (len(paths), "them")
    return SourceError(
        motion.absolute, f"{many} takes would be named '{name}' (also {also}); rename {rename}, or set `name: {rule}`"
    )


def _same_place(row: dict[str, Any], motion: SourceFile) -> bool:
    return (row["source_root"], row["source"]) == (motion.root, motion.path)


def _same_content(row: dict[str, Any], motion: SourceFile) -> bool:
    """Return if the content of a file is unchanged; it is read only where its place, size or time differ."""
    if row["source_bytes"] != motion.size:
        return False
    untouched = _same_place(row, motion) and row["source_mtime_ns"] == motion.mtime_ns
    return bool(untouched or row["checksum"] == checksum(motion.absolute))


def _restated(row: dict[str, Any], motion: SourceFile) -> list[dict[str, Any]]:
    """Return the row of an unchanged take with the new place or time of its file, so that it is not read again."""
    if _same_place(row, motion):
        return [] if row["source_mtime_ns"] == motion.mtime_ns else [row | {"source_mtime_ns": motion.mtime_ns}]
    if (Path(row["source_root"]) / row["source"]).exists():
        return []  # a copy of the file that was read
    place = {"source_root": motion.root, "source": motion.path, "source_mtime_ns": motion.mtime_ns}
    return [row | place]


def _moved(row: dict[str, Any], motion: SourceFile) -> bool:
    """Return if the file of a take was moved with its archive: it has the same place below another root only."""
    same = row["source"] == motion.path and row["source_root"] != motion.root
    return same and not (Path(row["source_root"]) / row["source"]).exists()


def _stranger(row: dict[str, Any], motion: SourceFile) -> SourceError:
    """Return the error of another file with the name of a take; only a changed file replaces its take."""
    return SourceError(
        motion.absolute,
        f"the store has a take '{row['name']}' already, from {row['source_root']}/{row['source']}, and its content "
        "differs; rename one, set `name: path`, or use a store of its own",
    )


def features_digest(feature_set: FeatureSet) -> str:
    """Return a hash of features, with the plugins whose primitives they use."""
    plugins = [part_digest(PRIMITIVES, name) for name in feature_set.plugin_primitives]
    return digest([feature_set.digest, *plugins]) if plugins else feature_set.digest


def digest(parts: object) -> str:
    """Return a short hash of JSON values."""
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:16]
