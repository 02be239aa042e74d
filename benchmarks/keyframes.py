"""Learning keyframe queries: one genetic run on a training set of 24 minutes and 69 classes, on one core."""

from __future__ import annotations

import numpy as np

from benchmarks.harness import Figure, seconds
from kinedex.ops.keyframes.fitness import training_frames
from kinedex.ops.keyframes.genetic_algorithm import evolve
from kinedex.ops.keyframes.training_task import EvolutionSettings, TrainingTask, make_training_task
from kinedex.ops.search.keyframes import keyframe_list, search
from kinedex.ops.search.runs import word_runs
from kinedex.ops.search.segments import to_axis
from kinedex.ops.templates.templates import learn_soft, quantise
from kinedex.ops.words import U64, TakeWords
from kinedex.storage.store.store import Store

CLASSES, CLIPS, FRAMES = 69, 9, 42_586
"""The thesis's training set: nine clips of each of 69 classes, 24 minutes at 30 Hz."""


def figures(store: Store) -> list[Figure]:
    """Time one run, and its fitness beside the general keyframe search on the same clips."""
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
    """Clips of a store's words, as many and as long in all as the thesis's; words repeat where a store is short."""
    length = FRAMES // (CLASSES * CLIPS)
    enough = np.resize(words.words, CLASSES * CLIPS * length)
    return list(enough.reshape(CLASSES * CLIPS, length))


def material_of(clips: list[U64]) -> TrainingTask:
    """The first nine clips against all others; stretches of anything have little in common, so δ is not 0 here."""
    template = quantise(learn_soft(clips[:CLIPS], 40).template, 0.3)
    return make_training_task(training_frames(clips, 40), CLIPS, template, (1 << 40) - 1)


def _searches(clips: list[U64], material: TrainingTask, queries: int) -> float:
    """Seconds of as many general searches, for queries of an initial population, from the runs of words."""
    drawn = [evolve(material, EvolutionSettings(population=1, generations=0), seed).query for seed in range(200)]
    offsets = np.arange(len(clips) + 1, dtype=np.int64) * len(clips[0])
    runs = word_runs(np.concatenate(clips), offsets)
    starts, stops = to_axis(runs.take, runs.start), to_axis(runs.take, runs.stop)

    def all_searches() -> None:
        for query in drawn:
            pairs = zip(query.masks.tolist(), query.values.tolist(), strict=True)
            search([keyframe_list(starts, stops, runs.word, *pair) for pair in pairs], query.gaps)

    return seconds(all_searches, 5) * queries / len(drawn)
