"""The runner: carries a plan out, stage by stage, and records in the store what is done."""

from __future__ import annotations

import secrets
import shlex
import time
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from catalog.features import load_feature_set
from ops.errors import KinedexError
from pipelines.config import Pipeline, load_pipeline
from pipelines.context import StageContext
from pipelines.executors import Executor, make_executor
from pipelines.plan import Step, fingerprint_parts, make_plan
from pipelines.terminal import Terminal
from storage.manifest import StageRecord, now
from storage.store import open_store
from storage.writer import StoreWriter


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


def run_pipeline(
    name_or_path: str | Path,
    store_path: Path,
    *,
    assignments: Mapping[str, str] | None = None,
    executor: str = "processes",
    workers: int | None = None,
    scheduler: str | None = None,
    force: frozenset[str] = frozenset(),
    terminal: Terminal | None = None,
) -> Outcome:
    """Run what is not done yet of a pipeline.

    Raises
    ------
    StageFailed: a stage could not finish; what earlier stages committed stays.
    KinedexError: the pipeline file or the store is not usable; nothing was changed.
    """
    terminal = terminal or Terminal()
    pipeline = load_pipeline(name_or_path, assignments)
    plan = make_plan(pipeline, store_path, force)
    pool = make_executor(executor, workers, scheduler)
    try:
        pool.check(store_path)
        for number, step in enumerate(plan, 1):
            terminal.heading(f"[{number}/{len(plan)}] {step.stage.name}: {_saying(step)}")
            if step.reason is not None:
                _run_step(pipeline, step, store_path, pool, terminal, _resume(name_or_path, store_path, assignments))
    finally:
        pool.close()
    return _outcome(pipeline, plan, store_path)


def _saying(step: Step) -> str:
    if step.reason is not None:
        return step.reason
    assert step.record is not None
    return f"nothing to do, done {step.record.finished} (run {step.record.run})"


def _run_step(
    pipeline: Pipeline, step: Step, store_path: Path, pool: Executor, terminal: Terminal, resume: str
) -> None:
    stage = step.stage
    context = StageContext(
        store_path=store_path,
        feature_set=load_feature_set("body40"),
        pipeline=pipeline.name,
        stage=stage.name,
        run=new_run_id(),
        executor=pool,
        terminal=terminal,
        inputs=dict(stage.inputs),
        params={other.name: other.params for other in pipeline.stages},
    )
    begin = time.perf_counter()
    try:
        summary = stage.run(context, stage.params)
    except KinedexError as fault:
        raise StageFailed(f"stage {stage.name}: {fault}\nwhen that is mended, go on with:\n    {resume}") from fault
    seconds = time.perf_counter() - begin
    summary = {
        **summary,
        "uses": stage.uses,
        "params": stage.params.model_dump(mode="json"),
        "inputs": dict(stage.inputs),
        "fingerprint_parts": _recorded_parts(pipeline, step, store_path),
    }
    with StoreWriter.open(store_path, context.feature_set) as writer:
        writer.record_stage(
            StageRecord(context.key(), step.fingerprint, context.run, now(), round(seconds, 3), summary)
        )
        writer.commit()
    terminal.say(f"done in {seconds:.1f} s")


def _recorded_parts(pipeline: Pipeline, step: Step, store_path: Path) -> dict[str, str]:
    """The parts of the fingerprint, so that the next plan can say which of them changed."""
    stages = open_store(store_path).manifest.stages
    inputs = {name: stages[f"{pipeline.name}/{name}"].fingerprint for name in step.stage.inputs.values()}
    return fingerprint_parts(step.stage, inputs)


def _resume(name: str | Path, store_path: Path, assignments: Mapping[str, str] | None) -> str:
    words = ["kinedex", "run", str(name), "--store", str(store_path)]
    for key, value in (assignments or {}).items():
        words += ["--set", f"{key}={value}"]
    return shlex.join(words)


def _outcome(pipeline: Pipeline, plan: list[Step], store_path: Path) -> Outcome:
    stages = open_store(store_path).manifest.stages
    left_out, report = 0, None
    for step in plan:
        summary = stages[f"{pipeline.name}/{step.stage.name}"].summary
        left_out += int(summary.get("left_out", 0))
        if step.stage.uses == "report":
            path = store_path / "results" / "reports" / pipeline.name / "report.html"
            report = path if path.is_file() else None
    return Outcome(
        pipeline,
        tuple(step.stage.name for step in plan if step.reason is not None),
        tuple(step.stage.name for step in plan if step.reason is None),
        left_out,
        report,
    )


def new_run_id() -> str:
    """A short name for one run of one stage: the moment in UTC, and four random digits."""
    return f"{datetime.now(UTC):%Y%m%d-%H%M%S}-{secrets.token_hex(2)}"
