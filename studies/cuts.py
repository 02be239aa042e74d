"""`python -m studies.cuts FILE …`: count the words that differ where a take is cut out of its source's own channels.

Intervals of takes are written with the source's own numbers and read again. Velocities near a cut lack the frames
beyond it, hysteresis begins anew, and limbs that thresholds are multiples of are measured in the first frame.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

import kinedex
from kinedex.library.take import Take
from kinedex.ops.body.resample import covered_frames
from kinedex.pipelines.export.request import FILE_FORMATS
from kinedex.reports.markdown import grid
from kinedex.storage.formats.motion.channel_cuts import SourceCut

CONTEXTS_S = (0.0, 0.25, 0.5, 1.0)
"""Seconds of surroundings on both sides, as of `kinedex export --context`."""

EDGES = (0, 1, 2, 3, 4, 5, 10, 15)
"""The first distances from a cut, in frames, of the rows of the table."""


@dataclass(frozen=True)
class Cut:
    """The outcome of one cut with some surroundings.

    Attributes
    ----------
    context_s : float
        Seconds of surroundings on each side, where the take has them.
    differ : bool array (frames,)
        The frames of the interval whose words differ from those of the take.
    whole : bool
        True where the interval is the whole take.
    """

    context_s: float
    differ: npt.NDArray[np.bool_]
    whole: bool = False


def cuts(source: Path, folder: Path, count: int, seconds: float, random: np.random.Generator) -> Iterator[Cut]:
    """Yield cuts of a motion file at random places, each with every context, and the whole take.

    Parameters
    ----------
    source : Path
        A BVH or AMC file.
    folder : Path
        A folder to write to.
    count : int
        The number of intervals.
    seconds : float
        The length of an interval.
    random : numpy.random.Generator
        The places.
    """
    take = kinedex.read(source)
    length = round(seconds * take.rate_hz)
    yield Cut(0.0, _differ(take, 0, len(take), 0, len(take), folder), whole=True)
    for _ in range(count if len(take) > length else 0):
        start = int(random.integers(0, len(take) - length + 1))
        for context_s in CONTEXTS_S:
            around = round(context_s * take.rate_hz)
            first, last = max(0, start - around), min(len(take), start + length + around)
            yield Cut(context_s, _differ(take, start, start + length, first, last, folder))


def _differ(take: Take, start: int, stop: int, first: int, last: int, folder: Path) -> npt.NDArray[np.bool_]:
    """Return the frames of [start, stop) whose words differ in the cut [first, last)."""
    info = take.info
    form = FILE_FORMATS[str(info["format"])]
    covered = covered_frames(first, last, int(info["source_frames"]), float(info["source_rate_hz"]), take.rate_hz)
    paths = [folder / f"cut.{ending}" for ending in form.endings]
    skeleton = info["skeleton_source"]
    form.cut_channels(
        paths, SourceCut(Path(info["source"]), skeleton and Path(skeleton), None, *covered, info["source_rate_hz"])
    )
    words = kinedex.read(paths[0]).words()
    if len(words) < last - first:  # there may be one more of a source slower than the analysis
        raise SystemExit(f"{info['source']}: frames {first} to {last} came back as {len(words)} frames")
    differ: npt.NDArray[np.bool_] = words[start - first : stop - first] != take.words()[start:stop]
    return differ


def tables(found: Sequence[Cut]) -> str:
    """Return two Markdown tables: words that differ by their distance from the cut, and cuts with equal words."""
    bare = [cut.differ for cut in found if cut.context_s == 0 and not cut.whole]
    rows = []
    for low, high in zip(EDGES, (*EDGES[1:], 10**9), strict=True):
        near = (
            [one[low : min(high, len(one) // 2)] for one in bare],
            [one[::-1][low : min(high, len(one) // 2)] for one in bare],
        )
        name = str(low) if high == low + 1 else f"{low} to {high - 1}" if high < 10**9 else f"{low} and more"
        frames = sum(map(len, near[0]))
        rows.append([name, *(f"{100 * sum(int(one.sum()) for one in side) / max(frames, 1):.1f} %" for side in near)])
    distances = grid(["frames from the cut", "after its start", "before its end"], rows)
    rows = []
    for context_s in CONTEXTS_S:
        of = [cut.differ for cut in found if cut.context_s == context_s and not cut.whole]
        words, frames = sum(int(one.sum()) for one in of), sum(map(len, of))
        rows.append([f"{context_s:g} s", f"{sum(not one.any() for one in of)} of {len(of)}", f"{words} of {frames}"])
    whole = [cut.differ for cut in found if cut.whole]
    rows.append(
        [
            "whole takes",
            f"{sum(not one.any() for one in whole)} of {len(whole)}",
            f"{sum(int(one.sum()) for one in whole)} of {sum(map(len, whole))}",
        ]
    )
    contexts = grid(["context", "cuts with equal words", "words that differ"], rows)
    return "\n".join([*distances, "", *contexts])


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(prog="python -m studies.cuts", description=__doc__)
    parser.add_argument("files", type=Path, nargs="+", help="BVH and AMC files")
    parser.add_argument("--cuts", type=int, default=4, help="intervals of each file")
    parser.add_argument("--seconds", type=float, default=2.0, help="length of an interval")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    random = np.random.default_rng(given.seed)
    with tempfile.TemporaryDirectory() as name:
        found = [cut for file in given.files for cut in cuts(file, Path(name), given.cuts, given.seconds, random)]
    print(tables(found))


if __name__ == "__main__":
    main()
