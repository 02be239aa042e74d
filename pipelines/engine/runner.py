"""Run a pipeline stage by stage, and record in the store what was done."""

from __future__ import annotations

import json
import logging
import os
import shlex
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kinedex.ops.errors import AcceptError, KinedexError, NewStoreError, Remedy
from kinedex.ops.wording import name_list
from kinedex.pipelines.engine.config import KnownFailures, Pipeline, load_pipeline
from kinedex.pipelines.engine.context import StageContext, feature_set_for
from kinedex.pipelines.engine.display import Display, NoDisplay
from kinedex.pipelines.engine.executors import Executor, make_executor
from kinedex.pipelines.engine.known_failures import SourceFiles, source_files, source_state
from kinedex.pipelines.engine.plan import FORCED, Planner, Step, existing_store, make_plan
from kinedex.pipelines.engine.run_id import new_run_id
from kinedex.pipelines.engine.run_recorder import RunRecorder
from kinedex.pipelines.labels.unmatched_labels import UnmatchedLabels, recorded_unmatched, unmatched_summary
from kinedex.storage.ctrl_c import ctrl_c_in_statements
from kinedex.storage.lock import Wait
from kinedex.storage.snapshot.manifest import PipelineRecord, StageRecord, kinedex_version, now, running_command
from kinedex.storage.snapshot.manifest_files import versions
from kinedex.storage.snapshot.visible_results import makes_results, pipelines_by_use
from kinedex.storage.store.history import OWN_FIELDS, SUMS, file_sums
from kinedex.storage.store.store import data_frame, open_store
from kinedex.storage.store.writer import StoreWriter

if TYPE_CHECKING:
    import polars as pl

_log = logging.getLogger("kinedex.engine")

COMMIT_SECONDS = 600.0
"""The shortest time, in seconds, that a run in progress waits for another writer, so that no work is lost."""


@dataclass(frozen=True)
class Outcome:
    """The outcome of a run of a pipeline.

    Attributes
    ----------
    pipeline : Pipeline
        The pipeline, with all parameters.
    store_path : Path
        The directory of the store.
    ran : tuple of str
        The stages that ran.
    skipped : tuple of str
        The stages that were up to date.
    summaries : dict of str to dict
        The figures that each stage recorded; for skipped stages, those of the run before.
    left_out : int
        The number of source files that the ingest excluded.
    unmatched : tuple of UnmatchedLabels
        The labels that match no take, once for each label file.
    report : Path or None
        The report page of the last stage that writes one.
    command : str or None
        The command line that repeats the run; None for a call without `assignments`.
    files : SourceFiles
        The source files that are new, changed or gone, and those that failed.
    remembers : bool
        True where the store remembers failures, so that known ones are accepted.
    """

    pipeline: Pipeline
    store_path: Path
    ran: tuple[str, ...]
    skipped: tuple[str, ...]
    summaries: dict[str, dict[str, Any]]
    left_out: int
    unmatched: tuple[UnmatchedLabels, ...]
    report: Path | None
    command: str | None = None
    files: SourceFiles = field(default_factory=SourceFiles)
    remembers: bool = False

    @property
    def has_failures(self) -> bool:
        """True if files failed or labels match no take; where failures are remembered, only new ones count."""
        return bool(self.files.failed) if self.remembers else bool(self.left_out or self.unmatched)

    @cached_property
    def metrics(self) -> pl.DataFrame:
        """The metrics of the pipeline's evaluations, one row for each class, take or group; see docs/sql.md."""
        return data_frame(open_store(self.store_path, at="newest").result("metrics", pipeline=self.pipeline.name))


class StageFailed(KinedexError):
    """A stage failed; the message explains the reason, and the way to resume."""


@dataclass(frozen=True)
class _Run:
    """The state that the stages of one run share.

    `resume` is the command that continues after a failure; None for a call from Python. `wait` is the time that the
    next stage waits for another writer.
    """

    pipeline: Pipeline
    store_path: Path
    pool: Executor
    terminal: Display
    resume: str | None
    wait: Wait
    record: PipelineRecord
    history: RunRecorder
    accept: bool = False

    def begun(self) -> _Run:
        """Return the run with a longer wait for other writers, as it now has work to lose."""
        return replace(self, wait=replace(self.wait, seconds=max(self.wait.seconds, COMMIT_SECONDS)))


