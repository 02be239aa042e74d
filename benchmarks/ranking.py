"""Learning templates, and their distance curves, on one core."""

from __future__ import annotations

import numpy as np

from benchmarks.harness import Figure, seconds
from ops.dtw import distance_curves
from ops.templates import learn_soft, quantise
from ops.words import bits
from storage.store import Store
from tests.oracles import dtw as naive


def figures(store: Store) -> list[Figure]:
    """Time the class with most clips, and its template against all words."""
    clips = store.takes("class IS NOT NULL")
    name = clips.group_by("class").len().sort("len", "class")["class"][-1]
    words = store.words(clips.filter(clips["class"] == name)["take_id"].to_list())
    examples = [words.take(i) for i in range(len(words))]
    learned = learn_soft(examples, 40)
    template = quantise(learned.template, 0.05)
    everything = store.words().words
    cells = len(template) * len(everything) / 1e6
    few = 300
    columns = [[None if value == 0.5 else int(value) for value in column] for column in template.values(40)]
    frames = bits(everything[:few], 40).tolist()
    slow = seconds(lambda: naive.curve_and_starts(columns, frames), 1)
    pairs = len(examples) ** 2 * float(np.mean([len(clip) for clip in examples])) ** 2 / 1e6
    return [
        Figure(
            f"learning a template ({len(examples)} clips)", pairs * learned.rounds, "M cells",
            seconds(lambda: learn_soft(examples, 40), 3),
        ),
        Figure(
            "distance curve of a template", cells, "M cells", seconds(lambda: distance_curves([template], everything)),
            "the tests' naive twin", slow * len(everything) / few,
        ),
    ]  # fmt: skip
