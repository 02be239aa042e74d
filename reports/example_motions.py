"""Add the motions of segments and of their nearest examples to the player of a page."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence

import numpy as np

from kinedex.ops.intervals import TakeSegment
from kinedex.ops.templates.nearest_clip import nearest_clips
from kinedex.ops.words import U64
from kinedex.pipelines.engine.display import Progress, no_progress
from kinedex.pipelines.evaluation.comparison_results import SplitResult, Study
from kinedex.pipelines.evaluation.folds import TestTake
from kinedex.pipelines.templates.stored_clips import Key, NearestExample, clip_intervals, nearest_examples, words_of
from kinedex.pipelines.templates.template_learning import TrainingClips
from kinedex.reports.comparison_tables import take_title
from kinedex.reports.embedded_motions import MAX_BYTES, EmbeddedMotions
from kinedex.reports.report_data import Template
from kinedex.storage.store.store import Store

MAX_PIECES = 500
"""Maximum number of segments that are embedded as separate motions, because their whole takes are not embedded."""


def with_hits(
    store: Store,
    motions: EmbeddedMotions,
    hits: Sequence[TakeSegment],
    others: Sequence[TakeSegment],
    templates: Sequence[Template],
    progress: Progress = no_progress,
) -> tuple[EmbeddedMotions, dict[Key, int]]:
    """Add motions of hits to those of a page, and nearest examples of all segments that the page can play.

    Parameters
    ----------
    store : Store
        The store of the takes and the clips.
    motions : EmbeddedMotions
        The motions of the page.
    hits : sequence of TakeSegment
        Segments that the page must be able to play.
    others : sequence of TakeSegment
        Further segments of the page. Of the first `MAX_PIECES`, the motions of as many as fit are added.
    templates : sequence of Template
        Learned templates, with the names of their clips.
    progress : callable
        Makes a progress bar of a description and a number of templates.

    Returns
    -------
    motions : EmbeddedMotions
        The motions of the page with those that were added.
    near : dict of (take, class, start, stop) to int
        The place of each nearest example in `motions.near`.
    """
    found = motions.with_pieces(store, ((hit.take, hit.start, hit.stop) for hit in hits))
    further = others[:MAX_PIECES]
    found = found.with_pieces(store, ((one.take, one.start, one.stop) for one in further), most=MAX_BYTES)
    played = {hit.key: hit.subclass for hit in (*hits, *others) if found.has(hit.take, hit.start, hit.stop)}
    near = nearest_examples(store, played, templates, progress)
    found = found.with_near(store, [(one.take, one.start, one.stop, one.frames) for one in near.values()])
    return found, {key: place for place, key in enumerate(near)}


def with_study(
    store: Store, study: Study, motions: EmbeddedMotions, progress: Progress = no_progress
) -> tuple[EmbeddedMotions, dict[Key, int]]:
    """Add the nearest training example of every segment, automatic or manual, to the motions of a page.

    Parameters
    ----------
    store : Store
        The store of the takes and the clips.
    study : Study
        The comparison.
    motions : EmbeddedMotions
        The motions of the takes with a timeline, named by the titles of these takes.
    progress : callable
        Makes a progress bar of a description and a number of takes.

    Returns
    -------
    motions : EmbeddedMotions
        The motions of the page with those of the examples.
    near : dict of (title, class, start, stop) to int
        The place of each nearest example in `motions.near`.
    """
    near: dict[Key, NearestExample] = {}
    shown = [(result, name) for result in study.splits for name in dict.fromkeys(result.shown().values())]
    with progress("nearest examples", len(shown)) as bar:
        for result, name in shown:
            fold, take = next((fold, take) for fold in result.folds for take in fold.test_takes if take.name == name)
            title = take_title(study, result, take)
            if motions.has(title, 0, take.frames):
                near |= _of_take(store, title, take, result, _by_class(store, fold.clips, study.class_of))
            bar.advance()
    found = motions.with_near(store, [(one.take, one.start, one.stop, one.frames) for one in near.values()])
    return found, {key: place for place, key in enumerate(near)}


def _by_class(
    store: Store, clips: tuple[TrainingClips, ...], classes: Mapping[str, str]
) -> dict[str, list[tuple[str, int, int]]]:
    """Return the clips of each class as take, start and stop, without mirrored clips."""
    found: dict[str, list[tuple[str, int, int]]] = defaultdict(list)
    for one in clips:
        found[classes.get(one.subclass, one.subclass)] += clip_intervals(
            store, one.names[: len(one.names) - one.mirrored]
        )
    return found


def _of_take(
    store: Store, title: str, take: TestTake, result: SplitResult, clips: Mapping[str, list[tuple[str, int, int]]]
) -> dict[Key, NearestExample]:
    """Return the nearest example of each segment of a take."""
    named = {take_id: name for name, take_id in store.take_ids.items()}
    whole: U64 = np.concatenate([*words_of(store, [named[part] for part in take.take_ids]).values()])
    intervals: dict[str, dict[tuple[int, int], None]] = defaultdict(dict)
    for segments in (take.truth, *(outcome[take.name] for outcome in result.outcomes.values())):
        for one in segments:
            intervals[one.label][one.start, one.stop] = None
    found = {}
    for label, own in intervals.items():
        positions = [(start, stop) for start, stop in own if start < stop]
        if clips.get(label) and positions:
            words = words_of(store, sorted({name for name, _, _ in clips[label]}))
            parts = [words[name][start:stop] for name, start, stop in clips[label]]
            features = len(store.feature_set.features)
            nearest = nearest_clips(parts, [whole[start:stop] for start, stop in positions], features)
            for (start, stop), one_near in zip(positions, nearest, strict=True):
                example = NearestExample(*clips[label][one_near.clip], one_near.cost, one_near.frames)
                found[title, label, start, stop] = example
    return found
