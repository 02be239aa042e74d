"""The commands that reproduce the results of a pipeline run in a new store."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path

from kinedex.catalog.configs import config_path, read_text
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.engine.config import load_pipeline
from kinedex.pipelines.engine.file_parameters import with_absolute_paths
from kinedex.reports.data import StageRow
from kinedex.storage.store.history import PipelineRun, last_run


def command(pipeline: str, store_path: Path, records: Sequence[StageRow]) -> str:
    """Return the shell commands that repeat the last run of a pipeline in a new store beside this one.

    For a shipped pipeline it is `kinedex run` with every parameter that differs from the file, which does not need the
    store. Otherwise the first command writes a pipeline file from the store's history, because the original file may be
    gone, and the second one runs it.

    Parameters
    ----------
    pipeline : str
        Name of the pipeline.
    store_path : Path
        The directory of the store, absolute.
    records : sequence of StageRow
        The stages with their parameters.
    """
    again = store_path.with_name(f"{store_path.name}-again")
    run = last_run(store_path, pipeline)
    if run is None or _is_shipped(run):
        return _shipped_command(pipeline, again, records)
    file = f"{pipeline}-{run.run}.yaml"
    export = ["kinedex", "history", "export", str(store_path), run.run, "-o", file]
    return f"{shlex.join(export)}\n{shlex.join(['kinedex', 'run', file, '--store', str(again)])}"


def _is_shipped(run: PipelineRun) -> bool:
    """Return whether a run has used a shipped pipeline file and nothing that only its store has."""
    if run.files or run.mappings or run.other_sources or run.labels:
        return False
    try:
        return read_text(config_path("pipelines", run.pipeline)) == run.yaml
    except KinedexError:
        return False


def _shipped_command(pipeline: str, store_path: Path, records: Sequence[StageRow]) -> str:
    words = ["kinedex", "run", pipeline, "--store", str(store_path)]
    recorded = {record.stage: record.params for record in records}
    source = recorded.get("ingest", {}).get("source")
    settings = {} if source is None else {"source": str(Path(str(source)).expanduser().absolute())}
    try:
        planned = load_pipeline(pipeline, settings)
    except KinedexError:
        return f"{shlex.join(words)}    # with the file of pipeline “{pipeline}” in place of its name"
    for name, text in settings.items():
        words += ["--set", f"{name}={text}"]
    for stage in planned.stages:
        own = with_absolute_paths(type(stage.params), stage.params.model_dump(mode="json"))
        words += _differing(stage.name, own, with_absolute_paths(type(stage.params), recorded.get(stage.name, {})))
    return shlex.join(words)


def _differing(stage: str, own: Mapping[str, object], recorded: Mapping[str, object]) -> list[str]:
    words = []
    for key, value in recorded.items():
        if own.get(key) != value:
            words += ["--set", f"{stage}.{key}={_text(value)}"]
    return words


def _text(value: object) -> str:
    """Return a value as `--set` reads it: a text unchanged, anything else as JSON, which is YAML."""
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
