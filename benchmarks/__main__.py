"""`python -m benchmarks [PART …]`: run all benchmarks or some parts; print a table and write JSON to build/bench."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence

from benchmarks import (
    annotating,
    checksums,
    depth,
    depth_frame,
    depth_lookup,
    depth_recordings,
    explorer,
    explorer_page,
    indexing,
    inertial,
    inertial_take,
    keyframes,
    learning,
    ranking,
    reading,
    searching,
    sharing,
    startup,
    tracking,
)
from benchmarks.archive import BUILD, store
from benchmarks.harness import Figure, calibrate, show, write
from kinedex.ops.errors import did_you_mean
from kinedex.pipelines.console.terminal import make_console
from kinedex.storage.store.store import Store

PARTS: dict[str, Callable[[Store], Sequence[Figure]]] = {
    "startup": lambda opened: list(startup.figures(opened)),
    "reading": lambda _: list(reading.figures()),
    "checksums": lambda opened: list(checksums.figures(opened)),
    "indexing": indexing.figures,
    "searching": searching.figures,
    "sharing": sharing.figures,
    "learning": learning.figures,
    "keyframes": keyframes.figures,
    "ranking": ranking.figures,
    "annotating": annotating.figures,
    "tracking": tracking.figures,
    "depth": depth.figures,
    "depth_frame": depth_frame.figures,
    "depth_lookup": lambda opened: list(depth_lookup.figures(opened)),
    "depth_recordings": depth_recordings.figures,
    "explorer": lambda _: explorer.figures(),
    "explorer_page": lambda _: explorer_page.figures(),
    "inertial": lambda _: inertial.figures(),
    "inertial_take": lambda _: inertial_take.figures(),
}


def main(words: Sequence[str]) -> None:
    """Run all parts, or those named, on one core, with a calibration before and after."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description="Time kinedex and print a table.")
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"all unless given: {', '.join(PARTS)}")
    parts = parser.parse_args(words).parts
    for part in parts:
        if part not in PARTS:
            sys.exit(f"{part}: no part of the benchmarks{did_you_mean(part, PARTS)}")
    opened = store()
    figures = [calibrate()]
    for part in parts or PARTS:
        figures += PARTS[part](opened)
    figures.append(calibrate())
    console = make_console()
    console.print(show(figures))
    console.print(f"written to {write(figures, BUILD)}", markup=False)


if __name__ == "__main__":
    main(sys.argv[1:])
