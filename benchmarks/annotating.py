"""Time annotation at the size of the thesis's experiment (5.4): 133,019 frames, 69 subclasses, on one core.

The words are those of the synthetic archive, its takes repeated in a drawn order. Each template is learned from the
clips of one actor and one class and resampled to the thesis's mean length of about 50 columns. Queries contain three of
a template's own columns, or some features of them, so that a chosen share of the frames is left on average, margins
included: a twentieth (the thesis's learned queries made annotation 15 times as fast) and 15 % (the share that the
authors' manual queries leave of HDM05 takes). Only the cost of the labels is of interest here, not the labels.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import polars as pl

from benchmarks.harness import Figure, seconds, sized
from kinedex.catalog.classes import load_classes
from kinedex.catalog.features import FeatureSet
from kinedex.catalog.queries.keyframe_query import Gap, Keyframe, KeyframeQuery
from kinedex.ops.templates.templates import LearnedTemplate, QuantisedTemplate, Template, learn_soft, quantise
from kinedex.ops.words import TakeWords
from kinedex.pipelines.annotation.annotators import Annotator, make_annotator
from kinedex.pipelines.annotation.batches import BATCH_FRAMES, annotate_words, matched_ranges
from kinedex.pipelines.annotation.template_methods import BestMethod
from kinedex.pipelines.templates.template_learning import SubclassTemplate
from kinedex.storage.store.store import Store

FRAMES, SUBCLASSES, COLUMNS = *sized((133_019, 69), (6_000, 8)), 50
DELTA, TAU = 0.05, 0.13
KEPT = (0.05, 0.15)
"""Approximate fractions of the frames that queries leave, margins included."""

_POSITIONS = (8, 25, 42)
_GAP = Gap(8, 34)
_THINNED = (1, 2, 3, 4)  # a keyframe asks for every feature of its set, for every second one, …


def figures(store: Store) -> list[Figure]:
    """Time the thesis's method without and with preselection, and the method best."""
    batches = _words(store)
    templates = _templates(store)
    classes = load_classes("own", [one.subclass for one in templates])
    plain = make_annotator(store.feature_set, templates, classes, DELTA, TAU)
    words = [batch.words for batch in batches]
    row = make_annotator(store.feature_set, templates, classes, DELTA, TAU, method=BestMethod, clips=lambda: words)
    cells = FRAMES * SUBCLASSES * COLUMNS / 1e6
    whole = seconds(lambda: _run(plain, batches), 3)
    found = [Figure(f"annotation, {FRAMES:,} frames, {SUBCLASSES} subclasses", cells, "M cells", whole)]
    cases = [("the same, labelled together (best)", row)]
    choices = [_queries(one, store.feature_set, batches[0]) for one in templates]
    for kept in KEPT:
        queries = [min(own, key=lambda one: abs(one[0] - kept))[1] for own in choices]
        chosen = make_annotator(store.feature_set, templates, classes, DELTA, TAU, queries)
        share = _share(chosen, batches)
        cases.append((f"the same in keyframe hits, {share:.1%} of template × frame", chosen))
        if kept == KEPT[0]:
            cases.append(
                (f"the same, together, in {share:.1%} of template × frame", replace(chosen, method=row.method))
            )
    for name, annotator in cases:
        time = seconds(lambda one=annotator: _run(one, batches), 3)
        found.append(Figure(name, cells, "M cells", time, "all frames, one by one", whole))
    return found


def _share(annotator: Annotator, batches: list[TakeWords]) -> float:
    """Return the fraction of the frames within the ranges, margins included, averaged over the templates."""
    inside = sum(int((own[:, 1] - own[:, 0]).sum()) for batch in batches for own in matched_ranges(annotator, batch))
    return inside / len(annotator.templates) / sum(len(batch.words) for batch in batches)


def _run(annotator: Annotator, batches: list[TakeWords]) -> None:
    for batch in batches:
        annotate_words(annotator, batch)


def _words(store: Store) -> list[TakeWords]:
    """Return takes in a drawn order until there are enough frames, in batches as the stage makes them."""
    takes = store.takes("class IS NULL")
    words = store.words(takes["take_id"].to_list())
    random, pieces, frames = np.random.default_rng(0), list[np.ndarray](), 0
    while frames < FRAMES:
        one = words.take(int(random.integers(len(words.take_ids))))[: FRAMES - frames]
        pieces.append(one)
        frames += len(one)
    batches, batch = [], list[np.ndarray]()
    for place, piece in enumerate(pieces):
        batch.append(piece)
        if place + 1 == len(pieces) or sum(map(len, batch)) + len(pieces[place + 1]) > BATCH_FRAMES:
            offsets = np.cumsum([0, *map(len, batch)]).astype(np.int64)
            batches.append(TakeWords(np.arange(len(batch)), offsets, np.concatenate(batch)))
            batch = []
    return batches


def _templates(store: Store) -> list[SubclassTemplate]:
    """Learn a template of `COLUMNS` columns for each class and actor."""
    clips = store.takes("class IS NOT NULL").sort("class", "actor", "name")
    words = store.words(clips["take_id"].to_list())
    place = {take: index for index, take in enumerate(words.take_ids.tolist())}
    found = []
    for (label, actor), group in clips.group_by("class", "actor", maintain_order=True):
        own = [words.take(place[take]) for take in group.sort("name")["take_id"].to_list()][:3]
        values = learn_soft(own, len(store.feature_set.features)).template.values
        resampled = values[np.linspace(0, len(values) - 1, COLUMNS).round().astype(int)]
        learned = LearnedTemplate(Template(resampled, np.ones(COLUMNS)), 1, (0.0,) * len(own))
        found.append(SubclassTemplate(f"{label} {actor}", "soft", learned, tuple(group["name"].to_list())))
    while len(found) < SUBCLASSES:
        again = found[len(found) % clips.select(pl.struct("class", "actor").n_unique()).item()]
        found.append(replace(again, subclass=f"{again.subclass} {len(found)}"))
    return found[:SUBCLASSES]


def _queries(one: SubclassTemplate, features: FeatureSet, words: TakeWords) -> list[tuple[float, KeyframeQuery]]:
    """Return queries for three columns of a template, more and less strict, with the fraction that each leaves."""
    quantised = quantise(one.learned.template, DELTA)
    alone = load_classes("own", [one.subclass])
    found = []
    for name in ("upper", "lower", "mix"):
        for every in _THINNED:
            query = KeyframeQuery(
                one.subclass, one.subclass, _keyframes(quantised, features, name, every), (_GAP, _GAP), _POSITIONS
            )
            annotator = make_annotator(features, [one], alone, DELTA, TAU, [query])
            found.append((_share(annotator, [words]), query))
    return found


def _keyframes(quantised: QuantisedTemplate, features: FeatureSet, name: str, every: int) -> tuple[Keyframe, ...]:
    first = features.sets[name].first - 1
    mask = sum(1 << bit for bit in range(0, features.sets[name].count, every))
    return tuple(
        Keyframe(name, (int(quantised.mask[at]) >> first) & mask, (int(quantised.value[at]) >> first) & mask)
        for at in _POSITIONS
    )
