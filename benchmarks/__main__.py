"""`python -m benchmarks [PART …]`: run all benchmarks or some parts; print a table and write JSON to build/bench."""

from __future__ import annotations

import argparse
import sys
import time
import traceback
from collections.abc import Iterable, Sequence
from importlib import import_module

from benchmarks.archive import store
from benchmarks.harness import BUILD, SMALL_VARIABLE, Figure, calibrate, show, write
from benchmarks.kept_parts import KeptParts, state_of_checkout
from kinedex.console.terminal import make_console
from kinedex.ops.errors import did_you_mean

PARTS = (
    "startup",
    "reading",
    "checksums",
    "indexing",
    "searching",
    "sharing",
    "learning",
    "keyframes",
    "ranking",
    "annotating",
    "recognition",
    "tracking",
    "depth",
    "depth_frame",
    "depth_lookup",
    "depth_recordings",
    "explorer",
    "explorer_page",
    "inertial",
    "inertial_take",
)
"""The modules of this package whose `figures`, given a store, yield what they measured."""


def main(words: Sequence[str], parts: Sequence[str] = PARTS) -> int:
    """Run all parts, or those named, with a calibration before and after, and return the exit status."""
    chosen = _arguments(words, parts)
    kept = KeptParts(BUILD / "parts", state_of_checkout())
    figures, failures, left_out = [calibrate()], dict[str, str](), dict[str, str]()
    names = chosen.parts or parts
    for place, part in enumerate(names):
        found = None if chosen.anew else kept.read(part)
        if found is not None:
            print(f"[{place + 1}/{len(names)}] {part}: kept from an earlier run of this commit; --anew measures again")
        else:
            print(f"[{place + 1}/{len(names)}] {part}{kept.left(names[place:])}", flush=True)
            begin = time.monotonic()
            found, failure = measured(part)
            if failure:
                failures[part] = failure
            else:
                kept.write(part, found, time.monotonic() - begin)
        figures += found
        left_out |= {one.name: one.other for one in found if one.left_out}
    figures.append(calibrate())
    console = make_console()
    console.print(show(figures))
    console.print(f"written to {write(figures, BUILD)}", markup=False)
    for name, reason in left_out.items():
        console.print(f"{name}: {reason}", markup=False)
    for part, reason in failures.items():
        console.print(f"failed: {part}: {reason}", markup=False)
    return int(bool(failures))


def measured(part: str) -> tuple[list[Figure], str]:
    """Return the figures of a part, and the reason why it failed: it raised, or yielded none; "" if it did not."""
    found = list[Figure]()
    try:
        made: Iterable[Figure] = import_module(f"benchmarks.{part}").figures(store())
        found.extend(made)  # of a part that raises, those before
    except Exception as fault:
        traceback.print_exc()
        return found, f"{type(fault).__name__}: {fault}"
    return found, "" if found else "it has no figure"


def _arguments(words: Sequence[str], parts: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks",
        description="Time kinedex and print a table. What a part measured at this commit is kept, so that a run that "
        "was interrupted goes on where it ended.",
        epilog=f"{SMALL_VARIABLE}=1 in the environment (make bench SMALL=1) takes a size at which every part needs "
        "seconds: it shows that they run, not how fast. Exit status: 1 if a part failed.",
    )
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"all unless given: {', '.join(parts)}")
    parser.add_argument("--anew", action="store_true", help="measure again what is kept of an earlier run")
    chosen = parser.parse_args(words)
    for part in chosen.parts:
        if part not in parts:
            parser.error(f"{part}: no part of the benchmarks{did_you_mean(part, parts)}")
    return chosen


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
