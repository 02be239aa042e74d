"""`python -m studies.synthetic_motion [ARCHIVE] [--hdm05 DIR]`: compare the synthetic archive with HDM05.

The program counts the distinct words in as many frames as the HDM05 data has, and the lengths of word runs, for whole
words and each set. It compares them with the figures below, or with those of a folder of HDM05 files. A factor of two
is accepted.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from rich.table import Table

from benchmarks.archive import archive
from benchmarks.harness import silent
from kinedex.console.terminal import make_console
from kinedex.ops.words import TakeWords, cut
from kinedex.pipelines.engine.runner import run_pipeline
from kinedex.storage.store.store import open_store

SETS: dict[str, tuple[int, int]] = {"whole word": (1, 40), "upper": (1, 14), "lower": (15, 12), "mix": (27, 14)}
"""The first feature and the number of features of each set; F40 belongs to mix."""


@dataclass(frozen=True)
class Figures:
    """The counts of one set: distinct words in `frames` frames, and mean and median length of the runs."""

    frames: int
    words: int
    mean_run: float
    median_run: float


HDM05_FRAMES = 14269
HDM05: dict[str, Figures] = {
    "whole word": Figures(HDM05_FRAMES, 5023, 2.02, 1.0),
    "upper": Figures(HDM05_FRAMES, 811, 3.33, 2.0),
    "lower": Figures(HDM05_FRAMES, 176, 5.41, 3.0),
    "mix": Figures(HDM05_FRAMES, 470, 4.95, 3.0),
}
"""The figures of 188 clips and 5 takes of HDM05, from the authors' own features at every fourth frame."""


def words_of(source: Path) -> TakeWords:
    """Ingest a folder of motion files into a store of its own, and return the words at 30 Hz."""
    with tempfile.TemporaryDirectory() as folder:
        store = Path(folder) / "store"
        run_pipeline("ingest", store, assignments={"source": str(source)}, terminal=silent())
        return open_store(store).words()


def figures(takes: TakeWords, frames: int = HDM05_FRAMES, seed: int = 0) -> dict[str, Figures]:
    """Count words and runs in a number of frames of takes that are drawn at random.

    Parameters
    ----------
    takes : TakeWords
        The words.
    frames : int
        The number of frames; all where there are fewer.
    seed : int
        The seed of the draw.

    Returns
    -------
    dict
        Set → its figures.
    """
    chosen: list[npt.NDArray[np.uint64]] = []
    left = frames
    for take in np.random.default_rng(seed).permutation(len(takes)):
        chosen.append(takes.take(int(take))[:left])
        left -= len(chosen[-1])
        if not left:
            break
    return {name: _figures([cut(words, first, count) for words in chosen]) for name, (first, count) in SETS.items()}


def _figures(takes: list[npt.NDArray[np.uint64]]) -> Figures:
    lengths = []
    for words in takes:
        begins = np.flatnonzero(np.concatenate(([True], words[1:] != words[:-1])))
        lengths.append(np.diff(np.append(begins, len(words))))
    runs, words = np.concatenate(lengths), np.concatenate(takes)
    return Figures(len(words), len(np.unique(words)), float(runs.mean()), float(np.median(runs)))


def within(mine: Figures, theirs: Figures, factor: float = 2.0) -> bool:
    """Return True if the number of words and both lengths of runs differ by no more than a factor."""
    pairs = (
        (mine.words, theirs.words),
        (mine.mean_run, theirs.mean_run),
        (mine.median_run, theirs.median_run),
    )
    return all(1.0 / factor <= a / b <= factor for a, b in pairs)


def comparison(mine: dict[str, Figures], theirs: dict[str, Figures]) -> Table:
    """Return the table that is printed."""
    frames = f"{next(iter(mine.values())).frames:,} and {next(iter(theirs.values())).frames:,} frames"
    table = Table(title=f"synthetic archive and HDM05 ({frames} at 30 Hz)", box=None)
    for heading in ("set", "words", "HDM05", "ratio", "mean run", "HDM05", "ratio", "median run", "HDM05", "within 2"):
        table.add_column(heading, justify="left" if heading == "set" else "right")
    for name, one in mine.items():
        other = theirs[name]
        table.add_row(
            name,
            *(f"{one.words:,}", f"{other.words:,}", f"{one.words / other.words:.2f}"),
            *(f"{one.mean_run:.2f}", f"{other.mean_run:.2f}", f"{one.mean_run / other.mean_run:.2f}"),
            *(f"{one.median_run:g}", f"{other.median_run:g}", "yes" if within(one, other) else "NO"),
        )
    return table


def main() -> int:
    """Print the comparison; the exit code is 1 where something differs by more than a factor of two."""
    parser = argparse.ArgumentParser(prog="python -m studies.synthetic_motion", description=__doc__)
    parser.add_argument(
        "archive", nargs="?", type=Path, help="a synthetic archive (the one of the benchmarks if not given)"
    )
    parser.add_argument("--hdm05", type=Path, help="a folder of HDM05 files (the recorded figures if not given)")
    options = parser.parse_args()
    theirs = figures(words_of(options.hdm05)) if options.hdm05 else HDM05
    mine = figures(words_of(options.archive or archive()), next(iter(theirs.values())).frames)
    make_console().print(comparison(mine, theirs))
    return 0 if all(within(mine[name], theirs[name]) for name in SETS) else 1


if __name__ == "__main__":
    sys.exit(main())
