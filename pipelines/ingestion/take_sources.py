"""Look up in a store how its takes were read, and find their source files so that they can be read again."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from kinedex.catalog.skeletons.mappings import Mappings
from kinedex.ops.errors import KinedexError, SourceError, StoreError
from kinedex.pipelines.ingestion.file_batches import Batch, Task
from kinedex.pipelines.ingestion.metadata import described_columns
from kinedex.pipelines.ingestion.parameters import IngestParameters, chosen_mappings
from kinedex.pipelines.ingestion.source_changes import has_recipe, recipe_of, recipes
from kinedex.pipelines.tracking.recording_runs import command_of_take
from kinedex.storage.formats.json_text import json_text
from kinedex.storage.formats.motion.scanned_files import SourceFile
from kinedex.storage.formats.motion.sources import Scan, checksum, path_groups, scan
from kinedex.storage.repair.quarantine import LostTake
from kinedex.storage.snapshot.manifest import Manifest, StageRecord
from kinedex.storage.snapshot.manifest_files import read_version, versions
from kinedex.storage.snapshot.measured_columns import stored_figures
from kinedex.storage.snapshot.schemas import RECORDED_FORMATS
from kinedex.storage.store.store import Store


def known_stages(store: Path) -> dict[str, StageRecord]:
    """Return a dict from "<pipeline>/<stage>" to the last record of the stage, for all stages of a pipeline.

    A stage whose record was removed so that it runs again has none in the newest version, so older versions are read as
    well.
    """
    found: dict[str, StageRecord] = {}
    for version in reversed(versions(store)):
        try:
            records = read_version(store, version).stages
        except StoreError:
            continue
        found = {name: record for name, record in records.items() if "uses" in record.summary} | found
    return found


def pipeline_text(records: dict[str, StageRecord], pipeline: str) -> str:
    """Return the text of a pipeline file with the stages of a pipeline and the parameters that were given to them."""
    stages = {
        key.partition("/")[2]: {name: record.summary[name] for name in ("uses", "inputs")}
        # records of format 3 do not tell given parameters from defaults
        | {"params": record.summary.get("given", record.summary["params"])}
        for key, record in records.items()
        if key.partition("/")[0] == pipeline
    }
    # JSON is valid YAML
    document = {"name": pipeline, "description": "the stages as the store records them", "stages": stages}
    return json_text(document)


def ingest_settings(manifest: Manifest, records: dict[str, StageRecord]) -> list[IngestParameters]:
    """Return the parameters with which sources were ingested, the most recent first.

    Parameters
    ----------
    manifest : Manifest
        The manifest of the store, which has the parameters of each source.
    records : dict of str to StageRecord
        The result of `known_stages`; stores upgraded from format 3 have the parameters only there.
    """
    sources = sorted(manifest.sources.values(), key=lambda source: source.recorded, reverse=True)
    ingests = [record for record in records.values() if record.summary["uses"] == "ingest"]
    ingests.sort(key=lambda record: record.finished, reverse=True)
    known = [*(source.settings for source in sources), *(record.summary["params"] for record in ingests)]
    return [IngestParameters.model_validate(params) for params in known]


@dataclass
class FoundSources:
    """The result of looking up the sources of takes.

    Attributes
    ----------
    batches : list of Batch
        The takes that can be read again, grouped by settings.
    lost : list of LostTake
        The takes whose source is missing or has changed, and takes made from recordings, which have no motion file.
    otherwise : list of str
        Names of takes that may be read differently than before because kinedex or a mapping has changed.
    """

    batches: list[Batch] = field(default_factory=list)
    lost: list[LostTake] = field(default_factory=list)
    otherwise: list[str] = field(default_factory=list)


class Sources:
    """The sources of the takes of a store.

    Parameters
    ----------
    store : Store
        The store, whose rows of takes can be read.
    settings : iterable of IngestParameters
        The parameters of the ingests that have filled it, the most recent first.
    """

    def __init__(self, store: Store, settings: Iterable[IngestParameters]) -> None:
        self.store = store
        self._readers = [_Reader(store, params) for params in settings] or [
            _Reader(store, IngestParameters.model_validate({"source": ""}))
        ]
        self._scans: dict[str, tuple[Scan | None, dict[str, SourceFile]]] = {}
        self._rows = {row["take_id"]: row for row in store.take_rows.to_pylist()}
        self._skeletons: dict[tuple[str, str], str] = {}
        for row in _skeleton_rows(store):
            self._skeletons[row["source_root"], row["source"]] = row["checksum"]

    def find(self, take_ids: Iterable[int]) -> FoundSources:
        """Find the source files from which takes can be read again, in order of take id."""
        found = FoundSources()
        tasks: dict[int, list[Task]] = {}
        for take_id in sorted(take_ids):
            row = self._rows[take_id]
            try:
                number, task = self._task(row)
                tasks.setdefault(number, []).append(task)
                if task.recipe != row["recipe"]:
                    found.otherwise.append(task.name)
            except KinedexError as fault:
                source = str(Path(row["source_root"]) / row["source"])
                found.lost.append(LostTake(row["name"], take_id, source, _reason(fault)))
        for number, those in tasks.items():
            reader = self._readers[number]
            found.batches.append(
                Batch(
                    self.store.path, self.store.feature_set, self.store.rate_hz, reader.mappings, reader.params.given,
                    False, tuple(those), figures=stored_figures(self.store.manifest.columns),
                )
            )  # fmt: skip
        return found

    @property
    def mappings(self) -> list[Mappings]:
        """The skeleton mappings of each ingest."""
        return [reader.mappings for reader in self._readers]

    @property
    def describing(self) -> tuple[str, ...]:
        """The columns of takes that patterns and tables of the user fill."""
        return described_columns(self.store.manifest.columns)

    def row(self, take_id: int) -> dict[str, Any]:
        """Return a copy of the store's row of a take, as a dict from column to value."""
        return dict(self._rows[take_id])

    def _task(self, row: Mapping[str, Any]) -> tuple[int, Task]:
        """Return the task that reads a take again, and the index of the ingest settings that it uses.

        Raises
        ------
        KinedexError
            The take cannot be read again; the message has the reason.
        """
        path = Path(row["source_root"]) / row["source"]
        if row["format"] in RECORDED_FORMATS:
            raise KinedexError(
                "no motion file holds it, but its stage makes it again, or "
                f"`{command_of_take(self.store, row['take_id'])}`"
            )
        found, motions = self._scan(row["source_root"])
        motion = motions.get(row["source"])
        if found is None or motion is None:
            raise SourceError(path, "is not there")
        if checksum(motion.absolute) != row["checksum"]:
            raise SourceError(path, "has changed since it was read")
        given = next((one.params.skeleton_files for one in self._readers if one.root == row["source_root"]), {})
        skeleton, doubts = found.chosen_skeleton(motion, given) if row["skeleton_source"] else (None, ())
        content = checksum(skeleton.absolute) if skeleton is not None else ""
        number, recipe = self._reader_of(row, motion, content)
        if recipe != row["recipe"] and skeleton is not None:
            before = self._skeletons.get((skeleton.root, skeleton.path), "")
            if skeleton.path != row["skeleton_source"] or before != content:
                raise SourceError(
                    skeleton.absolute, "is not known to be the skeleton or static trial that it was read with"
                )
        groups = path_groups(motion.path, self._readers[number].patterns)
        task = Task(row["name"], row["take_id"], motion, skeleton, dict(groups or {}), recipe, doubts)
        return number, replace(task, person=row.get("person") or "", persons=row.get("persons") or 1)

    def _reader_of(self, row: Mapping[str, Any], motion: SourceFile, skeleton: str) -> tuple[int, str]:
        """Return the index of the ingest settings that a take was read with, and its recipe with these settings."""
        here = [number for number, reader in enumerate(self._readers) if reader.root == row["source_root"]]
        # recipes do not cover patterns: try the settings of the take's own source first
        for number in dict.fromkeys([*here, *range(len(self._readers))]):
            if self._readers[number].has_made(row, motion, skeleton):
                return number, row["recipe"]
        number = here[0] if here else 0
        return number, self._readers[number].recipe(motion, skeleton)

    def _scan(self, root: str) -> tuple[Scan | None, dict[str, SourceFile]]:
        if root not in self._scans:
            try:
                found = scan(root)
                self._scans[root] = found, {motion.path: motion for motion in found.motions}
            except KinedexError:
                self._scans[root] = None, {}
        return self._scans[root]


