"""Runs of attacks, two at a time; each in a process of its own, so that one which crashes ends no other."""

from __future__ import annotations

import json
import shutil
import tempfile
import time
import traceback
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict
from multiprocessing import get_context
from pathlib import Path

from tests.attacks import bombs, flips, fuzz, kills, names, power_loss, races, sql_writes
from tests.attacks.outcome import Attack, Options, Outcome

ATTACKS: dict[str, Attack] = {
    "kills": kills.run,
    "power": power_loss.run,
    "fuzz": fuzz.run,
    "flips": flips.run,
    "names": names.run,
    "bombs": bombs.run,
    "races": races.run,
    "sql": sql_writes.run,
}
"""All attacks by name, in the order in which they begin: the long ones first."""

JOBS = 2
"""Attacks at the same time."""

FOLDER = Path("build") / "attack"


def results(names: list[str], options: Options) -> Iterator[tuple[str, Outcome, float]]:
    """Yield name, outcome and seconds of each attack as it ends."""
    with ThreadPoolExecutor(JOBS) as pool:
        for future in as_completed([pool.submit(_apart, name, options) for name in names]):
            yield future.result()


def _apart(name: str, options: Options) -> tuple[str, Outcome, float]:
    """Run an attack in a process of its own."""
    with ProcessPoolExecutor(1, get_context("spawn")) as process:
        try:
            return process.submit(run, name, options).result()
        except BrokenProcessPool as fault:
            return name, _raised(options, f"the process of the attack has died: {fault}"), 0.0


def _raised(options: Options, problem: str) -> Outcome:
    outcome = Outcome()
    outcome.fail(options.case or "", problem)
    return outcome


def run(name: str, options: Options) -> tuple[str, Outcome, float]:
    """Run one attack, write what it found to build/attack, and return its name, its outcome and the seconds."""
    begin = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="kinedex-attack-", dir=_quick_disk()) as folder:
        try:
            outcome = ATTACKS[name](Path(folder), options)
        except Exception:
            outcome = _raised(options, traceback.format_exc())
    seconds = time.perf_counter() - begin
    written = {
        "attack": name, "seed": options.seed, "size": options.size, "seconds": round(seconds, 1),
        "cases": outcome.cases, "counts": outcome.counts, "failures": [asdict(failure) for failure in outcome.failures],
    }  # fmt: skip
    (FOLDER / f"{name}.json").write_text(json.dumps(written, indent=1) + "\n", encoding="utf-8")
    return name, outcome, seconds


def _quick_disk() -> str | None:
    """Return the folder of a disk in memory, if there is a large one: no attack depends on a real disk."""
    memory = Path("/dev/shm")
    return str(memory) if memory.is_dir() and shutil.disk_usage(memory).free > 4 << 30 else None
