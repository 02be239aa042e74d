"""`python -m benchmarks.ranking_memory --hours 100`: measure memory and time of ranking an archive by all classes.

The archive has words and no positions: the repeated takes of the synthetic archive, with a bit flipped at random in a
twentieth of the frames, so that there are as many different words as in motion that does not repeat itself. The
peak is that of a process that opens the store, learns the templates and ranks, Python and its packages included.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from benchmarks.archive import store
from benchmarks.indexing import own_peak_mb, store_of_words
from kinedex.console.terminal import make_console
from kinedex.ops.templates.templates import learn_soft, quantise
from kinedex.ops.words import TakeWords
from kinedex.pipelines.templates.ranked_hits import RankedTemplate
from kinedex.pipelines.templates.ranking import rank_takes
from kinedex.storage.store.store import Store, open_store

RATE_HZ = 30
SPOILED = 0.05
"""Share of the frames in which a bit is flipped."""


def made_up(hours: float) -> Store:
    """Return a store of some hours of motion; make it if it is missing."""
    words = store().words()
    times = -(-int(hours * 3600 * RATE_HZ) // len(words.words))
    rng = np.random.default_rng(0)
    every = np.tile(words.words, times)
    flipped = np.flatnonzero(rng.random(len(every)) < SPOILED)
    every[flipped] ^= np.uint64(1) << rng.integers(0, 40, len(flipped)).astype(np.uint64)
    offsets = np.concatenate(([0], np.cumsum(np.tile(words.frames, times)))).astype(np.int64)
    return store_of_words(TakeWords(np.arange(len(offsets) - 1), offsets, every), store().feature_set)


def searched_classes() -> list[RankedTemplate]:
    """Learn the templates of the classes of the synthetic archive."""
    known = store()
    searched = []
    for (name,), group in known.takes("class IS NOT NULL").sort("class", "name").group_by("class", maintain_order=True):
        clips = known.words(group["take_id"].to_list())
        learned = learn_soft([clips.take(i) for i in range(len(clips))], len(known.feature_set.features))
        searched.append(RankedTemplate(str(name), quantise(learned.template, 0.1)))
    return searched


def rank_all(path: Path, workers: int | None) -> dict[str, float]:
    """Rank a store by every class at once, and return the peak memory of this process."""
    searched = searched_classes()
    opened = open_store(path)
    before = own_peak_mb()
    begin = time.perf_counter()
    found = rank_takes(opened, searched, 0.1, 100, workers=workers)
    seconds = time.perf_counter() - begin
    cells = sum(len(one.template) for one in searched) * found[0].frames
    return {
        "templates": len(searched), "frames": found[0].frames, "hours": found[0].frames / RATE_HZ / 3600,
        "seconds": seconds, "billion_cells_a_second": cells / seconds / 1e9,
        "peak_mib": own_peak_mb(), "peak_mib_before": before,
    }  # fmt: skip


def main() -> None:
    """Make the archive, rank it in a new process, and print time and memory."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--hours", type=float, default=100.0)
    parser.add_argument("--workers", type=int, help="threads; all cores unless given")
    parser.add_argument("--rank", type=Path, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.rank is not None:
        print(json.dumps(rank_all(chosen.rank, chosen.workers)))
        return
    path = made_up(chosen.hours).path
    workers = [] if chosen.workers is None else ["--workers", str(chosen.workers)]
    command = [sys.executable, "-m", "benchmarks.ranking_memory", "--rank", str(path), *workers]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, timeout=6 * 3600)
    measured = json.loads(done.stdout.splitlines()[-1])
    make_console().print(
        "{frames:,} frames ({hours:.1f} h) ranked by {templates} templates in {seconds:.1f} s, "
        "{billion_cells_a_second:.2f} G cells/s; peak {peak_mib:.0f} MiB, {peak_mib_before:.0f} of it before".format(
            **measured
        ),
        markup=False,
    )


if __name__ == "__main__":
    main()
