"""The command that a report gives for making its results again repeats just what was done."""

from __future__ import annotations

import shlex
from itertools import pairwise
from pathlib import Path

import pytest

from kinedex.pipelines.engine.config import load_pipeline
from kinedex.reports.annotation_data import command
from kinedex.reports.report_data import StageRow


@pytest.mark.parametrize("source", ["/archive", "/my archive #1", "/a: b", "/it's 'here'", "/2024"])
def test_the_command_sets_what_was_set_to_the_letter(source: str) -> None:
    settings = {"source": source, "train": "actor = 'a: b' # c", "annotate.tau": "0.06", "queries": "[example]"}
    pipeline = load_pipeline("annotate", settings)
    records = [
        StageRow(stage.name, "run", "", 0.0, "", stage.params.model_dump(mode="json")) for stage in pipeline.stages
    ]
    words = shlex.split(command("annotate", Path("/store"), records))
    assigned = dict(word.split("=", 1) for flag, word in pairwise(words) if flag == "--set")
    again = load_pipeline("annotate", assigned)
    assert [stage.params for stage in again.stages] == [stage.params for stage in pipeline.stages]
