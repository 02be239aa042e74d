"""Fuzzing guided by coverage: `python -m tests.fuzz.guided TARGET`, a process of its own, with atheris (libFuzzer).

A file that reaches lines of the readers that no file reached before is kept and changed further. It needs the packages
of the group `fuzz`.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
from collections import Counter
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tests.fuzz.hunt import Report
    from tests.fuzz.targets import Target

START_SECONDS = 120.0
"""Most time for importing and instrumenting."""

ROOT = Path(__file__).parents[2]

INSTRUMENTED = ("kinedex.storage.formats", "kinedex.catalog", "kinedex.pipelines.engine.config")
"""The modules whose lines count as reached or not: those that read files."""


def available() -> bool:
    """Return whether atheris is installed."""
    return find_spec("atheris") is not None


def hunt_guided(target: Target, seed: int, seconds: float, folder: Path) -> Report:
    """Hunt in a child process; what `tests.fuzz.hunt.hunt` does with mutants of its own."""
    from tests.fuzz.hunt import CASE_SECONDS, Finding, Report, write_finding

    report = Report(target.name)
    with tempfile.TemporaryDirectory(prefix="kinedex-guided-") as text:
        work = Path(text)
        options = ["--seconds", str(seconds), "--seed", str(seed), "--work", str(work), "--folder", str(folder)]
        command = [sys.executable, "-W", "ignore", "-m", "tests.fuzz.guided", target.name, *options]
        try:
            ended = subprocess.run(
                command, capture_output=True, timeout=START_SECONDS + 2 * seconds + 10 * CASE_SECONDS, check=False
            )
            code, output = ended.returncode, ended.stderr.decode(errors="replace")
        except subprocess.TimeoutExpired:
            code, output = -1, "it did not end"
        counts = json.loads((work / "counts.json").read_text()) if (work / "counts.json").exists() else {}
        report.cases, report.read = counts.get("cases", 0), counts.get("read", 0)
        report.findings = [
            Finding(target.name, found["case"], found["what"], Path(found["path"]))
            for found in counts.get("findings", [])
        ]
        for artifact in sorted(work.glob("ended-*")):  # libFuzzer writes the file that has ended it
            name = artifact.name.removeprefix("ended-")
            what = f"{name.partition('-')[0].capitalize()}: {output[-1500:]}"
            stem = f"{target.name}-guided-{seed}-{name[:20]}"
            report.findings.append(write_finding(target, stem, report.cases, artifact.read_bytes(), what, folder))
        if code and not report.findings:
            raise RuntimeError(f"guided fuzzing of {target.name} ended with {code}:\n{output[-2000:]}")
    return report


def _excluded() -> list[str]:
    """Return the modules of kinedex that are not instrumented: all others, among them those that numba compiles."""
    root = ROOT / "kinedex"
    files = [Path(folder) / name for folder, _, names in os.walk(root, followlinks=True) for name in names]
    places = [file.relative_to(ROOT).with_suffix("") for file in files if file.suffix == ".py"]
    names = [".".join(place.parts).removesuffix(".__init__") for place in places]
    return [name for name in names if not name.startswith(INSTRUMENTED)]


def main() -> None:
    """Fuzz one target in this process until time is up; libFuzzer ends the process."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz.guided", description=__doc__)
    parser.add_argument("target")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--folder", type=Path, required=True)
    given = parser.parse_args()
    import atheris

    with atheris.instrument_imports(include=["kinedex"], exclude=_excluded()):
        from tests.fuzz import targets
    from tests.fuzz.hunt import CASE_SECONDS, MEMORY_BYTES, attempt, kind_of, limit_memory, write_finding

    target = targets.TARGETS[given.target]
    corpus = given.work / "corpus"
    corpus.mkdir()
    for name, data in target.seeds().items():
        (corpus / re.sub(r"\W", "_", name)).write_bytes(data)
        attempt(target, given.work / f"seed{target.ending}", data)  # compiles before memory is limited
    counts: Counter[str] = Counter()
    findings: dict[str, dict[str, object]] = {}

    def one(data: bytes) -> None:
        counts["cases"] += 1
        outcome = attempt(target, given.work / f"case{counts['cases']}{target.ending}", data)
        counts["read"] += outcome == "read"
        if outcome not in ("read", "refused") and kind_of(outcome) not in findings:
            stem = f"{target.name}-guided-{given.seed}-{counts['cases']}"
            finding = write_finding(target, stem, counts["cases"], data, outcome, given.folder)
            findings[kind_of(outcome)] = {"case": finding.case, "what": outcome, "path": str(finding.path)}
        if counts["cases"] % 20 == 0 or outcome not in ("read", "refused"):
            note()

    def note() -> None:
        unfinished = given.work / "counts.tmp"
        unfinished.write_text(json.dumps({**counts, "findings": list(findings.values())}))
        os.replace(unfinished, given.work / "counts.json")

    limit_memory(MEMORY_BYTES + (1 << 30))  # libFuzzer's own tables lie in it, too
    options = {
        "max_total_time": int(given.seconds), "seed": given.seed + 1, "max_len": min(target.largest, 1 << 17),
        "timeout": int(10 * CASE_SECONDS), "rss_limit_mb": 0, "print_final_stats": 0, "verbosity": 0,
        "artifact_prefix": f"{given.work}/ended-",
    }  # fmt: skip
    atheris.Setup([sys.argv[0], *(f"-{name}={value}" for name, value in options.items()), str(corpus)], one)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
