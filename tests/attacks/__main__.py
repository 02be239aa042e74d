"""`python -m tests.attacks`: all attacks, with a table at the end, and JSON in build/attack.

An attack that raises has failed, with its traceback, and the others go on. Sizes: `--sample` tries a few cases of each
attack (about two minutes of CPU for all), without an option each tries hundreds, and `--nightly` takes hours.
"""

from __future__ import annotations

import argparse
import os
import sys

from tests.attacks.outcome import Options, Outcome
from tests.attacks.runs import ATTACKS, FOLDER, results

MAX_SHOWN = 20


def main() -> int:
    """Run the attacks; return 1 if any of them succeeded or raised."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.attacks", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("attacks", nargs="*", metavar="ATTACK", help=f"of {', '.join(ATTACKS)}; all unless given")
    parser.add_argument("--seed", type=int, default=0, help="the same seed makes the same cases")
    size = parser.add_mutually_exclusive_group()
    size.add_argument("--sample", dest="size", action="store_const", const="sample", help="a few cases of each")
    size.add_argument("--nightly", dest="size", action="store_const", const="nightly", help="takes hours")
    parser.add_argument("--case", help="repeat this one case of the one attack that is given")
    given = parser.parse_args()
    unknown = [name for name in given.attacks if name not in ATTACKS]
    if unknown:
        parser.error(f"no attack '{unknown[0]}'; known: {', '.join(ATTACKS)}")
    if given.case is not None and len(given.attacks) != 1:
        parser.error("--case needs the name of one attack")
    options = Options(given.seed, given.size or "ordinary", given.case)
    FOLDER.mkdir(parents=True, exist_ok=True)
    found = {}
    for name, outcome, seconds in results(given.attacks or list(ATTACKS), options):
        found[name] = outcome, seconds
        _show(name, outcome, options)
    print(table(found, options))
    return int(any(outcome.failures for outcome, _ in found.values()))


def _show(name: str, outcome: Outcome, options: Options) -> None:
    print(name)
    for kind, count in outcome.counts.items():
        print(f"  {kind:34} {count:9,}")
    for failure in outcome.failures[:MAX_SHOWN]:
        if not failure.case:
            print(failure.problem.rstrip())
        print(f"  FAILED {failure.problem.strip().splitlines()[-1][:300]}\n    {command(name, failure.case, options)}")
    if len(outcome.failures) > MAX_SHOWN:
        print(f"  … and {len(outcome.failures) - MAX_SHOWN} more in {FOLDER / name}.json")
    sys.stdout.flush()


def command(name: str, case: str, options: Options) -> str:
    """Return the command that repeats one case, or the whole attack where it raised."""
    size = "" if options.size == "ordinary" else f" --{options.size}"
    again = f" --case '{case}'" if case else ""
    return f"{os.path.relpath(sys.executable)} -m tests.attacks {name} --seed {options.seed}{size}{again}"


def table(found: dict[str, tuple[Outcome, float]], options: Options) -> str:
    """Return the table of all attacks: cases, failures and seconds."""
    listed = [(name, *found[name]) for name in ATTACKS if name in found]
    rows = [(name, outcome.cases, len(outcome.failures), seconds) for name, outcome, seconds in listed]
    rows.append(("all", *(sum(column) for column in list(zip(*rows, strict=True))[1:])))
    lines = [f"{options.size} size, seed {options.seed}", f"{'attack':8} {'cases':>9} {'failures':>9} {'seconds':>8}"]
    lines += [f"{name:8} {cases:9,} {failures:9,} {seconds:8.0f}" for name, cases, failures, seconds in rows]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
