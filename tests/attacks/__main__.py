"""`python -m tests.attacks`: all attacks, with a table of counts, and JSON in build/attack."""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import tempfile
import time
from dataclasses import asdict
from pathlib import Path

from tests.attacks import bombs, flips, fuzz, kills, names, power_loss, races, sql_writes
from tests.attacks.outcome import Attack, Options, Outcome

ATTACKS: dict[str, Attack] = {
    "sql": sql_writes.run,
    "bombs": bombs.run,
    "flips": flips.run,
    "kills": kills.run,
    "power": power_loss.run,
    "races": races.run,
    "fuzz": fuzz.run,
    "names": names.run,
}
"""All attacks by name, in the order in which they run."""

FOLDER = Path("build") / "attack"

MOST_SHOWN = 20


def main() -> int:
    """Run the attacks; return 1 if any of them succeeded."""
    parser = argparse.ArgumentParser(prog="python -m tests.attacks", description=__doc__)
    parser.add_argument("attacks", nargs="*", metavar="ATTACK", help=f"of {', '.join(ATTACKS)}; all unless given")
    parser.add_argument("--seed", type=int, default=0, help="the same seed makes the same cases")
    parser.add_argument("--nightly", action="store_true", help="the full size, which takes hours")
    parser.add_argument("--case", help="repeat this one case of the one attack that is given")
    given = parser.parse_args()
    unknown = [name for name in given.attacks if name not in ATTACKS]
    if unknown:
        parser.error(f"no attack '{unknown[0]}'; known: {', '.join(ATTACKS)}")
    if given.case is not None and len(given.attacks) != 1:
        parser.error("--case needs the name of one attack")
    options = Options(given.seed, given.nightly, given.case)
    FOLDER.mkdir(parents=True, exist_ok=True)
    failed = [name for name in given.attacks or ATTACKS if run(name, options).failures]
    print(f"succeeded: {', '.join(failed)}" if failed else "no attack succeeded")
    return int(bool(failed))


def run(name: str, options: Options) -> Outcome:
    """Run one attack, print its table, and write it to build/attack."""
    begin = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="kinedex-attack-", dir=_quick_disk()) as folder:
        outcome = ATTACKS[name](Path(folder), options)
    seconds = time.perf_counter() - begin
    _show(name, outcome, seconds, options)
    written = {
        "attack": name, "seed": options.seed, "nightly": options.nightly, "seconds": round(seconds, 1),
        "counts": outcome.counts, "failures": [asdict(failure) for failure in outcome.failures],
    }  # fmt: skip
    (FOLDER / f"{name}.json").write_text(json.dumps(written, indent=1) + "\n", encoding="utf-8")
    return outcome


def _quick_disk() -> str | None:
    """Return the folder of a disk in memory, if there is a large one: no attack depends on a real disk."""
    memory = Path("/dev/shm")
    return str(memory) if memory.is_dir() and shutil.disk_usage(memory).free > 4 << 30 else None


def _show(name: str, outcome: Outcome, seconds: float, options: Options) -> None:
    print(f"{name:36} {'':>9} {seconds:7.0f} s, {len(outcome.failures)} failures")
    for kind, count in outcome.counts.items():
        print(f"  {kind:34} {count:9,}")
    for failure in outcome.failures[:MOST_SHOWN]:
        print(f"  FAILED {failure.problem.strip().splitlines()[-1][:300]}\n    {command(name, failure.case, options)}")
    if len(outcome.failures) > MOST_SHOWN:
        print(f"  … and {len(outcome.failures) - MOST_SHOWN} more in {FOLDER / name}.json")
    sys.stdout.flush()


def command(name: str, case: str, options: Options) -> str:
    """Return the command that repeats one case."""
    nightly = " --nightly" if options.nightly else ""
    return f"{os.path.relpath(sys.executable)} -m tests.attacks {name} --seed {options.seed}{nightly} --case '{case}'"


if __name__ == "__main__":
    sys.exit(main())
