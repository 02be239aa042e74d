"""A question puts off the first search for unreachable objects, and only that."""

from __future__ import annotations

import json
import subprocess
import sys

from kinedex.commands.cli import FIRST

PUT_OFF = """
import gc, json, sys
usual = gc.get_threshold()
from kinedex.commands.cli import delay_collection
delay_collection(); delay_collection()
before = gc.get_threshold()
kept = [[] for _ in range(before[0] + 10)]
print(json.dumps([usual, before, gc.get_threshold(), len(gc.callbacks)]))
"""
COMMAND = """
import gc, sys
sys.argv = ["kinedex", *{words!r}]
from kinedex.commands.cli import main
try:
    main()
except SystemExit:
    print(gc.get_threshold()[0], file=sys.stderr)
"""


def run(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)


def test_after_the_first_collection_python_collects_as_always() -> None:
    usual, before, after, left = json.loads(run(PUT_OFF).stdout)
    assert (before[0], before[1:]) == (FIRST, usual[1:])
    assert (after, left) == (usual, 0)


def test_questions_put_it_off_and_what_runs_pipelines_does_not() -> None:
    first = {word: int(run(COMMAND.format(words=[word, "--help"])).stderr) for word in ("takes", "rank", "run")}
    assert first == {"takes": FIRST, "rank": FIRST, "run": first["run"]}
    assert first["run"] < 10_000
