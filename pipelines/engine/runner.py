"""The runner: carries a plan out, stage by stage, and records in the store what is done."""

from __future__ import annotations

import secrets
import shlex
import time
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from kinedex.ops.errors import KinedexError, NewStoreError
from kinedex.pipelines.console.terminal import Terminal
from kinedex.pipelines.engine.config import Pipeline, load_pipeline
from kinedex.pipelines.engine.context import StageContext, feature_set_for
from kinedex.pipelines.engine.executors import Executor, make_executor
from kinedex.pipelines.engine.plan import FORCED, Planner, Step, make_plan
from kinedex.storage.snapshot.manifest import StageRecord, now, versions
from kinedex.storage.store.store import open_store


@dataclass(frozen=True)
class Outcome:
    """What a run did: the plan it carried out, and how many source files the ingest left out."""

    pipeline: Pipeline
    ran: tuple[str, ...]
    skipped: tuple[str, ...]
    left_out: int
    report: Path | None


class StageFailed(KinedexError):
    """A stage could not finish; the message says why and how to resume."""


@dataclass(frozen=True)
class _Run:
    """What the stages of one run share."""

    pipeline: Pipeline
    store_path: Path
    pool: Executor
    terminal: Terminal
    resume: str


def run_pipeline(
    name_or_path: str | Path,
    store_path: str | Path,
    *,
    assignments: Mapping[str, str] | None = None,
    executor: str = "serial",
    workers: int | None = None,
    scheduler: str | None = None,
    force: frozenset[str] = frozenset(),
    terminal: Terminal | None = None,
) -> Outcome:
    """Run what is not done yet of a pipeline.

    Parameters
    ----------
    name_or_path: a shipped pipeline, or a path to a .yaml file. store_path: the store; made where missing.
    assignments: settings of the file by name, parameters by "stage.name".
    executor: "serial", "processes" or "dask". A script that asks for processes must guard its start with
        `if __name__ == "__main__":`, because every worker imports it.
    workers, scheduler: see `make_executor`. force: stages that run in any case. terminal: where to speak.

    Raises
    ------
    StageFailed: a stage could not finish; what earlier stages committed stays.
    KinedexError: the pipeline file or the store is not usable; nothing was changed.
    """
    terminal = terminal or Terminal()
    # the workers of a cluster may have been started in another folder
    store_path = Path(store_path).resolve() if executor == "dask" else Path(store_path)
    pipeline = load_pipeline(name_or_path, assignments)
    planner = Planner(pipeline, store_path, force)
    make_plan(pipeline, store_path, force)  # what is wrong with files is said before any work is done
    pool = make_executor(executor, workers, scheduler)
    resume = _resume(name_or_path, store_path, assignments, executor, workers, scheduler, force)
    run = _Run(pipeline, store_path, pool, terminal, resume)
    steps = []
    try:
        pool.check(store_path)
        for number, stage in enumerate(pipeline.stages, 1):
            step = planner.step(stage)
            steps.append(step)
            terminal.heading(f"[{number}/{len(pipeline.stages)}] {stage.name}: {_saying(step)}")
            if step.reason is not None:
                _run_step(run, planner, step)
    except BaseException:
        pool.abort()
        raise
    try:
        pool.close()
    except KeyboardInterrupt:
        # all is done and recorded: only the workers were waited for
        pool.abort()
    return _outcome(pipeline, steps, store_path)


def _saying(step: Step) -> str:
    if step.reason is not None:
        return step.reason
    assert step.record is not None
    same = f", unchanged: {step.what}" if step.what else ""
    return f"nothing to do{same}, done {step.record.finished} (run {step.record.run})"


def _run_step(run: _Run, planner: Planner, step: Step) -> None:
    stage = step.stage
    context = StageContext(
        store_path=run.store_path,
        feature_set=feature_set_for(
            open_store(run.store_path) if versions(run.store_path) else None, getattr(stage.params, "features", None)
        ),
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
    )
    begin = time.perf_counter()
    try:
        # The old record goes first: killed in the middle, the stage must not count as done. A store that is not there
        # has none, and is not made before there is something to go in.
        if versions(run.store_path):
            with context.writer() as writer:
                writer.forget_stage(context.key())
                writer.commit()
        summary = stage.kind.run(context, stage.params)
        seconds = time.perf_counter() - begin
        _record(context, planner.done(step), summary, seconds)
    except KinedexError as fault:
        raise _failed(run, stage.name, str(fault), fault) from fault
    except OSError as fault:
        raise _failed(run, stage.name, f"{fault.filename or run.store_path}: {fault.strerror or fault}") from fault
    except MemoryError as fault:
        raise _failed(run, stage.name, "out of memory; fewer --workers need less") from fault
    run.terminal.say(f"done in {seconds:.1f} s")


def _failed(run: _Run, stage: str, reason: str, fault: KinedexError | None = None) -> StageFailed:
    said = f"stage {stage}: {reason}"
    if isinstance(fault, NewStoreError):
        return StageFailed(said)
    if fault is not None and fault.way_out is not None:
        name, value = fault.way_out
        return StageFailed(f"{said}\ngo on with:\n    {run.resume} --set {shlex.quote(f'{stage}.{name}={value}')}")
    return StageFailed(f"{said}\nwhen that is mended, go on with:\n    {run.resume}")


def _record(context: StageContext, step: Step, summary: Mapping[str, object], seconds: float) -> None:
    full = {
        **summary,
        "uses": step.stage.uses,
        "params": step.stage.params.model_dump(mode="json"),
        "inputs": dict(step.stage.inputs),
        "fingerprint_parts": step.parts,
    }
    with context.writer() as writer:
        writer.record_stage(StageRecord(context.key(), step.fingerprint, context.run, now(), round(seconds, 3), full))
        writer.commit()


def _resume(
    name: str | Path,
    store_path: Path,
    assignments: Mapping[str, str] | None,
    executor: str,
    workers: int | None,
    scheduler: str | None,
    force: frozenset[str],
) -> str:
    words = ["kinedex", "run", str(name), "--store", str(store_path)]
    for key, value in (assignments or {}).items():
        words += ["--set", f"{key}={value}"]
    words += ["--executor", executor] if executor != "processes" else []
    words += ["--workers", str(workers)] if workers is not None else []
    words += ["--scheduler", scheduler] if scheduler is not None else []
    for stage in sorted(force):
        words += ["--force", stage]
    return shlex.join(words)


def _outcome(pipeline: Pipeline, steps: list[Step], store_path: Path) -> Outcome:
    stages = open_store(store_path).manifest.stages
    left_out, report = 0, None
    for step in steps:
        summary = stages[f"{pipeline.name}/{step.stage.name}"].summary
        left_out += int(summary.get("left_out", 0))
        if step.stage.uses == "report":
            report = next((store_path / name for name in summary.get("files", ())), None)
    return Outcome(
        pipeline,
        tuple(step.stage.name for step in steps if step.reason is not None),
        tuple(step.stage.name for step in steps if step.reason is None),
        left_out,
        report,
    )


def new_run_id() -> str:
    """A short name for one run of one stage: the moment in UTC, and four random digits."""
    return f"{datetime.now(UTC):%Y%m%d-%H%M%S}-{secrets.token_hex(2)}"
