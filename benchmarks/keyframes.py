"""Time keyframe learning: one genetic run on a training set of 24 minutes and 69 classes, on one core."""

from __future__ import annotations

import numpy as np

from benchmarks.harness import Figure, seconds, sized
from kinedex.ops.arrays import U64
from kinedex.ops.keyframes.fitness import training_frames
from kinedex.ops.keyframes.genetic_algorithm import evolve
from kinedex.ops.keyframes.training_task import EvolutionSettings, TrainingTask, make_training_task
from kinedex.ops.search.inverted_lists import inverted_lists
from kinedex.ops.search.keyframe_search import keyframe_list, search_lists
from kinedex.ops.templates.templates import learn_soft, quantise
from kinedex.ops.words import TakeWords
from kinedex.storage.store.store import Store

CLASSES, CLIPS, FRAMES = sized((69, 9, 42_586), (9, 9, 5_554))
"""The training set of the thesis (Section 4.5): nine clips of each of 69 classes, 24 minutes at 30 Hz."""


def figures(store: Store) -> list[Figure]:
    """Time one run beside as many searches over the inverted lists of the same clips."""
    clips = cut_clips(store.words())
    material = material_of(clips)
    evolution = EvolutionSettings()
    run = evolve(material, evolution, 1)
    one_run = Figure(
        "genetic run, M = 50, r = 5, G = 100",
        run.evaluated / 1e3,
        "k queries",
        seconds(lambda: evolve(material, evolution, 1), 3),
        "the same number of searches",
        _searches(clips, material, run.evaluated),
    )
    return [one_run]


def cut_clips(words: TakeWords) -> list[U64]:
    """Return clips of a store's words, as many and as long as those of the thesis; words of a short store repeat."""
    length = FRAMES // (CLASSES * CLIPS)
    enough = np.resize(words.words, CLASSES * CLIPS * length)
    return list(enough.reshape(CLASSES * CLIPS, length))


def material_of(clips: list[U64]) -> TrainingTask:
    """Return the first nine clips against all others; such clips have little in common, so δ is not 0 here."""
    template = quantise(learn_soft(clips[:CLIPS], 40).template, 0.3)
    return make_training_task(training_frames(clips, 40), CLIPS, template, (1 << 40) - 1)


def _searches(clips: list[U64], material: TrainingTask, queries: int) -> float:
    """Return the seconds of as many searches over inverted lists, for queries of an initial population."""
    drawn = [evolve(material, EvolutionSettings(population=1, generations=0), seed).query for seed in range(200)]
    offsets = np.arange(len(clips) + 1, dtype=np.int64) * len(clips[0])
    lists = inverted_lists(np.concatenate(clips), offsets, 1, 40)

    def all_searches() -> None:
        for query in drawn:
            pairs = zip(query.masks.tolist(), query.values.tolist(), strict=True)
            search_lists([keyframe_list(lists, *pair) for pair in pairs], query.gaps)

    return seconds(all_searches, 5) * queries / len(drawn)
