"""`python -m benchmarks.against COMMIT [PART …]`: time this checkout beside another commit, in one run by turns."""

from __future__ import annotations

import argparse
import shutil
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from benchmarks.against.commits import FIRST, ROOT, Side, UnknownCommitError, newest_tag, other_side, this_side
from benchmarks.against.comparison import Compared, compare, show, value_of, write
from benchmarks.against.guarded_figures import FILE, Guarded, guarded_figures
from benchmarks.against.inputs import inputs
from benchmarks.against.rivals import rival_rows
from benchmarks.against.turns import DriverError, Measure, Missing, by_turns, measure_once
from kinedex.console.terminal import make_console
from kinedex.ops.errors import KinedexError

NEWEST = "newest-tag"
"""Stands for the newest release before this commit."""

FAILED = "failed: "
"""The begin of the remark on a figure that could not be measured."""

RESULT = ROOT / "build" / "bench" / "against.json"

_MORE = f"""
The commit is checked out below build/against, with an environment of its own from its requirements.lock; both are kept
for the next time. Every figure is measured in a new process, at the other commit and at this one by turns: A B, B A, …
A ratio says how many times as good this checkout is: its median over the rounds, and low to high, between which half of
the rounds lie. A figure FELL if even `high` is below 0.9. The list is {FILE.relative_to(ROOT)}.

exit status: 0 if no figure fell, 1 if one fell or could not be measured, 2 if the commit or a part is unknown
"""


def main(words: Sequence[str], measure: Measure = measure_once) -> int:
    """Compare the figures of the named parts, print a table, write it as JSON, and return the exit status."""
    chosen = _arguments(words)
    console = make_console()
    commit = (newest_tag() or FIRST) if chosen.commit == NEWEST else chosen.commit
    try:
        figures = guarded_figures(chosen.parts)
        with_page = any(one.part == "explorer" for one in figures)
        sides = (other_side(commit, lambda line: console.print(line, markup=False), with_page), this_side())
    except KinedexError as fault:
        if chosen.commit == NEWEST and isinstance(fault, UnknownCommitError):
            console.print(f"nothing is compared: {fault}", markup=False)
            return 0
        print(f"benchmarks.against: {fault}", file=sys.stderr)
        return 2
    shutil.rmtree(sides[1].work, ignore_errors=True)  # a store of code that has changed since
    if chosen.rounds:
        figures = [replace(one, rounds=chosen.rounds) for one in figures]
    files = inputs()
    rows = _measured(figures, sides, files, measure)
    rows += rival_rows(figures, rows, files)
    write(rows, RESULT)
    console.print(show(rows, sides[0].name))
    console.print(f"written to {RESULT.relative_to(ROOT)}", markup=False)
    failed = [row.figure for row in rows if row.fell or row.remark.startswith(FAILED)]
    if failed:
        console.print(f"fell or could not be measured: {', '.join(failed)}", markup=False)
    return int(bool(failed))


def _measured(figures: Sequence[Guarded], sides: tuple[Side, Side], files: Path, measure: Measure) -> list[Compared]:
    """Measure the figures one after the other, with a line on each and on the time that is left."""
    rows, began = list[Compared](), time.monotonic()
    for done, one in enumerate(figures):
        left = f", some {(time.monotonic() - began) / done * (len(figures) - done) / 60:.1f} min left" if done else ""
        print(f"[{done + 1}/{len(figures)}] {one.figure}{left}", flush=True)
        rows.append(_compared(one, sides, files, measure))
        print(f"    {rows[-1].outcome}", flush=True)
        write(rows, RESULT)  # so that a run that is interrupted leaves what it measured
    return rows


def _compared(one: Guarded, sides: tuple[Side, Side], files: Path, measure: Measure) -> Compared:
    try:
        other, this = by_turns(sides, one.key, files, one.rounds, measure)
    except DriverError as fault:
        return Compared(one.figure, one.unit, remark=f"{FAILED}{fault}")
    if isinstance(other, list) and isinstance(this, list):
        return compare(one.figure, one.unit, other, this)
    return _one_sided(one, sides, (other, this))


def _one_sided(one: Guarded, sides: tuple[Side, Side], found: Sequence[object]) -> Compared:
    """Return the row of a figure that a commit lacks; this checkout may lack none."""
    values = [None if isinstance(each, Missing) else value_of(each, one.unit) for each in found]  # type: ignore[arg-type]
    reasons = [
        f"{side.name} lacks it: {each.reason}"
        for side, each in zip(sides, found, strict=True)
        if isinstance(each, Missing)
    ]
    failed = FAILED if isinstance(found[1], Missing) else ""
    return Compared(one.figure, one.unit, values[0], values[1], remark=failed + "; ".join(reasons))


def _arguments(words: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.against",
        description="Time the guarded figures of this checkout beside those of another commit, in one run by turns.",
        epilog=_MORE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "commit", metavar="COMMIT",
        help=f"a commit or tag; {NEWEST} for the newest release before this one, or {FIRST} while there is none",
    )  # fmt: skip
    parser.add_argument(
        "parts", nargs="*", metavar="PART", help="parts of the list, such as reading and ingest; all unless given"
    )
    parser.add_argument(
        "--rounds", type=int, default=0, metavar="N", help="rounds of every figure, in place of the list's"
    )
    return parser.parse_args(words)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
