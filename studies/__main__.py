"""`python -m studies`: list the studies. `python -m studies --small [NAME …]`: run their small forms."""

from __future__ import annotations

import argparse
import ast
import sys
import tempfile
from pathlib import Path

from studies.small_form import Bench, Outcome, forms, run_small
from tests.real_data import SHARED


def studies() -> dict[str, str]:
    """Return the first sentence of every module that is a program, by its name."""
    found = {}
    for path in sorted(Path(__file__).parent.glob("[a-z]*.py")):
        line = (ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "").partition("\n")[0]
        if line.startswith("`python -m studies."):
            found[path.stem] = line
    return found


def show(outcome: Outcome) -> None:
    """Print a line of the table."""
    print(f"{outcome.seconds:7.1f} s  {outcome.name}: {outcome.result}", flush=True)


def main() -> int:
    """List the studies, or run their small forms; the exit code is 1 where one fails."""
    parser = argparse.ArgumentParser(prog="python -m studies", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="studies to run at a small size; all by default")
    parser.add_argument("--small", action="store_true", help="run them, on small cuts of the data: no figures")
    parser.add_argument("--data", type=Path, default=SHARED / "data", help="folder of real data (../shared/data)")
    given = parser.parse_args()
    if unknown := set(given.names) - set(forms()):
        parser.error(f"no study {', '.join(sorted(unknown))}; `python -m studies` lists them")
    if not given.small:
        print("\n".join(line for name, line in studies().items() if not given.names or name in given.names))
        return 0
    with tempfile.TemporaryDirectory() as folder:
        return 0 if run_small(given.names or list(forms()), Bench(Path(folder) / "small", given.data), show) else 1


if __name__ == "__main__":
    sys.exit(main())
