"""`python -m benchmarks.decoding STORE`: how the parameters of method best were chosen, on example clips alone.

The clips of one actor at a time are left out, laid end to end in a drawn order, and labelled with the templates of the
others: once with the templates of all classes ("closed": every frame has a label), and with those of five classes
only, drawn four times ("open": what is of other classes should get no label). Takes to annotate, and their ground
truth, are not looked at.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np
from rich import box
from rich.table import Table

from ops.distances.decoding import Decoding, background, explain
from ops.measures.metrics import Counts, compare, pooled
from ops.templates.templates import Template, learn_soft
from ops.words import U64
from pipelines.terminal import make_console
from storage.store import Store, open_store

MOST_CLIPS = 4  # of a class in a drawn order, so that no class fills the takes
CLIPS_A_TAKE = 9
ORDERS, OPEN_SETS, OPEN_CLASSES = 3, 4, 5

GRID = [
    *(Decoding(gain=gain) for gain in (0.03, 0.0, -0.03, -0.06, -0.1, -0.15)),
    *(Decoding(entry=entry) for entry in (0.3, 0.5)),
    *(Decoding(smoothing=smoothing) for smoothing in (0.03, 0.1)),
    *(Decoding(skip=skip) for skip in (0.0, 0.1)),
    *(Decoding(stay=stay) for stay in (0.0, 0.03, 0.06, 0.2, np.inf)),
]


@dataclass(frozen=True)
class Clip:
    """One example clip."""

    actor: str
    label: str
    words: U64


@dataclass(frozen=True)
class LaidOut:
    """Clips laid end to end: words, and for each clip its class and frames."""

    words: U64
    truth: tuple[tuple[str, int, int], ...]


class Study:
    """The clips of a store, and what is made of them for each actor left out."""

    def __init__(self, store: Store) -> None:
        takes = store.takes("class IS NOT NULL AND actor IS NOT NULL").sort("name")
        words = store.words(takes["take_id"].to_list())
        place = {take: index for index, take in enumerate(words.take_ids.tolist())}
        self.clips = [
            Clip(row["actor"], row["class"], words.take(place[row["take_id"]])) for row in takes.iter_rows(named=True)
        ]
        self.features = len(store.feature_set.features)
        self.actors = sorted({clip.actor for clip in self.clips})
        self.labels = sorted({clip.label for clip in self.clips})
        self.takes = {actor: list(self._laid_out(actor)) for actor in self.actors}

    def _laid_out(self, actor: str) -> Iterator[LaidOut]:
        for seed in range(ORDERS):
            random = np.random.default_rng(seed)
            chosen: list[Clip] = []
            for label in self.labels:
                own = [clip for clip in self.clips if clip.actor == actor and clip.label == label]
                chosen += [own[index] for index in random.permutation(len(own))[:MOST_CLIPS]]
            order = [chosen[index] for index in random.permutation(len(chosen))]
            for start in range(0, len(order), CLIPS_A_TAKE):
                part = order[start : start + CLIPS_A_TAKE]
                edges = np.cumsum([0, *(len(clip.words) for clip in part)]).tolist()
                truth = tuple((clip.label, *edge) for clip, edge in zip(part, pairwise(edges), strict=True))
                yield LaidOut(np.concatenate([clip.words for clip in part]), truth)

    @cache  # noqa: B019 (one study a process)
    def template(self, left_out: str, label: str) -> Template | None:
        """The template of a class without one actor's clips."""
        words = [clip.words for clip in self.clips if clip.label == label and clip.actor != left_out]
        return learn_soft(words, self.features).template if words else None

    def counts(self, decoding: Decoding, labels: Sequence[str]) -> Counts:
        """Label the takes of every actor with templates of some classes; only these are looked for, and counted."""
        counts = []
        for actor in self.actors:
            usual = background([clip.words for clip in self.clips if clip.actor != actor], self.features)
            known = [(label, one) for label in labels if (one := self.template(actor, label)) is not None]
            for take in self.takes[actor]:
                found = explain([one for _, one in known], usual, take.words, decoding)
                for label in labels:
                    mine = [(one.start, one.stop) for one in found if known[one.template][0] == label]
                    counts.append(compare(mine, [(start, stop) for name, start, stop in take.truth if name == label]))
        return pooled(counts)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("store", help="a store with example clips of several actors")
    study = Study(open_store(parser.parse_args().store))
    random = np.random.default_rng(1)
    few = min(OPEN_CLASSES, len(study.labels))
    open_sets = [sorted(random.permutation(study.labels)[:few].tolist()) for _ in range(OPEN_SETS)]
    table = Table(box=box.SIMPLE_HEAD, title=f"left out in turn: {', '.join(study.actors)}", title_justify="left")
    for name in ("smoothing", "entry", "skip", "stay", "gain", "closed F1", "F2", "open F1", "F2", "mean of the four"):
        table.add_column(name, justify="right")
    for decoding in [Decoding(), *(one for one in GRID if one != Decoding())]:
        closed = study.counts(decoding, study.labels)
        opened = pooled(study.counts(decoding, labels) for labels in open_sets)
        measures = [closed.f1, closed.f2, opened.f1, opened.f2]
        values = [decoding.smoothing, decoding.entry, decoding.skip, decoding.stay, decoding.gain]
        table.add_row(
            *(f"{value:g}" for value in values), *(f"{value:.3f}" for value in [*measures, float(np.mean(measures))]),
            style="bold" if decoding == Decoding() else None,
        )  # fmt: skip
    make_console().print(table)


if __name__ == "__main__":
    main()
