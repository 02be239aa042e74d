"""`python -m tests.attacks`: all attacks in full, with a table of counts, and JSON in build/attacks.json."""

from __future__ import annotations

import json
import shutil
import sys
import tempfile
import time
from pathlib import Path

from tests.attacks import power_loss, sql_writes


def main() -> int:
    """Run the attacks; return 1 if any of them succeeded."""
    results: dict[str, dict[str, object]] = {}
    faults: list[str] = []
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        begin = time.perf_counter()
        tried, refused, broken = sql_writes.attack(folder / "sql")
        results["sql"] = {"statements": tried, "refused": refused, "seconds": time.perf_counter() - begin}
        faults += broken
        if shutil.which("strace"):
            begin = time.perf_counter()
            (folder / "power").mkdir()
            outcome = power_loss.attack(folder / "power")
            results["power loss"] = {
                "crash points": outcome.crashes,
                "disks": outcome.states,
                **outcome.versions,
                "seconds": time.perf_counter() - begin,
            }
            faults += outcome.faults
        else:
            print("power loss: skipped, there is no strace on this machine")
    for name, counts in results.items():
        print(
            f"{name}: "
            + ", ".join(
                f"{key} {value:.4g}" if isinstance(value, float) else f"{key} {value}" for key, value in counts.items()
            )
        )
    for fault in faults[:20]:
        print(f"BROKEN {fault}")
    Path("build").mkdir(exist_ok=True)
    Path("build/attacks.json").write_text(
        json.dumps({"results": results, "faults": faults}, indent=1), encoding="utf-8"
    )
    return int(bool(faults))


if __name__ == "__main__":
    sys.exit(main())
