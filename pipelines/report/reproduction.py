"""The command that makes the results of a pipeline again."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path

from kinedex.ops.errors import KinedexError
from kinedex.pipelines.engine.config import load_pipeline
from kinedex.pipelines.report.data import StageRow


def command(pipeline: str, store_path: Path, records: Sequence[StageRow]) -> str:
    """Return the command that runs a shipped pipeline with the parameters that the store recorded.

    Every parameter that differs from the pipeline file's own is set. For a pipeline that is not shipped under its
    name the file is unknown: the command says so, and sets nothing.
    """
    words = ["kinedex", "run", pipeline, "--store", str(store_path)]
    recorded = {record.stage: record.params for record in records}
    source = recorded.get("ingest", {}).get("source")
    settings = {} if source is None else {"source": _text(source)}
    try:
        planned = load_pipeline(pipeline, settings)
    except KinedexError:
        return f"{shlex.join(words)}    # with the file of pipeline “{pipeline}” in place of its name"
    for name, text in settings.items():
        words += ["--set", f"{name}={text}"]
    for stage in planned.stages:
        own = stage.params.model_dump(mode="json")
        words += _differing(stage.name, own, recorded.get(stage.name, {}))
    return shlex.join(words)


def _differing(stage: str, own: Mapping[str, object], recorded: Mapping[str, object]) -> list[str]:
    words = []
    for key, value in recorded.items():
        if own.get(key) != value:
            words += ["--set", f"{stage}.{key}={_text(value)}"]
    return words


def _text(value: object) -> str:
    """A value as `--set` takes it: a text as it is, anything else as JSON, which is YAML."""
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