class _Reader:
    """The settings of one ingest, with everything that the recipe of a take depends on."""

    def __init__(self, store: Store, params: IngestParameters) -> None:
        self.params = params
        self.root = str(Path(params.source).expanduser().resolve())
        self.patterns = [re.compile(pattern) for pattern in params.patterns]
        self._store = store

    @cached_property
    def mappings(self) -> Mappings:
        """The skeleton mappings; mapping files of the user that no longer exist are ignored."""
        there = [place for place in self.params.skeletons if Path(place).expanduser().exists()]
        params = self.params.model_copy(update={"skeletons": there})
        return chosen_mappings(params, self._store.feature_set.joints, self._store.path, self._store.manifest)

    @cached_property
    def _recipes(self) -> dict[str, str]:
        return recipes(self._store.feature_set, self.mappings, self.params.given)

    def recipe(self, motion: SourceFile, skeleton: str) -> str:
        """Return the recipe of a motion file with these settings; empty if the settings are no longer valid."""
        try:
            return recipe_of(self._recipes[motion.format], skeleton)
        except KinedexError:
            return ""

    def has_made(self, row: Mapping[str, Any], motion: SourceFile, skeleton: str) -> bool:
        """Return whether a take was read with these settings."""
        try:
            return has_recipe(self._recipes[motion.format], skeleton, row)
        except KinedexError:
            return False


def _skeleton_rows(store: Store) -> list[dict[str, Any]]:
    try:
        return list(store.result("skeleton_files").to_pylist())
    except KinedexError:
        return []  # the part is damaged


def _reason(fault: KinedexError) -> str:
    return f"{fault.path} {fault.reason}" if isinstance(fault, SourceError) else str(fault)