@dataclass(frozen=True)
class RunOptions:
    """The way in which a pipeline runs.

    Attributes
    ----------
    executor : {"serial", "processes", "dask"}
        The executor of tasks. A script that asks for processes must guard its start with
        `if __name__ == "__main__":`, because every worker imports it.
    workers : int, optional
        The number of workers; all cores by default.
    scheduler : str, optional
        The address of a running Dask scheduler.
    force : frozenset of str
        Stages that run in any case.
    wait_seconds : float, optional
        The time to wait for another writer of the store; 0 fails at once. A run that has begun waits at least
        `COMMIT_SECONDS` between its stages and to commit.
    accept : bool, optional
        True allows a stage to remove values from takes; by default, the stage fails and lists these values.
    known_failures : {"report", "remember"}, optional
        "remember" keeps failures in the store, so that a later run reports only new ones; by default, the value of the
        pipeline.
    """

    executor: str = "serial"
    workers: int | None = None
    scheduler: str | None = None
    force: frozenset[str] = frozenset()
    wait_seconds: float = 0.0
    accept: bool = False
    known_failures: KnownFailures | None = None

    def command(self, name: str | Path, store_path: Path, assignments: Mapping[str, str]) -> str:
        """Return the command that runs a pipeline with the executor, workers and forced stages of these options."""
        words = ["kinedex", "run", str(name), "--store", str(store_path)]
        for key, value in assignments.items():
            words += ["--set", f"{key}={value}"]
        words += ["--executor", self.executor] if self.executor != "processes" else []
        words += ["--workers", str(self.workers)] if self.workers is not None else []
        words += ["--scheduler", self.scheduler] if self.scheduler is not None else []
        for stage in sorted(self.force):
            words += ["--force", stage]
        return shlex.join(words)


def run_pipeline(
    name_or_path: str | Path,
    store_path: str | Path,
    *,
    settings: Mapping[str, Any] | None = None,
    assignments: Mapping[str, str] | None = None,
    terminal: Display | None = None,
    **given: Any,
) -> Outcome:
    """Run the stages of a pipeline that have not been done yet.

    Parameters
    ----------
    name_or_path : str or Path
        A shipped pipeline such as "annotate", or a path to a .yaml file.
    store_path : str or Path
        The directory of the store; it is created if missing.
    settings : mapping of str to object, optional
        Values for settings of the file by name, such as `{"source": "/my/archive"}`, and for parameters by
        "stage.name", such as `{"annotate.tau": 0.06}`. If only one stage has a parameter, the stage may be omitted.
    assignments : mapping of str to str, optional
        The texts of `--set` on the command line, in place of `settings`; error messages then refer to commands.
    terminal : Display, optional
        Shows messages, tables and progress; nothing is shown by default.
    **given : object
        The attributes of `RunOptions`.

    Returns
    -------
    Outcome
        The stages that ran, the metrics, and the path of the report.

    Raises
    ------
    StageFailed
        A stage failed; results that earlier stages committed are kept.
    KinedexError
        The pipeline file, a setting or the store is not usable; nothing was changed.
    """
    terminal, force = terminal or NoDisplay(), frozenset(given.get("force", ()))
    options = RunOptions(**given | {"force": force})
    # the workers of a cluster may have been started in another folder
    store_path = Path(store_path).resolve() if options.executor == "dask" else Path(store_path)
    loaded = load_pipeline(name_or_path, assignments, settings)
    planner = Planner(loaded, store_path, force)
    pipeline = planner.pipeline
    plan = make_plan(loaded, store_path, force)  # reports errors in files before any work is done
    pool = make_executor(options.executor, options.workers, options.scheduler)
    resume = None if assignments is None else options.command(name_or_path, store_path, assignments)
    option = "wait_seconds=600" if resume is None else "--wait 10m"
    wait = Wait(options.wait_seconds, terminal.message, option)
    record = _pipeline_record(pipeline, assignments or settings or {})
    history = RunRecorder(store_path, pipeline, record)
    run = _Run(pipeline, store_path, pool, terminal, resume, wait, record, history, options.accept)
    remember = (options.known_failures or pipeline.known_failures) == "remember"
    before = source_state(existing_store(store_path), pipeline)
    steps: list[Step] = []
    try:
        pool.check(store_path)
        with ctrl_c_in_statements():
            for number in range(len(pipeline.stages)):
                # nothing has run since the plan was made, so that the first step is still valid
                steps.append(_take_step(run, planner, number, plan[number] if number == 0 else None))
                run = run if steps[-1].reason is None else run.begun()
            _make_current(run)
    except BaseException as fault:
        pool.abort()
        history.fail(fault)
        raise
    history.finish()
    try:
        pool.close()
    except KeyboardInterrupt:
        # all work is done and recorded; only the workers were still waited for
        pool.abort()
    outcome = _outcome(run, steps)
    files = source_files(
        store_path, pipeline, before, outcome.unmatched, remember=remember, run=record.run, wait=run.begun().wait
    )
    return replace(outcome, files=files, remembers=remember)


