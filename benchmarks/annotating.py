"""Annotation at the size of the thesis's experiment: 133,019 frames, 69 subclasses of about 50 columns, on one core.

The words are those of the synthetic archive, its takes laid out again and again in a drawn order; the templates are
learned from the clips of one actor and one class each, and stretched or shortened to the thesis's mean length. Queries
ask for three of a template's own columns. What labels are found means nothing here; what it costs does.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import polars as pl

from benchmarks.harness import Figure, seconds
from catalog.classes import load_classes
from catalog.features import FeatureSet
from catalog.queries import Gap, Keyframe, KeyframeQuery
from ops.distances.decoding import background
from ops.templates.templates import Learned, QuantisedTemplate, Template, learn_soft, quantise
from ops.words import TakeWords
from pipelines.annotation.annotating import BATCH_FRAMES, Annotator, annotate_words, make_annotator
from pipelines.templates.learning import SubclassTemplate
from storage.store import Store

FRAMES, SUBCLASSES, COLUMNS = 133_019, 69, 50
DELTA, TAU = 0.05, 0.13
KEPT = 0.05
"""The share of the frames that the queries leave, about."""

_POSITIONS = (8, 25, 42)
_GAP = Gap(8, 34)


def figures(store: Store) -> list[Figure]:
    """The thesis's method without and with preselection, and all frames labelled together."""
    batches = _words(store)
    templates = _templates(store)
    classes = load_classes("own", [one.subclass for one in templates])
    plain = make_annotator(store.feature_set, templates, classes, DELTA, TAU)
    usual = background([batch.words for batch in batches], len(store.feature_set.features))
    row = make_annotator(store.feature_set, templates, classes, DELTA, TAU, (), usual)
    queries = [_query(one, store.feature_set, batches[0]) for one in templates]
    chosen = make_annotator(store.feature_set, templates, classes, DELTA, TAU, queries)
    both = replace(chosen, row=row.row)
    cells = FRAMES * SUBCLASSES * COLUMNS / 1e6
    whole = seconds(lambda: _run(plain, batches), 3)
    found = [Figure("annotation, 133,019 frames, 69 subclasses", cells, "M cells", whole)]
    share = float(np.mean([one.preselected.mean() for batch in batches for one in annotate_words(chosen, batch)]))
    for name, annotator in (
        (f"the same in keyframe hits, {share:.1%} of the frames", chosen),
        ("the same, labelled together (best)", row),
        (f"the same, together, in {share:.1%} of the frames", both),
    ):
        time = seconds(lambda one=annotator: _run(one, batches), 3)
        found.append(Figure(name, cells, "M cells", time, "all frames, one by one", whole))
    return found


def _run(annotator: Annotator, batches: list[TakeWords]) -> None:
    for batch in batches:
        annotate_words(annotator, batch)


def _words(store: Store) -> list[TakeWords]:
    """Takes of the archive in a drawn order until there are enough frames, in batches as the stage has them."""
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
    """A template for each class and actor, of `COLUMNS` columns."""
    clips = store.takes("class IS NOT NULL").sort("class", "actor", "name")
    words = store.words(clips["take_id"].to_list())
    place = {take: index for index, take in enumerate(words.take_ids.tolist())}
    found = []
    for (label, actor), group in clips.group_by("class", "actor", maintain_order=True):
        own = [words.take(place[take]) for take in group.sort("name")["take_id"].to_list()][:3]
        values = learn_soft(own, len(store.feature_set.features)).template.values
        stretched = values[np.linspace(0, len(values) - 1, COLUMNS).round().astype(int)]
        learned = Learned(Template(stretched, np.ones(COLUMNS)), 1, (0.0,) * len(own))
        found.append(SubclassTemplate(f"{label} {actor}", "soft", learned, tuple(group["name"].to_list())))
    while len(found) < SUBCLASSES:
        again = found[len(found) % clips.select(pl.struct("class", "actor").n_unique()).item()]
        found.append(replace(again, subclass=f"{again.subclass} {len(found)}"))
    return found[:SUBCLASSES]


def _query(one: SubclassTemplate, features: FeatureSet, words: TakeWords) -> KeyframeQuery:
    """Three columns of a template in the feature set that is closest to leaving `KEPT` of the frames."""
    quantised = quantise(one.learned.template, DELTA)
    alone = load_classes("own", [one.subclass])
    best: tuple[float, KeyframeQuery] | None = None
    for name in ("upper", "lower", "mix"):
        query = KeyframeQuery(
            one.subclass, one.subclass, _keyframes(quantised, features, name), (_GAP, _GAP), _POSITIONS
        )
        annotator = make_annotator(features, [one], alone, DELTA, TAU, [query])
        share = float(np.mean([found.preselected[0] for found in annotate_words(annotator, words)]))
        if best is None or abs(share - KEPT) < best[0]:
            best = abs(share - KEPT), query
    assert best is not None
    return best[1]


def _keyframes(quantised: QuantisedTemplate, features: FeatureSet, name: str) -> tuple[Keyframe, ...]:
    first, mask = features.sets[name].first - 1, (1 << features.sets[name].count) - 1
    return tuple(
        Keyframe(name, (int(quantised.mask[at]) >> first) & mask, (int(quantised.value[at]) >> first) & mask)
        for at in _POSITIONS
    )
