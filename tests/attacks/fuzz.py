"""Broken files against every reader, made by three mutators of different kinds: bytes, structure, and coverage."""

from __future__ import annotations

import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from random import Random

from tests.attacks.outcome import Options, Outcome
from tests.fuzz import guided
from tests.fuzz.hunt import Report, attempt, hunt
from tests.fuzz.targets import TARGETS

SECONDS = {"bytes": 2.0, "structure": 2.0, "guided": 3.0}
NIGHTLY_SECONDS = 120.0
"""Seconds for each reader and mutator, besides those for loading."""

MAX_READERS: dict[str, tuple[int | None, int | None]] = {
    "sample": (8, 0),
    "ordinary": (None, 20),
    "nightly": (None, None),
}
"""Readers of each size, for mutators and for fuzzing by coverage, which takes ten seconds to begin; None for all."""

FINDINGS = Path("build") / "attack" / "fuzz"
JOBS = 2


def run(folder: Path, options: Options) -> Outcome:
    """Hunt in every reader with every mutator; a case is a reader with the file that it is to read again."""
    outcome = Outcome()
    if options.case is not None:
        name, _, file = options.case.partition(":")
        problem = _again(name, Path(file))
        outcome.count("files")
        if problem not in ("read", "refused"):
            outcome.fail(options.case, problem)
        return outcome
    hunts = [(name, mutator) for mutator in SECONDS for name in _readers(mutator, options)]
    if options.size != "sample" and not guided.available():
        outcome.count("skipped, atheris is not installed: guided", 0)
    with ThreadPoolExecutor(JOBS) as pool:
        reports = list(pool.map(lambda item: _report(*item, options), hunts))
    for (_, mutator), report in zip(hunts, reports, strict=True):
        outcome.count(f"all readers: {mutator}", report.cases)
        outcome.cases += report.cases
    for (name, mutator), report in sorted(zip(hunts, reports, strict=True), key=lambda item: item[0]):
        outcome.count(f"{name}: {mutator}", report.cases)
        for finding in report.findings:
            outcome.fail(f"{name}:{finding.path}", f"{name}, {mutator}: {finding.what}")
    return outcome


def _readers(mutator: str, options: Options) -> list[str]:
    """Return the readers whose files a mutator changes."""
    most = MAX_READERS[options.size][mutator == "guided"] if mutator != "guided" or guided.available() else 0
    return list(TARGETS) if most is None else sorted(Random(f"{options.seed}/{mutator}").sample(sorted(TARGETS), most))


def _report(name: str, mutator: str, options: Options) -> Report:
    seconds = NIGHTLY_SECONDS if options.size == "nightly" else SECONDS[mutator]
    if mutator == "guided":
        return guided.hunt_guided(TARGETS[name], options.seed, seconds, FINDINGS)
    return hunt(
        TARGETS[name], options.seed, seconds, FINDINGS, mutator="structure" if mutator == "structure" else "bytes"
    )


def _again(name: str, file: Path) -> str:
    with tempfile.TemporaryDirectory() as folder:
        return attempt(TARGETS[name], Path(folder) / f"{file.stem}{TARGETS[name].ending}", file.read_bytes())