def _make_current(run: _Run) -> None:
    """Record that the pipeline was run, and show which pipeline's results the views of results use."""
    name = run.pipeline.name
    if not _makes_results(run.pipeline):
        return
    manifest = open_store(run.store_path, at="newest").manifest
    if manifest.recent_pipelines[:1] != (name,):
        with StoreWriter.open(run.store_path, manifest.feature_set, manifest.rate_hz, run.wait) as writer:
            writer.record_run(name)
            manifest = writer.commit()
    others = [one for one in pipelines_by_use(manifest) if one != name]
    use = f"kinedex use {shlex.quote(str(run.store_path))}"
    if others and manifest.chosen_pipeline in others:
        run.terminal.message(
            f"the views of results show pipeline {manifest.chosen_pipeline}, which was chosen; `{use} {name}` shows "
            f"{name}"
        )
    elif others:
        run.terminal.message(
            f"the views of results show pipeline {name}; those that begin with `all_` show {name_list(others)} as "
            "well, and "
            f"`{use} {others[0]}` goes back"
        )


def _makes_results(pipeline: Pipeline) -> bool:
    return makes_results(stage.uses for stage in pipeline.stages)


def _take_step(run: _Run, planner: Planner, number: int, planned: Step | None) -> Step:
    """Run or skip a stage, and return its step of the plan; the step is planned again unless it is given."""
    stage = run.pipeline.stages[number]
    step = planner.step(stage) if planned is None else planner.follow(replace(planned, stage=stage))
    text = f"[{number + 1}/{len(run.pipeline.stages)}] {stage.name}: {_status(step)}"
    _log.info("%s", text, extra=_fields(run, stage.name, event="start" if step.reason else "skip", reason=step.reason))
    run.terminal.heading(text)
    if step.reason is None:
        run.history.skip(step)
    else:
        run.history.begin(step)
        step = replace(step, record=_run_step(run, planner, step))
    return step


def _fields(run: _Run, stage: str, **more: object) -> dict[str, object]:
    """Return the fields of a log record about a stage."""
    return {"pipeline": run.pipeline.name, "stage": stage, "store": str(run.store_path), **more}


def _status(step: Step) -> str:
    if step.reason is not None:
        return step.reason
    assert step.record is not None
    same = f", unchanged: {step.what}" if step.what else ""
    return f"nothing to do{same}, done {step.record.finished} (run {step.record.run})"


def _run_step(run: _Run, planner: Planner, step: Step) -> StageRecord:
    stage = step.stage
    context = StageContext(
        store_path=run.store_path,
        feature_set=feature_set_for(existing_store(run.store_path), getattr(stage.params, "features", None)),
        pipeline=run.pipeline.name,
        stage=stage.name,
        uses=stage.uses,
        run=new_run_id(),
        executor=run.pool,
        terminal=run.terminal,
        inputs=dict(stage.inputs),
        params={other.name: other.params for other in run.pipeline.stages},
        code=step.parts["code"],
        anew=step.reason == FORCED,
        wait=run.wait,
    )
    begin = time.perf_counter()
    try:
        # Forget the old record first: if the run is killed, the stage must not count as done unless it has committed
        # nothing yet. A store that does not exist has no record, and is created only when there is something to write.
        if versions(run.store_path):
            with context.writer() as writer:
                if not run.accept:
                    stage.kind.examine(stage.params, writer.store)
                if not stage.kind.commits_once:
                    writer.forget_stage(context.key())
                    writer.commit()
            context = replace(context, wait=run.begun().wait)
        with run.terminal.activity(stage.name):
            summary = stage.kind.run(context, stage.params) | unmatched_summary(context.unmatched)
        seconds = time.perf_counter() - begin
        record = _record(replace(context, wait=run.begun().wait), planner.done(step), summary, seconds, run)
    except KinedexError as fault:
        raise _failed(run, stage.name, str(fault), fault) from fault
    except OSError as fault:
        raise _failed(run, stage.name, f"{fault.filename or run.store_path}: {fault.strerror or fault}") from fault
    except MemoryError as fault:
        workers = "workers" if run.resume is None else "--workers"
        raise _failed(run, stage.name, f"out of memory; fewer {workers} need less") from fault
    text = f"done in {seconds:.1f} s"
    figures = {"run_id": context.run, "seconds": round(seconds, 3), "summary": summary}
    _log.info("%s: %s", stage.name, text, extra=_fields(run, stage.name, event="finish", **figures))
    run.terminal.message(text)
    return record


