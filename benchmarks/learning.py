"""Time template learning: a class of 20 clips of 100 columns, and its growth with the clips."""

from __future__ import annotations

import numpy as np

from benchmarks.harness import Figure, seconds, sized
from kinedex.ops.arrays import U64
from kinedex.ops.templates.templates import learn
from kinedex.ops.words import bits
from kinedex.storage.store.store import Store
from tests.oracles import warping as naive

CLIPS, COLUMNS = sized((20, 100), (4, 40))
FEW = 30  # columns that the tests' naive twin aligns; more would take it seconds


def figures(store: Store) -> list[Figure]:
    """Time soft and hard learning of one class, and a class three times as large."""
    features = len(store.feature_set.features)
    clips = resampled(store, 3 * CLIPS, COLUMNS)
    few = clips[:CLIPS]
    soft, hard = learn("soft", few, features), learn("hard", few, features)
    alignments = CLIPS * (CLIPS - 1)
    slow = seconds(lambda: aligned_naively(few[0][:FEW], few[1][:FEW], features), 1)
    rounds = len(soft.costs)
    return [
        Figure(
            f"soft learning, {CLIPS} clips of {COLUMNS} columns", alignments * COLUMNS**2 * rounds / 1e6, "M cells",
            seconds(lambda: learn("soft", few, features), 5),
            "the tests' naive twin", slow * alignments * (COLUMNS / FEW) ** 2 * rounds,
        ),
        Figure(
            f"hard learning, {CLIPS} clips of {COLUMNS} columns",
            alignments * COLUMNS**2 * len(hard.costs) / 1e6, "M cells",
            seconds(lambda: learn("hard", few, features), 5),
        ),
        Figure(
            f"soft learning, {3 * CLIPS} clips of {COLUMNS} columns",
            3 * CLIPS * (3 * CLIPS - 1) * COLUMNS**2 * len(learn("soft", clips, features).costs) / 1e6, "M cells",
            seconds(lambda: learn("soft", clips, features), 3),
        ),
    ]  # fmt: skip


def resampled(store: Store, count: int, columns: int) -> list[U64]:
    """Return the words of clips of the largest class, each resampled to a number of columns.

    A class with fewer clips gives some of them twice, from another frame on, so that no two are the same.
    """
    takes = store.takes("class IS NOT NULL")
    name = takes.group_by("class").len().sort("len", "class")["class"][-1]
    words = store.words(takes.filter(takes["class"] == name)["take_id"].to_list())
    clips = []
    for index in range(count):
        clip = words.take(index % len(words))[index // len(words) :]
        clips.append(clip[np.linspace(0, len(clip) - 1, columns).astype(np.int64)])
    return clips


def aligned_naively(first: U64, second: U64, features: int) -> float:
    """Compute the cost of one pair with plain lists."""
    one, other = bits(first, features).tolist(), bits(second, features).tolist()
    cost = [[sum(abs(a - b) for a, b in zip(x, y, strict=True)) / features for y in other] for x in one]
    return naive.align(cost, [1.0] * len(one), [1.0] * len(other))[0]
