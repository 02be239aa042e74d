"""`python -m benchmarks`: all benchmarks, a table on the terminal, and JSON in build/bench."""

from __future__ import annotations

from benchmarks import annotating, indexing, keyframes, learning, ranking, reading, searching
from benchmarks.archive import BUILD, store
from benchmarks.harness import calibrate, show, write
from pipelines.terminal import make_console


def main() -> None:
    """Run everything on one core, with a calibration before and after."""
    opened = store()
    figures = [calibrate(), *reading.figures(), *indexing.figures(opened), *searching.figures(opened)]
    figures += [*learning.figures(opened), *keyframes.figures(opened), *ranking.figures(opened)]
    figures += [*annotating.figures(opened), calibrate()]
    console = make_console()
    console.print(show(figures))
    console.print(f"written to {write(figures, BUILD)}", markup=False)


if __name__ == "__main__":
    main()
