"""Plan a run: decide which stages run, and why; fingerprints show which stages are up to date."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, replace
from pathlib import Path

from kinedex.ops.errors import KinedexError
from kinedex.pipelines.engine.code_digest import code_digest, part_digest
from kinedex.pipelines.engine.config import Pipeline, PipelineStage
from kinedex.pipelines.engine.digests import Reading
from kinedex.pipelines.engine.stage import STAGES, TAKES, Stage
from kinedex.storage.snapshot.manifest import StageRecord
from kinedex.storage.snapshot.manifest_files import versions
from kinedex.storage.store.history import wrong_files
from kinedex.storage.store.store import Store, open_store

FORCED = "--force"
"""The reason given for a stage that `--force` names."""

NEVER = "has not run yet"


@dataclass(frozen=True)
class Step:
    """One stage of a plan.

    Attributes
    ----------
    stage : PipelineStage
        The stage.
    parts : dict of str to str
        The hash of each part of the fingerprint, by the name of the part.
    record : StageRecord or None
        The record of the last run of the stage.
    reason : str or None
        The reason why the stage runs; None if it does not run.
    what : str
        A description of the takes that the stage reads; empty if it depends on all takes of the store.
    """

    stage: PipelineStage
    parts: dict[str, str]
    record: StageRecord | None
    reason: str | None
    what: str = ""

    @property
    def fingerprint(self) -> str:
        """The hash of all parts of the fingerprint."""
        return _hash(self.parts)


class Planner:
    """Decides which stages run and why, one stage at a time, by the current state of the store.

    A stage is skipped if the store holds a record with its fingerprint (see `engine.stage.Stage`). For a stage with a
    `reading`, only the takes that it reads count, and not the stage that ingested them.

    The attribute `pipeline` is the given pipeline with parameters that the store remembers in place of those that the
    user left unset (`Stage.with_remembered`).

    Parameters
    ----------
    pipeline : Pipeline
        The pipeline.
    store_path : Path
        The store, which need not exist.
    force : frozenset of str
        Names of stages that run in any case.
    """

    def __init__(self, pipeline: Pipeline, store_path: Path, force: frozenset[str] = frozenset()) -> None:
        for name in force:
            pipeline.stage(name)
        self.pipeline = _with_remembered(pipeline, store_path)
        self.store_path = store_path
        self.force = force
        self._fingerprints: dict[str, str] = {}
        self._running: set[str] = set()
        self._done: set[str] = set()

    def step(self, stage: PipelineStage) -> Step:
        """Return the step of a stage; call this for the stages in the order of the pipeline."""
        store = existing_store(self.store_path)
        record = store.manifest.stages.get(f"{self.pipeline.name}/{stage.name}") if store else None
        reading = _reading(stage, store)
        parts = self._parts(stage, store, reading)
        reason = FORCED if stage.name in self.force else _reason(record, parts)
        if reason == NEVER and store is not None and _elsewhere(store, self.pipeline.name, stage):
            reason = f"not run yet by the pipeline '{self.pipeline.name}' (but by another)"
        if reason is None and store is not None and record is not None:
            reason = _gone(stage, store, record)
        if reason is None:
            reason = self._upstream(stage, reading)
        return self.follow(Step(stage, parts, record, reason, reading.what if reading else ""))

    def follow(self, step: Step) -> Step:
        """Register a step that was already planned as the next one, and return it."""
        if step.reason is not None:
            self._running.add(step.stage.name)
        self._fingerprints[step.stage.name] = step.fingerprint
        return step

    def done(self, step: Step) -> Step:
        """Return the step of a stage that has just run, with a hash of the takes that the store now has."""
        self._done.add(step.stage.name)
        if "takes" not in step.parts:
            return step  # its fingerprint covers the takes that it has read
        done = replace(step, parts={**step.parts, "takes": _takes(existing_store(self.store_path))})
        self._fingerprints[step.stage.name] = done.fingerprint
        return done

    def _upstream(self, stage: PipelineStage, reading: Reading | None) -> str | None:
        """Return the reason if a stage runs only because an earlier stage runs; None otherwise."""
        for role, name in stage.inputs.items():
            if name in self._running and (reading is None or role != TAKES):
                return f"{name} runs"
            if name in self._running and name not in self._done:
                return f"{name} runs, which may change the takes that it reads"
        return None

    def _parts(self, stage: PipelineStage, store: Store | None, reading: Reading | None) -> dict[str, str]:
        """Return the parts of the fingerprint of a stage."""
        parts = {
            "code": _code(stage),
            "parameters": _hash(stage.params.model_dump(mode="json")),
            "files": stage.kind.external_digest(stage.params, store),
            **({"takes": _takes(store)} if reading is None else {"reading": reading.digest}),
        }
        inputs = {name for role, name in stage.inputs.items() if reading is None or role != TAKES}
        return parts | {f"input {name}": self._fingerprints[name] for name in sorted(inputs)}


def make_plan(pipeline: Pipeline, store_path: Path, force: frozenset[str] = frozenset()) -> list[Step]:
    """Return the steps of a pipeline on a store, without changing anything.

    Parameters
    ----------
    pipeline : Pipeline
        The pipeline.
    store_path : Path
        The store, which need not exist.
    force : frozenset of str
        Names of stages that run in any case.

    Raises
    ------
    KinedexError
        No stage has a name of `force`, or a file that a stage reads is invalid.
    """
    planner = Planner(pipeline, store_path, force)
    return [planner.step(stage) for stage in planner.pipeline.stages]


def _with_remembered(pipeline: Pipeline, store_path: Path) -> Pipeline:
    """Return the pipeline, with unset parameters replaced by remembered values."""
    store = existing_store(store_path)
    if store is None:
        return pipeline
    stages = (
        replace(stage, params=stage.kind.with_remembered(stage.params, stage.unset, store)) for stage in pipeline.stages
    )
    return replace(pipeline, stages=tuple(stages))


def existing_store(path: Path) -> Store | None:
    """Return the newest version of a store, or None if the store does not exist yet."""
    return open_store(path, at="newest") if versions(path) else None


def _reading(stage: PipelineStage, store: Store | None) -> Reading | None:
    """Return the digest of the takes that a stage reads; None if it depends on all takes of the store."""
    if type(stage.kind).reading is Stage.reading:
        return None
    try:
        return stage.kind.reading(stage.params, store) if store else Reading("", "")
    except KinedexError:
        # the stage runs and reports the error, as the takes may have changed by then
        return Reading("cannot be read", "")


def _takes(store: Store | None) -> str:
    return store.manifest.content_digest() if store else ""


def _elsewhere(store: Store, pipeline: str, stage: PipelineStage) -> bool:
    """Return whether a stage of this kind has run in another pipeline."""
    others = (record for key, record in store.manifest.stages.items() if key.partition("/")[0] != pipeline)
    return any(record.summary.get("uses") == stage.uses for record in others)


def _reason(record: StageRecord | None, parts: dict[str, str]) -> str | None:
    if record is None:
        return NEVER
    if record.fingerprint == _hash(parts):
        return None
    before = record.summary.get("fingerprint_parts", {})
    changed = [name for name in parts if before.get(name) != parts[name]]
    phrases = {
        "code": "kinedex itself changed",
        "parameters": "its parameters changed",
        "files": "its files changed",
        "takes": "the store's takes changed",
        "reading": "the takes that it reads changed",
    }
    return (
        "; ".join(phrases.get(name, name.removeprefix("input ") + " changed") for name in changed)
        or "its inputs changed"
    )


def _gone(stage: PipelineStage, store: Store, record: StageRecord) -> str | None:
    """Return a message about the first result of a stage that is missing or damaged; None if all are in place."""
    if not stage.kind.is_current(store):
        return "what it made is gone or stale"
    for name, problem in wrong_files(store.path, [record]):
        return f"{name} is gone" if problem == "is missing" else f"{name}: {problem}"
    return None


def _code(stage: PipelineStage) -> str:
    """Return a hash of the code of a stage, and of the plugins that its parameters name."""
    own = part_digest(STAGES, stage.uses) or code_digest(type(stage.kind))
    named = [part_digest(parts, name) for parts, name in stage.kind.named_parts(stage.params)]
    return _hash([own, *named]) if any(named) else own


def _hash(value: object) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:16]
