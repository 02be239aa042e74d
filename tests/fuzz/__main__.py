"""`python -m tests.fuzz`: broken files against every reader, for some seconds each."""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import tempfile
from functools import partial
from pathlib import Path

from tests.fuzz.guided import hunt_guided
from tests.fuzz.hunt import Finding, Report, attempt, each, hunt
from tests.fuzz.targets import TARGETS, Target

FOLDER = Path("build") / "fuzz"


def main() -> int:
    """Hunt, or read one file again; 1 where something was found."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("targets", nargs="*", metavar="TARGET", help=f"of {', '.join(TARGETS)}; all unless given")
    parser.add_argument("--seconds", type=float, default=20.0, help="how long for each target")
    parser.add_argument("--seed", type=int, default=0, help="the same seed makes the same mutants")
    parser.add_argument("--mutator", choices=("bytes", "structure", "guided"), default="bytes", help="makes the files")
    parser.add_argument("--jobs", type=int, default=len(os.sched_getaffinity(0)), help="targets at the same time")
    parser.add_argument("--file", type=Path, help="read this file once, as the one target named does")
    given = parser.parse_args()
    unknown = [name for name in given.targets if name not in TARGETS]
    if unknown:
        parser.error(f"no target '{unknown[0]}'; known: {', '.join(TARGETS)}")
    targets = [TARGETS[name] for name in given.targets] or list(TARGETS.values())
    if given.file is not None:
        if len(given.targets) != 1:
            parser.error("--file needs the name of one target")
        return _again(targets[0], given.file)
    found: list[Finding] = []
    work = partial(
        hunt_guided if given.mutator == "guided" else hunt, seed=given.seed, seconds=given.seconds, folder=FOLDER
    )
    if given.mutator == "structure":
        work = partial(work, mutator="structure")
    for report in each(targets, work, given.jobs):
        found += report.findings
        _show(report)
    print(f"{len(found)} findings" + (f", written to {FOLDER}" if found else ""))
    return 1 if found else 0


def _again(target: Target, file: Path) -> int:
    folder = Path(tempfile.mkdtemp())
    try:
        outcome = attempt(target, folder / f"{file.stem}{target.ending}", file.read_bytes())
    finally:
        shutil.rmtree(folder)
    print(outcome)
    return 0 if outcome in ("read", "refused") else 1


def _show(report: Report) -> None:
    share = 100 * report.read / max(1, report.cases)
    print(
        f"{report.target:16} {report.cases:7} files, {share:.0f} % came in, {len(report.findings)} findings", flush=True
    )
    for finding in report.findings:
        print(f"  {finding.what.strip().splitlines()[-1][:200]}\n    {finding.command}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
