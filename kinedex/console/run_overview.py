"""Describe the pipeline runs of a store: a table of all runs, the details of one run, and the changes between runs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa

from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.storage.formats.json_text import setting_text
from kinedex.storage.snapshot.manifest_files import read_version, versions
from kinedex.storage.store.history import PipelineRun, StageRun

FIRST = "first run"

_MAX_CHARACTERS = 60
"""The largest number of characters of a value in the description of a change."""


def find_run(runs: Sequence[PipelineRun], wanted: str, store: Path) -> PipelineRun:
    """Return the run that a user has named.

    Parameters
    ----------
    runs : sequence of PipelineRun
        The runs of the store, oldest first.
    wanted : str
        The id of the run, the beginning of the id, or the name of a pipeline, which selects its last run.
    store : Path
        The directory of the store, for messages.

    Raises
    ------
    KinedexError
        No run has this id, or several ids begin with this text.
    """
    of_pipeline = [run for run in runs if run.pipeline == wanted]
    fitting = [run for run in runs if run.run == wanted] or of_pipeline[-1:]
    fitting = fitting or [run for run in runs if wanted and run.run.startswith(wanted)]
    if len(fitting) == 1:
        return fitting[0]
    look = f"`kinedex history list {store}` lists them"
    if fitting:
        raise KinedexError(f"{len(fitting)} runs begin with '{wanted}'; {look}")
    names = [*(run.run for run in runs), *{run.pipeline for run in runs}]
    raise KinedexError(f"{store}: no pipeline run is named '{wanted}'{did_you_mean(wanted, names)}; {look}")


def run_changes(run: PipelineRun, before: PipelineRun | None) -> list[str]:
    """Return the differences between a run and the run of the same pipeline before it, as text.

    Parameters
    ----------
    run : PipelineRun
        The run.
    before : PipelineRun or None
        The run before it; None for the first one.
    """
    if before is None:
        return [FIRST]
    found = list(_changed_parameters(run, before))
    if run.yaml != before.yaml and not found:
        found.append("another pipeline file")
    if run.kinedex != before.kinedex and before.kinedex:
        found.append(f"kinedex {before.kinedex} → {run.kinedex}")
    if run.takes != before.takes:
        found.append(f"{run.takes - before.takes:+,} takes")
    if not found:
        stages = {stage.stage for stage in run.stages}
        found = [f"{one.stage}: {one.reason}" for one in run.ran if one.reason and not _follows(one.reason, stages)]
    return found or ["nothing"]


def _follows(reason: str, stages: set[str]) -> bool:
    """Return whether a stage ran only because another stage of the run did."""
    return reason.endswith(" runs") and reason.removesuffix(" runs") in stages


def _changed_parameters(run: PipelineRun, before: PipelineRun) -> Iterator[str]:
    earlier = {stage.stage: stage for stage in before.stages}
    for stage in run.stages:
        if stage.stage not in earlier:
            yield f"new stage {stage.stage}"
            continue
        then = earlier.pop(stage.stage).params
        for key, value in stage.params.items():
            if key not in then or then[key] != value:
                yield f"{stage.stage}.{key}: {_short(then.get(key))} → {_short(value)}"
    yield from (f"without stage {name}" for name in earlier)


def _short(value: Any) -> str:
    text = setting_text(value)
    return text if len(text) <= _MAX_CHARACTERS else f"{text[: _MAX_CHARACTERS - 1]}…"


def versions_with_results(store: Path) -> dict[str, int]:
    """Return the newest version that holds the results of each stage run, by the id of that stage run."""
    found: dict[str, int] = {}
    for version in versions(store):
        try:
            records = read_version(store, version).stages
        except KinedexError:
            continue
        found |= {record.run: version for record in records.values()}
    return found


def results_of(run: PipelineRun, places: dict[str, int], newest: int) -> str:
    """Describe where the results of a run are: newest version, version 12, partly gone, gone; none if no stage ran."""
    found = [places.get(stage.run) for stage in run.ran]
    if not found:
        return "none"
    if None in found:
        return "gone" if not any(found) else "partly gone"
    oldest = min(version for version in found if version is not None)
    return "newest version" if oldest == newest else f"version {oldest}"


def previous_runs(runs: Sequence[PipelineRun]) -> dict[str, PipelineRun | None]:
    """Return for each run, by its id, the run of the same pipeline before it."""
    last: dict[str, PipelineRun] = {}
    found: dict[str, PipelineRun | None] = {}
    for run in runs:
        found[run.run] = last.get(run.pipeline)
        last[run.pipeline] = run
    return found


def runs_table(store: Path, every: Sequence[PipelineRun], shown: Sequence[PipelineRun]) -> pa.Table:
    """Return runs as a table for people, the newest last.

    Parameters
    ----------
    store : Path
        The directory of the store.
    every : sequence of PipelineRun
        All runs of the store, oldest first.
    shown : sequence of PipelineRun
        The runs that the table shows.
    """
    before, places, newest = previous_runs(every), versions_with_results(store), versions(store)[-1]
    rows = [
        {
            "run": run.run,
            "pipeline": run.pipeline,
            "begun": run.begun or run.finished,
            "state": run.state,
            "seconds": run.seconds,
            "stages": f"{len(run.ran)} of {len(run.stages)} ran",
            "takes": run.takes,
            "results": results_of(run, places, newest),
            "kinedex": run.kinedex or None,
            "changes": "; ".join(run_changes(run, before[run.run])),
        }
        for run in shown
    ]
    text = pa.string()
    kinds = {"run": text, "pipeline": text, "begun": text, "state": text, "seconds": pa.float64(), "stages": text}
    kinds |= {"takes": pa.int64(), "results": text, "kinedex": text, "changes": text}
    return pa.Table.from_pylist(rows, schema=pa.schema(list(kinds.items())))


def run_lines(run: PipelineRun, before: PipelineRun | None, results: str) -> Iterator[str]:
    """Yield the details of a run as lines of text."""
    yield f"pipeline run {run.run} of {run.pipeline}: {run.state}"
    facts = {
        "begun": run.begun,
        "finished": run.finished,
        "seconds": f"{run.seconds:g}",
        "kinedex": run.kinedex,
        "command": run.command,
        "pipeline file": run.path,
        "results": results,
        "takes": f"{run.takes:,}",
        "labels": f"{run.labels:,}" if run.labels else "",
        "changes": "; ".join(run_changes(run, before)),
        "problem": run.problem,
    }
    yield from (f"  {name:14} {value}" for name, value in facts.items() if value)
    yield from _block("settings", (f"{name} = {setting_text(value)}" for name, value in run.settings.items()))
    yield from _block("sources", _source_lines(run))
    yield from _block("files that it kept", (f"{kept.path} (sha256 {kept.sha256[:12]})" for kept in run.files))
    yield from _block("skeleton mappings of the store", run.mappings)
    for stage in run.stages:
        yield from _stage_lines(stage)


def _block(title: str, lines: Any) -> Iterator[str]:
    found = list(lines)
    if found:
        yield f"{title}:"
        yield from (f"  {line}" for line in found)


def _source_lines(run: PipelineRun) -> Iterator[str]:
    for root in run.sources:
        yield root
    for stage in run.stages:
        yield from (f"  pattern {pattern}" for pattern in stage.given.get("patterns", ()))
        if stage.params.get("skeleton"):
            yield f"  skeleton {stage.params['skeleton']}"
    for root in run.other_sources:
        yield f"{root} (brought in by earlier runs)"


def _stage_lines(stage: StageRun) -> Iterator[str]:
    kind = f" ({stage.uses})" if stage.uses != stage.stage else ""
    reason = f", reason: {stage.reason}" if stage.reason else ""
    yield f"stage {stage.stage}{kind}: {stage.state}{reason}"
    if stage.finished:
        yield f"  run {stage.run}, {stage.finished}, {stage.seconds:g} s, fingerprint {stage.fingerprint}"
    yield from (
        f"  {key} = {setting_text(value)}{'' if key in stage.given else '   (default)'}"
        for key, value in stage.params.items()
    )
    yield from (f"  → {key}: {setting_text(value)}" for key, value in stage.summary.items())
