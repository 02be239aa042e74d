"""Change a store's records: sources, removed files, mappings, and the pipelines and stages that were run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from kinedex.ops.errors import StoreError, did_you_mean
from kinedex.storage.snapshot.manifest import Manifest, PipelineRecord, Source, StageRecord, now
from kinedex.storage.snapshot.visible_results import current_pipeline, pipelines_by_use
from kinedex.storage.store.version_changes import VersionDraft


class RecordChanges(VersionDraft):
    """The methods of the draft of a version that change records."""

    def record_source(self, root: str, stage: str, settings: Mapping[str, Any]) -> None:
        """Record the settings with which a source folder is ingested, replacing its earlier ones.

        Parameters
        ----------
        root : str
            The absolute path of the folder.
        stage : str
            The stage, "<pipeline>/<stage>".
        settings : mapping of str to object
            The parameters of the stage, as JSON values.
        """
        standing = self._manifest.sources.get(root)
        if standing is None or (standing.stage, standing.settings) != (stage, settings):
            source = Source(stage, dict(settings), now())
            self._manifest = replace(self._manifest, sources={**self._manifest.sources, root: source})

    def remove_files(self, root: str, paths: Iterable[str]) -> None:
        """Record files of a source folder whose takes were removed, so that an ingest skips them."""
        standing = self._manifest.removed_files
        merged = tuple(sorted({*standing.get(root, ()), *paths}))
        if merged:
            self._manifest = replace(self._manifest, removed_files={**standing, root: merged})

    def readmit_files(self, files: Iterable[tuple[str, str]]) -> None:
        """Remove files, given as (source folder, path), from the record of files that an ingest skips."""
        gone = set(files)
        left = {
            root: tuple(path for path in paths if (root, path) not in gone)
            for root, paths in self._manifest.removed_files.items()
        }
        self._manifest = replace(self._manifest, removed_files={root: paths for root, paths in left.items() if paths})

    def put_mapping(self, name: str, text: str | None) -> None:
        """Store a skeleton mapping or a vocabulary under a name, replacing an earlier one; None removes it."""
        others = {other: kept for other, kept in self._manifest.mappings.items() if other != name}
        mappings = others if text is None else {**others, name: text}
        if mappings != self._manifest.mappings:
            self._manifest = replace(self._manifest, mappings=mappings)
            self._facts.name("mappings", name)

    def record_pipeline(self, name: str, record: PipelineRecord) -> None:
        """Record the settings of a pipeline's run, replacing its earlier record."""
        self._manifest = replace(self._manifest, pipelines={**self._manifest.pipelines, name: record})

    def record_run(self, pipeline: str) -> None:
        """Record that a pipeline with results has finished, which makes it current unless the user has chosen one."""
        recent = tuple(dict.fromkeys((pipeline, *self._manifest.recent_pipelines)))
        self._record_current(replace(self._manifest, recent_pipelines=recent))

    def choose_pipeline(self, name: str | None) -> None:
        """Choose a pipeline with results as the current one; after None, the latest one is always current.

        Raises
        ------
        StoreError
            The store has no results of a pipeline of this name.
        """
        known = pipelines_by_use(self._manifest)
        if name is not None and name not in known:
            have = f"it has results of {', '.join(known)}" if known else "it has no results of pipelines"
            raise StoreError(f"{self.path}: no pipeline '{name}'; {have}{did_you_mean(name, known)}")
        self._record_current(replace(self._manifest, chosen_pipeline=name or ""))

    def restore_pipeline(self, name: str, earlier: Manifest) -> None:
        """Restore the results that a pipeline had in an earlier version; other pipelines are unchanged.

        If the pipeline had no results in that version, its present results are removed.

        Parameters
        ----------
        name : str
            The pipeline.
        earlier : Manifest
            A version of this store whose files still exist.

        Raises
        ------
        StoreError
            Neither version has results of a pipeline of this name.
        """
        prefix = f"{name}/"
        kinds = {*earlier.results, *self._manifest.results}
        results = dict(self._manifest.results)
        for kind in sorted(kinds):
            standing = self._manifest.results.get(kind, ())
            others = tuple(part for part in standing if not part.stage.startswith(prefix))
            restored = others + tuple(part for part in earlier.results.get(kind, ()) if part.stage.startswith(prefix))
            if {part.path for part in restored} != {part.path for part in standing}:
                results[kind] = restored
                self._facts.name("results", kind)
        before = {key: one for key, one in earlier.stages.items() if key.startswith(prefix)}
        after = {key: one for key, one in self._manifest.stages.items() if key.startswith(prefix)}
        if not before and not after:
            raise StoreError(f"{self.path}: no pipeline '{name}'{did_you_mean(name, pipelines_by_use(self._manifest))}")
        stages = {key: one for key, one in self._manifest.stages.items() if key not in after}
        pipelines = {key: one for key, one in self._manifest.pipelines.items() if key != name}
        pipelines |= {name: earlier.pipelines[name]} if name in earlier.pipelines else {}
        recent = tuple(one for one in self._manifest.recent_pipelines if one != name or before)
        chosen = self._manifest.chosen_pipeline if self._manifest.chosen_pipeline != name or before else ""
        changed = replace(self._manifest, results=results, stages={**stages, **before}, pipelines=pipelines)
        self._record_current(replace(changed, recent_pipelines=recent, chosen_pipeline=chosen))

    def _record_current(self, manifest: Manifest) -> None:
        before, after = current_pipeline(self._manifest), current_pipeline(manifest)
        if after is not None and after != before:
            self._facts.name("current_pipeline", after)
        self._manifest = manifest

    def forget_stage(self, stage: str) -> None:
        """Remove a stage's record, so that it does not count as finished while it runs again."""
        left = {name: record for name, record in self._manifest.stages.items() if name != stage}
        if len(left) < len(self._manifest.stages):
            self._facts.name("stages_begun", stage)
        self._manifest = replace(self._manifest, stages=left)

    def record_stage(self, record: StageRecord) -> None:
        """Record that a stage has finished, replacing its earlier record."""
        self._manifest = replace(self._manifest, stages={**self._manifest.stages, record.stage: record})
        self._facts.name("stages_done", record.stage)
