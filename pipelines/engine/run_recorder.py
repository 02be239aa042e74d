"""Record a pipeline run in the store's history: its stages, their parameters and results, and its outcome."""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from kinedex.ops.errors import KinedexError
from kinedex.pipelines.engine.config import Pipeline
from kinedex.pipelines.engine.file_parameters import setting_files, with_absolute_paths
from kinedex.pipelines.engine.plan import Step
from kinedex.storage.snapshot.manifest import Manifest, PipelineRecord, StageRecord, now
from kinedex.storage.snapshot.manifest_files import read_newest, versions
from kinedex.storage.store.history import KeptText, PipelineRun, StageRun, StageState, keep_file, write_run


class RunRecorder:
    """Records one run of a pipeline in the history of a store.

    A run in which no stage runs leaves no record. Nothing is written before the store exists.

    Parameters
    ----------
    store_path : Path
        The directory of the store, which need not exist.
    pipeline : Pipeline
        The pipeline, with all parameters.
    record : PipelineRecord
        The record of the run for the manifest.
    """

    def __init__(self, store_path: Path, pipeline: Pipeline, record: PipelineRecord) -> None:
        self._store = store_path
        self._pipeline = pipeline
        self._files: tuple[KeptText, ...] | None = None
        stages = tuple(
            StageRun(
                stage.name,
                stage.uses,
                dict(stage.inputs),
                with_absolute_paths(type(stage.params), stage.params.model_dump(mode="json", exclude_unset=True)),
                with_absolute_paths(type(stage.params), stage.params.model_dump(mode="json")),
            )
            for stage in pipeline.stages
        )
        self._run = PipelineRun(
            run=record.run,
            pipeline=pipeline.name,
            begun=now(),
            kinedex=record.kinedex,
            command=record.command,
            description=pipeline.description,
            path=record.path,
            yaml=record.yaml,
            settings=record.settings,
            sources=record.sources,
            stages=stages,
        )
        if versions(store_path):
            self._run = _with_store_content(self._run, read_newest(store_path))

    def skip(self, step: Step) -> None:
        """Record that a stage is up to date."""
        assert step.record is not None
        self._set(self._stage(step).recorded(step.record, "up to date"))

    def begin(self, step: Step) -> None:
        """Record that a stage begins."""
        self._set(replace(self._stage(step), state="running", reason=step.reason or ""))
        self._write()

    def done(self, step: Step, record: StageRecord, manifest: Manifest) -> None:
        """Record that a stage has run, with its record and the version of the store that holds its results."""
        self._set(self._stage(step).recorded(record, "ran"))
        self._run = replace(
            self._run,
            finished=record.finished,
            seconds=round(sum(stage.seconds for stage in self._run.ran), 3),
            takes=len(manifest.live_takes),
            version=manifest.version,
        )
        self._write()

    def fail(self, fault: BaseException) -> None:
        """Record that the run has ended with an error, or that the user has interrupted it."""
        stopped = not isinstance(fault, Exception)
        self._run = replace(
            self._run,
            state="interrupted" if stopped else "failed",
            problem="" if stopped else str(fault),
            finished=now(),
            stages=tuple(
                replace(stage, state="failed") if stage.state == "running" else stage for stage in self._run.stages
            ),
        )
        with suppress(KinedexError):  # report the first error, not one of writing the history
            self._write()

    def finish(self) -> None:
        """Record that all stages are done."""
        self._run = replace(self._run, state="finished")
        self._write()

    def _stage(self, step: Step) -> StageRun:
        return next(stage for stage in self._run.stages if stage.stage == step.stage.name)

    def _set(self, changed: StageRun) -> None:
        stages = tuple(changed if one.stage == changed.stage else one for one in self._run.stages)
        self._run = replace(self._run, stages=stages)

    def _write(self) -> None:
        at_work: tuple[StageState, ...] = ("running", "ran", "failed")
        if not versions(self._store) or not any(stage.state in at_work for stage in self._run.stages):
            return
        if self._files is None:
            self._files = self._kept_files()
            self._run = replace(self._run, files=self._files)
        write_run(self._store, self._run)

    def _kept_files(self) -> tuple[KeptText, ...]:
        """Copy the user's files that parameters name into the history, skipping unreadable ones; return the copies."""
        paths = dict.fromkeys(path for stage in self._pipeline.stages for path in setting_files(stage.params))
        for settings in self._run.other_sources.values():
            names = [settings.get("skeleton"), settings.get("features"), *settings.get("skeletons", ())]
            files = (Path(name) for name in names if isinstance(name, str) and os.path.isabs(name))
            paths |= dict.fromkeys(file for file in files if file.is_file())
        kept = []
        for path in paths:
            with suppress(OSError):  # the stage that reads the file reports the error
                kept.append(keep_file(self._store, path))
        return tuple(kept)


def _with_store_content(run: PipelineRun, manifest: Manifest) -> PipelineRun:
    """Return a run with the sources, mappings, labels and takes that the store has from other runs."""
    sources = sorted(manifest.sources.items(), key=lambda item: item[1].recorded)
    return replace(
        run,
        other_sources={root: source.settings for root, source in sources if root not in run.sources},
        mappings=dict(manifest.mappings),
        labels=sum(part.rows for part in manifest.labels),
        takes=len(manifest.live_takes),
        version=manifest.version,
    )
