"""Listed kernels are compiled by several processes, and a demo calls no others."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from kinedex.ops.kernel_list import listed_calls
from kinedex.pipelines.engine import kernel_compilation
from kinedex.pipelines.engine.kernel_compilation import KernelCompilation, balanced
from tests.plain_python import PLAIN

ROOT = Path(__file__).resolve().parents[3]


@pytest.mark.parametrize("parts", [1, 2, 3, 64])
def test_every_listed_call_is_compiled_by_one_process(parts: int) -> None:
    calls = listed_calls()

    groups = balanced(calls, parts)

    assert sorted(call for group in groups for call in group) == sorted(calls)
    assert len(groups) <= parts
    assert all(groups)
    files = [{call.partition("(")[0].rpartition(".")[0] for call in group} for group in groups]
    assert sum(map(len, files)) == len(set().union(*files)), "kernels of one file call each other"


def test_processes_that_compile_come_to_an_end(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    calls = [call for call in listed_calls() if "._stuck(" in call or "_count_word_runs(" in call]
    assert len(calls) == 2
    monkeypatch.setattr(kernel_compilation, "listed_calls", lambda: ["kinedex.ops.bits.gone(int64)", *calls])
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))

    running = KernelCompilation(workers=2)
    running.wait()

    assert running.is_done
    compiled = {file.name.partition("-")[0] for file in tmp_path.rglob("*.nbc")}
    assert PLAIN or compiled >= {"motion_faults._stuck", "runs._count_word_runs"}


@pytest.mark.slow
@pytest.mark.skipif(PLAIN, reason="as plain Python nothing is compiled")
def test_a_demo_a_search_and_a_ranking_call_no_kernels_beside_the_list(tmp_path: Path) -> None:
    recorded = tmp_path / "recorded"
    recorded.mkdir()
    environment = {
        **os.environ,
        "PYTHONPATH": str(ROOT / "benchmarks" / "compilation_hook"),
        "KINEDEX_COMPILATIONS": str(recorded),
    }
    store = str(tmp_path / "store")
    for words in (
        ["demo", store, "--minutes", "1", "--executor", "serial"],
        ["search", store, "example"],
        ["rank", store, "--all"],
    ):
        done = subprocess.run(
            [sys.executable, "-m", "kinedex", *words], env=environment, capture_output=True, text=True, timeout=600
        )
        assert done.returncode == 0, done.stderr

    events = [json.loads(line) for file in recorded.glob("*.jsonl") for line in file.read_text().splitlines()]
    called = {event["request"] for event in events if "request" in event}
    assert called, "nothing was recorded"
    assert called <= set(listed_calls()), "python -m benchmarks.compilation --write makes the list anew"
