"""`python -m studies.many_clips STORE`: time templates of very large classes, and judge what drawing clips costs.

The takes of a store with class and actor are given so many times over that the largest class has `--largest` clips:
copies are cut at both ends and played faster or slower, by seed. First all classes are learned, soft and hard, and
timed on one core. Then templates are learned from the clips of every second actor, at several bounds of how many clips
are averaged, and judged on the takes of the other actors, as they are: mean average precision of their ranking, and F
of frames labelled by the methods thesis and best. Parameters are those of the pipelines; nothing is chosen by the
results.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from unittest import mock

import numpy as np
import polars as pl

from kinedex.catalog.classes import load_classes
from kinedex.ops.arrays import U64
from kinedex.ops.evaluation.metrics import Counts
from kinedex.ops.templates import templates as rules
from kinedex.ops.templates.templates import Kind, quantise
from kinedex.pipelines.annotation.annotators import make_annotator
from kinedex.pipelines.annotation.batches import annotate_stored
from kinedex.pipelines.annotation.methods import annotation_method
from kinedex.pipelines.engine.executors import Executor, make_executor
from kinedex.pipelines.templates.ranking_evaluation import clip_costs, evaluate_clips, mean_average_precision
from kinedex.pipelines.templates.template_learning import (
    SubclassTemplate,
    TrainingClips,
    learn_templates,
    training_clips,
)
from kinedex.storage.store.store import Store, open_store

METHODS = ("thesis", "best")
DELTA, TAU = 0.05, 0.13
TEMPO, CUT = (0.8, 1.25), 0.1
"""Copies are played so much slower or faster, and lose at most this share at each end."""


def varied(words: U64, generator: np.random.Generator) -> U64:
    """Return the words of a clip that was cut differently and performed at another speed."""
    start, stop = (CUT * generator.random(2) * len(words)).astype(np.int64)
    kept = words[start : len(words) - stop]
    frames = max(1, round(len(kept) / generator.uniform(*TEMPO)))
    return kept[np.linspace(0, len(kept) - 1, frames).round().astype(np.int64)]


def enlarged(clips: Sequence[TrainingClips], largest: int, seed: int = 0) -> list[TrainingClips]:
    """Give the clips of all classes so many times over, varied, that the largest class has so many.

    Parameters
    ----------
    clips : sequence of TrainingClips
        The clips of each class.
    largest : int
        The number of clips of the largest class; classes are as they are where it has more already.
    seed : int
        The seed of the variations.
    """
    generator = np.random.default_rng(seed)
    times = max(1.0, largest / max(len(one.names) for one in clips))
    found = []
    for one in clips:
        own = len(one.names)
        copied = [(number, place) for number, place in _copies(own, round(times * own))]
        found.append(
            replace(
                one,
                names=tuple(f"{one.names[place]}#{number}" for number, place in copied),
                words=tuple(varied(one.words[p], generator) if number else one.words[p] for number, p in copied),
                takes=tuple(one.of_takes[place] for _, place in copied),
                actors=tuple(one.of_actors[place] for _, place in copied),
            )
        )
    return found


def _copies(own: int, wanted: int) -> Iterator[tuple[int, int]]:
    """Yield the number of the copy and the place of each clip; copies that are not whole are spread over the clips."""
    for number in range(-(-wanted // own)):
        count = min(own, wanted - number * own)
        yield from ((number, place * own // count) for place in range(count))


@contextmanager
def bound(most: int | None) -> Iterator[None]:
    """Let templates be averaged from so many clips at most; None: from all of them, every one a reference."""
    with mock.patch.object(rules, "MAX_AVERAGED", most or 10**9):
        yield


def learned(
    clips: Sequence[TrainingClips], kinds: Sequence[Kind], features: int, executor: Executor
) -> tuple[list[SubclassTemplate], float]:
    """Return the templates of all classes, and the seconds of one core that they took."""
    began = time.process_time()
    found = [one for task in learn_templates(clips, kinds, features, executor) for one in task]
    return found, time.process_time() - began


def precision(store: Store, templates: Sequence[SubclassTemplate], takes: pl.DataFrame) -> float:
    """Return the mean average precision of the rankings of takes by the templates of all classes."""
    ranked = takes.sort("take_id")
    quantised = {one.subclass: quantise(one.learned.template, DELTA) for one in templates}
    costs = clip_costs(quantised, store.words(ranked["take_id"].to_list()))
    labels, names = ranked["class"].to_list(), ranked["name"].to_list()
    return mean_average_precision([evaluate_clips("", one, costs[one], labels, names, TAU) for one in quantised])


def labelled(
    store: Store, method: str, templates: Sequence[SubclassTemplate], training: U64, takes: pl.DataFrame,
    executor: Executor,
) -> Counts:  # fmt: skip
    """Count the frames of takes that are labelled with their class, those labelled with any, and all."""
    classes = load_classes("own", {one.subclass for one in templates})
    annotator = make_annotator(
        store.feature_set, templates, classes, DELTA, TAU, method=annotation_method(method), clips=lambda: [training]
    )
    labels = dict(takes.select("take_id", "class").iter_rows())
    right = wrong = 0
    for batch in annotate_stored(store, annotator, takes, executor, False):
        for one in batch:
            pairs = {
                (annotator.classes[segment.class_index], frame)
                for segment in one.segments
                for frame in range(segment.start, segment.stop)
            }
            agreeing = sum(label == labels[one.take_id] for label, _ in pairs)
            right, wrong = right + agreeing, wrong + len(pairs) - agreeing
    return Counts(right, right + wrong, int(takes["frames"].sum()))


def halves(takes: pl.DataFrame) -> tuple[pl.DataFrame, pl.DataFrame]:
    """Return the takes of every second actor, and those of the others with a class among the first."""
    first = takes["actor"].unique().sort().to_list()[::2]
    learn = takes.filter(pl.col("actor").is_in(first))
    rest = takes.filter(~pl.col("actor").is_in(first) & pl.col("class").is_in(learn["class"].unique().to_list()))
    return learn, rest


def judge(store: Store, takes: pl.DataFrame, largest: Sequence[int], bounds: Sequence[int | None]) -> Iterator[str]:
    """Yield a row of the Markdown table for each size of the largest class and each bound."""
    learn, rest = halves(takes)
    executor = make_executor("serial", None)
    features = len(store.feature_set.features)
    training = store.words(learn["take_id"].to_list()).words
    for most in largest:
        clips = enlarged(training_clips(store, learn), most)
        counts = [len(one.names) for one in clips]
        for limit in bounds:
            with bound(limit):
                templates, took = learned(clips, ["soft"], features, executor)
            found = [labelled(store, method, templates, training, rest, executor) for method in METHODS]
            cells = [f"{precision(store, templates, rest):.3f}", *(f"{one.f1:.3f}" for one in found)]
            yield f"| {max(counts)} | {sum(counts)} | {limit or 'all'} | {took:.1f} s | {' | '.join(cells)} |"
    executor.close()


def main() -> None:
    """Time the largest classes, judge the bounds, and print both as Markdown."""
    parser = argparse.ArgumentParser(prog="python -m studies.many_clips", description=__doc__)
    parser.add_argument("store", type=Path, help="a store of takes with class and actor")
    parser.add_argument("--largest", type=int, default=480, help="clips of the largest class, where it is timed")
    parser.add_argument("--judged", type=int, nargs="*", default=[1, 200], help="clips of it, where it is judged")
    parser.add_argument("--bounds", type=int, nargs="*", default=[20, 40, 80], help="clips that are averaged")
    parser.add_argument("--whole", action="store_true", help="time the largest classes without a bound, too (minutes)")
    given = parser.parse_args()
    store = open_store(given.store)
    takes = store.takes("class IS NOT NULL AND actor IS NOT NULL")
    clips = enlarged(training_clips(store, takes), given.largest)
    executor = make_executor("serial", None)
    sizes = sorted(len(one.names) for one in clips)
    print(f"{sum(sizes)} clips of {len(sizes)} classes, {sizes[-1]} in the largest, soft and hard, on one core:")
    for limit in (rules.MAX_AVERAGED, *([None] if given.whole else [])):
        with bound(limit):
            _, took = learned(clips, ["soft", "hard"], len(store.feature_set.features), executor)
        print(f"averaged from {limit or 'all'}: {took:.1f} s", flush=True)
    executor.close()
    if given.judged:
        print("\n| largest class | clips | averaged from | learned in | mAP | thesis: F (frames) | best: F (frames) |")
        print("|--:|--:|--:|--:|--:|--:|--:|")
        for line in judge(store, takes, given.judged, [*given.bounds, None]):
            print(line, flush=True)


if __name__ == "__main__":
    main()
