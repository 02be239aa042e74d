"""The command that reproduces the results of a pipeline."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path

from kinedex.ops.errors import KinedexError
from kinedex.pipelines.engine.config import load_pipeline
from kinedex.pipelines.report.data import StageRow


def command(pipeline: str, store_path: Path, records: Sequence[StageRow]) -> str:
    """Return the command that runs a shipped pipeline with the parameters recorded in the store.

    The command sets every parameter that differs from the file of the pipeline. The file of a pipeline that is not
    shipped is unknown; the command then has a comment instead of settings.
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
    """Return a value as `--set` reads it: a text unchanged, anything else as JSON, which is YAML."""
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
