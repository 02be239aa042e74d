"""`python -m benchmarks.compilation [--warm] [--write] [COMMAND …]`: what numba compiles while a command runs.

Runs the command with an empty cache of kernels and watches every process of it: without a command the demo on three
minutes of motion, a search and a ranking. Prints kernels, signatures and processor seconds. `--warm` compiles the list
of kernels first, `--write` makes the list anew; without it, calls that are not in the list end it with exit code 1.
"""

from __future__ import annotations

import argparse
import collections
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from kinedex.ops.kernel_list import LIST, listed_calls

HOOK = Path(__file__).parent / "compilation_hook"

HEAD = """\
# The kernels that the first search and the demo call, with the types of their arguments, in the order of first need.
# Made by `python -m benchmarks.compilation --write`.
"""


def main(words: Sequence[str]) -> int:
    """Run the command, print the figures, and return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.compilation", description=__doc__)
    parser.add_argument("--warm", action="store_true", help="compile the list of kernels first")
    parser.add_argument("--write", action="store_true", help="make the list of kernels anew")
    parser.add_argument("--most", type=int, default=20, help="the dearest kernels are printed")
    parser.add_argument("command", nargs=argparse.REMAINDER)
    asked = parser.parse_args(words)
    with tempfile.TemporaryDirectory(prefix="kinedex-compilation-") as folder:
        root = Path(folder)
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(root / "cache")}
        if asked.warm:
            began = time.monotonic()
            events = watched(
                [[sys.executable, "-m", "kinedex.pipelines.engine.kernel_compilation"]], root / "w", environment
            )
            print(f"the list, compiled before, {time.monotonic() - began:.1f} s with the start of its processes:")
            show(events, 0)
        began = time.monotonic()
        events = watched([asked.command] if asked.command else _usual(root, asked.write), root / "c", environment)
        print(f"{' '.join(asked.command) or 'demo, search, rank'}, {time.monotonic() - began:.1f} s in all:")
        show(events, asked.most)
    calls = list(dict.fromkeys(event["request"] for event in events if "request" in event))
    if asked.command:
        return 0
    if asked.write:
        LIST.write_text(HEAD + "".join(f"{call}\n" for call in calls), encoding="utf-8")
        return 0
    missing = sorted(set(calls) - set(listed_calls()))
    print(*(f"not in {LIST.name}: {call}" for call in missing), sep="\n")
    return int(bool(missing))


def _usual(root: Path, alone: bool) -> list[list[str]]:
    """Return the commands of the first minutes; alone, nothing but what they call themselves is compiled."""
    program = [sys.executable, "-m", "kinedex"]
    store = str(root / "store")
    return [
        [*program, "demo", store, "--minutes", "3", *(["--executor", "serial"] if alone else [])],
        [*program, "search", store, "example"],
        [*program, "rank", store, "--all"],
    ]


def watched(commands: Sequence[Sequence[str]], folder: Path, environment: dict[str, str]) -> list[dict[str, Any]]:
    """Run commands, and return what the hook recorded in all their processes."""
    folder.mkdir()
    path = os.pathsep.join(filter(None, (str(HOOK), os.environ.get("PYTHONPATH"))))
    for command in commands:
        told = {**environment, "PYTHONPATH": path, "KINEDEX_COMPILATIONS": str(folder)}
        done = subprocess.run(
            command,
            env=told,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
            timeout=3600,
        )
        if done.returncode:
            print(done.stdout)
            raise SystemExit(f"{' '.join(command)} ended with exit code {done.returncode}")
    files = sorted(folder.glob("*.jsonl"), key=lambda file: file.stat().st_mtime)
    return [json.loads(line) for file in files for line in file.read_text(encoding="utf-8").splitlines()]


def show(events: Sequence[dict[str, Any]], most: int) -> None:
    """Print the figures of compilations, and the dearest kernels."""
    compiled = [event for event in events if "kernel" in event]
    ours = [event for event in compiled if event["kernel"].startswith("kinedex.")]
    kinds = collections.Counter((event["kernel"], event["types"]) for event in ours)
    waited = [event["seconds"] for event in events if event.get("compiled")]
    loaded = [event["seconds"] for event in events if event.get("compiled") is False]
    signatures = collections.Counter(kernel for kernel, _ in kinds)
    print(f"    compilations: {len(compiled)}, {sum(event['cpu'] for event in compiled):.1f} s of processor time")
    print(
        f"    kernels of kinedex: {len(signatures)}, {len(kinds)} with their signatures, "
        f"{sum(event['cpu'] for event in ours):.1f} s; compiled more than once: {len(ours) - len(kinds)}"
    )
    print(f"    requests that waited for compilation: {len(waited)}, {sum(waited):.1f} s of their processes")
    print(f"    requests that the cache served: {len(loaded)}, {sum(loaded):.1f} s")
    cost: dict[str, float] = collections.defaultdict(float)
    for event in compiled:
        cost[event["kernel"]] += event["cpu"]
    for kernel, seconds in sorted(cost.items(), key=lambda item: -item[1])[:most]:
        print(f"    {seconds:6.2f} s  {kernel}, signatures: {signatures.get(kernel, 0) or 'of numba'}")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
