"""Tests, benchmarks and studies wait for another process for a bounded time only."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ("tests", "benchmarks", "studies")
OTHER_WAITS = {"tests/pipelines/engine/test_kernel_compilation.py"}
"""Files whose `wait` is of no process: that of all compilations, which takes no bound."""

RUN = {f"subprocess.{name}" for name in ("run", "call", "check_call", "check_output")}


def waits_without_a_bound(source: str) -> Iterator[int]:
    """Yield the lines of calls that wait for a process for as long as it runs."""
    if "subprocess" not in source:
        return
    for call in ast.walk(ast.parse(source)):
        if not isinstance(call, ast.Call) or {"timeout", None} & {keyword.arg for keyword in call.keywords}:
            continue
        if isinstance(call.func, ast.Attribute) and call.func.attr in ("wait", "communicate"):
            if not call.args:
                yield call.lineno
        elif ast.unparse(call.func) in RUN:
            yield call.lineno


def test_every_wait_for_a_process_has_a_bound() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{line}"
        for folder in FOLDERS
        for path in sorted((ROOT / folder).rglob("*.py"))
        if path.relative_to(ROOT).as_posix() not in OTHER_WAITS
        for line in waits_without_a_bound(path.read_text(encoding="utf-8"))
    ]
    assert not found, "timeout=… bounds a wait; with capture_output=True where the time is measured"


def test_waits_without_a_bound_are_found() -> None:
    lines = [
        "import subprocess",
        "subprocess.run(words)",
        "subprocess.run(words, timeout=9)",
        "subprocess.run(words, **options)",
        "process.wait()",
        "process.wait(9)",
        "process.communicate()",
        "process.communicate(timeout=9)",
    ]
    assert list(waits_without_a_bound("\n".join(lines))) == [2, 5, 7]
    assert not list(waits_without_a_bound("event.wait()"))
