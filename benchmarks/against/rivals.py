"""Other packages that do the work of a guarded figure, measured in the same run.

`python -m benchmarks.against.rivals FIGURE PACKAGE INPUTS` measures one, in a process of its own. Files are those of
the figure or shorter ones, as some packages take a second for a megabyte; rates do not depend on the length.
"""

from __future__ import annotations

import contextlib
import io
import json
import subprocess
import sys
from collections.abc import Sequence
from importlib import import_module, metadata
from pathlib import Path

from benchmarks import packages
from benchmarks.against.commits import ROOT
from benchmarks.against.comparison import Compared, value_of
from benchmarks.against.guarded_figures import Guarded
from benchmarks.against.turns import LIMIT_SECONDS, DriverError, read_answer
from benchmarks.harness import seconds


def rival_readers(figure: str, inputs: Path) -> tuple[Path, packages.Readers]:
    """Return the file that packages read for a figure, and their readers; none where no package does its work."""
    if figure == "read_amc":
        amc = max((inputs / "archive" / "takes").glob("*.amc"), key=lambda file: file.stat().st_size)
        return amc, packages.of_acclaim(inputs / "long" / "long.asf", amc)
    if figure == "read_bvh":
        bvh = max((inputs / "takes").rglob("*.bvh"), key=lambda file: file.stat().st_size)
        return bvh, packages.of_bvh(bvh)
    if figure == "read_c3d":
        return inputs / "long" / "long.c3d", packages.of_c3d(inputs / "long" / "long.c3d")
    return inputs, {}


def rival_rows(figures: Sequence[Guarded], rows: Sequence[Compared], inputs: Path) -> list[Compared]:
    """Return a row for each package that does the work of a figure: `other` is the package, and nothing falls."""
    found = []
    for one, row in zip(figures, rows, strict=True):
        for package in rival_readers(one.key, inputs)[1]:
            title = f"{one.figure}, beside {package}"
            try:
                title = f"{title} {metadata.version(package)}"
                value = value_of(_measured(one.key, package, inputs), one.unit)
            except (metadata.PackageNotFoundError, DriverError) as reason:
                found.append(Compared(title, one.unit, this=row.this, remark=f"not compared: {reason}"))
                continue
            ratio = row.this / value if row.this else None
            found.append(Compared(title, one.unit, value, row.this, ratio, ratio, ratio))
    return found


def _measured(figure: str, package: str, inputs: Path) -> dict[str, float]:
    command = [sys.executable, "-m", "benchmarks.against.rivals", figure, package, str(inputs)]
    try:
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=LIMIT_SECONDS)
    except subprocess.TimeoutExpired:
        raise DriverError(f"it took longer than {LIMIT_SECONDS:g} s") from None
    found = read_answer(done.stdout, figure, package)
    assert isinstance(found, dict)
    return found


def main(figure: str, package: str, inputs: str) -> None:
    """Measure one package, and print it as a driver does."""
    path, readers = rival_readers(figure, Path(inputs))
    with contextlib.redirect_stdout(io.StringIO()):  # some packages print while they read
        module = import_module(package)
        spent = seconds(lambda: readers[package](module), 1)
    print(json.dumps({"seconds": spent, "amount": path.stat().st_size / 1e6}))


if __name__ == "__main__":
    main(*sys.argv[1:])