def _failed(run: _Run, stage: str, reason: str, fault: KinedexError | None = None) -> StageFailed:
    _log.error("stage %s: %s", stage, reason, extra=_fields(run, stage, event="fail"))
    failure = StageFailed(f"stage {stage}: {reason}{_way_on(run, stage, fault)}")
    if fault is not None:
        # the error's message ends with the remedy already
        failure.remedy = fault.remedy
        if isinstance(fault, AcceptError) and run.resume is not None:
            command = f"{run.resume} --accept"
            failure.remedy = Remedy(f"`{command}` accepts it", tuple(shlex.split(command)))
        if fault.way_out is not None and run.resume is not None:
            command = f"{run.resume} --set {_setting(stage, fault.way_out)}"
            failure.remedy = Remedy(f"`{command}` continues", tuple(shlex.split(command)))
    return failure


def _way_on(run: _Run, stage: str, fault: KinedexError | None) -> str:
    """Return the lines of the message about a failed stage that explain how to continue."""
    if isinstance(fault, NewStoreError):
        return ""
    if isinstance(fault, AcceptError):
        return "\nto accept it, " + (
            "call again with accept=True" if run.resume is None else f"run:\n    {run.resume} --accept"
        )
    way = fault.way_out if fault is not None else None
    if run.resume is None:
        if way is not None:
            return f"\ncall again with settings={{'{stage}.{way[0]}': {way[1]!r}}}"
        return "\nonce it is fixed, call again: finished stages do not run again"
    if way is not None:
        return f"\ncontinue with:\n    {run.resume} --set {_setting(stage, way)}"
    return f"\nonce it is fixed, continue with:\n    {run.resume}"


def _setting(stage: str, way_out: tuple[str, str]) -> str:
    return shlex.quote(f"{stage}.{way_out[0]}={way_out[1]}")


def _pipeline_record(pipeline: Pipeline, settings: Mapping[str, Any]) -> PipelineRecord:
    """Return the record of a run of a pipeline that allows it to be run again."""
    sources = {getattr(stage.params, "source", None) for stage in pipeline.stages} - {None}
    return PipelineRecord(
        yaml=pipeline.text,
        path=str(pipeline.path.absolute()),
        settings=json.loads(json.dumps(dict(settings), default=str)),
        sources=tuple(sorted(os.path.realpath(Path(source).expanduser()) for source in sources if source)),
        command=running_command(),
        kinedex=kinedex_version(),
        run=new_run_id(),
        recorded=now(),
    )


def _record(context: StageContext, step: Step, summary: Mapping[str, object], seconds: float, run: _Run) -> StageRecord:
    """Store the record of a stage that has run, and return it as read from the store."""
    full: dict[str, Any] = {
        **summary,
        "uses": step.stage.uses,
        "params": step.stage.params.model_dump(mode="json"),
        # a stage may take unset parameters from another stage, so that their defaults do not describe them
        "given": step.stage.params.model_dump(mode="json", exclude_unset=True),
        "inputs": dict(step.stage.inputs),
        "fingerprint_parts": step.parts,
    }
    if files := full.get("files"):
        full[SUMS] = file_sums(context.store_path, files)
    known = run.record
    record = StageRecord(
        context.key(),
        step.fingerprint,
        context.run,
        now(),
        round(seconds, 3),
        full,
        known.run,
        known.command,
        known.kinedex,
    )
    with context.writer() as writer:
        writer.record_stage(record)
        writer.record_pipeline(context.pipeline, replace(known, recorded=now()))
        if step.stage is run.pipeline.stages[-1] and _makes_results(run.pipeline):
            writer.record_run(context.pipeline)
        run.history.done(step, record, writer.commit())
        # read it before the writer closes: after that, another run may remove the record
        return open_store(context.store_path, at="newest").manifest.stages[context.key()]


def _outcome(run: _Run, steps: list[Step]) -> Outcome:
    summaries = {
        step.stage.name: {key: value for key, value in step.record.summary.items() if key not in OWN_FIELDS}
        for step in steps
        if step.record is not None
    }
    pages = [name for one in summaries.values() for name in one.get("files", ()) if name.endswith(".html")]
    return Outcome(
        run.pipeline,
        run.store_path,
        tuple(step.stage.name for step in steps if step.reason is not None),
        tuple(step.stage.name for step in steps if step.reason is None),
        summaries,
        sum(int(one.get("left_out", 0)) for one in summaries.values()),
        recorded_unmatched(summaries.values()),
        run.store_path / pages[-1] if pages else None,
        run.resume,
    )
