"""`python -m benchmarks.reading_memory --mb 60`: measure the memory that a motion file of every format needs.

The files are generated. Each is ingested by a process of its own, from its bytes to frames in a part, as a worker does
it. The peak is the highest resident memory of that process; the estimate is that by which `--max-memory` refuses files.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from rich import box
from rich.table import Table

from kinedex.console.terminal import make_console
from tests.large_files import WRITERS, estimate_mb, measure


def main() -> int:
    """Measure the formats that are named, or all, and print a table; return 1 if an estimate is too low."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("formats", nargs="*", metavar="FORMAT", help=f"of {', '.join(WRITERS)}; all unless given")
    parser.add_argument("--mb", type=float, default=60.0, help="size of each file, or of its arrays unpacked")
    chosen = parser.parse_args()
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for column in ("format", "file MB", "process before MB", "peak MB", "estimate MB", "(peak − before) / MB"):
        table.add_column(column, justify="left" if column == "format" else "right")
    low = 0
    for form in chosen.formats or WRITERS:
        with tempfile.TemporaryDirectory() as folder:
            path, found = measure(Path(folder) / "made", form, int(chosen.mb * 1e6))
            size, estimate = path.stat().st_size / 1e6, estimate_mb(path)
        if found["failure"]:
            raise SystemExit(f"{form}: {found['failure']}")
        low += estimate < found["peak"]
        numbers = (size, found["before"], found["peak"], estimate)
        factor = (found["peak"] - found["before"]) / chosen.mb
        table.add_row(form, *(f"{number:,.1f}" for number in numbers), f"{factor:.2f}")
    make_console().print(table)
    return int(low > 0)


if __name__ == "__main__":
    sys.exit(main())
