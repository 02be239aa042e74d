"""Annotate held-out takes with one class, by the method of a pipeline and with its templates or an edited one.

All settings are those of the stage `annotate` of the pipeline: method, δ, τ, classes, keyframe queries, shortest
segment. An edited template replaces the learned one as a template of `learn_templates.template_files` would: it has no
clips, so `method: best` cannot learn a background from its clips, and `each_example` cannot make templates of them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from pydantic import ValidationError

from kinedex.catalog.classes import Classes
from kinedex.catalog.queries.keyframe_query import KeyframeQuery
from kinedex.explorer.templates import TemplateUse
from kinedex.ops.annotation.segments import TOLERANCE, Matches, Segment
from kinedex.ops.arrays import F64, I32, I64
from kinedex.ops.cache import Cache
from kinedex.ops.errors import KinedexError
from kinedex.ops.templates.templates import QuantisedTemplate
from kinedex.ops.words import TakeWords
from kinedex.pipelines.annotation.annotation_setup import (
    Preparation,
    archive_material,
    learned_queries,
    queries_of,
)
from kinedex.pipelines.annotation.annotators import Annotator
from kinedex.pipelines.annotation.batches import annotate_words, split_takes
from kinedex.pipelines.annotation.methods import Material, Takes
from kinedex.pipelines.annotation.threshold_calibration import Calibration
from kinedex.pipelines.engine.executors import cores, in_threads
from kinedex.pipelines.keyframes.slice_search import stored_words
from kinedex.pipelines.templates.examples import Rejected, rejected_examples
from kinedex.pipelines.templates.template_learning import SubclassTemplate, TrainingClips
from kinedex.pipelines.templates.training import TemplateParameters, training_material
from kinedex.storage.store.store import Store

Found = tuple[I64, I64, F64]
"""Starts, ends and costs, as in `Matches`."""

Key = tuple[object, ...]

Step = Callable[[], None]

MAX_BYTES = 200_000_000
"""Maximum number of bytes of cached matches, of which the least recently used are dropped; 28 templates in 100 h take
110 MB.
"""


@dataclass(frozen=True)
class CachedMatches:
    """The matches of a template below a threshold; they contain the matches below every lower threshold."""

    tau: float
    starts: I32
    ends: I32
    costs: F64

    @property
    def nbytes(self) -> int:
        """The size in bytes."""
        return self.starts.nbytes + self.ends.nbytes + self.costs.nbytes

    def below(self, tau: float) -> Found:
        """Return the matches below a threshold, which must not exceed `tau`."""
        starts, ends, costs = self.starts, self.ends, self.costs
        if tau < self.tau:
            chosen = costs < tau - TOLERANCE
            starts, ends, costs = starts[chosen], ends[chosen], costs[chosen]
        return starts.astype(np.int64), ends.astype(np.int64), costs


MATCHES: Cache[Key, CachedMatches] = Cache(MAX_BYTES, lambda held: held.nbytes)
"""The matches of the templates that are being edited, and of those that compete with them."""


@dataclass(frozen=True)
class CachingMethod:
    """A method that offers matches, with matches that are cached from one annotation to the next.

    Attributes
    ----------
    method : AnnotationMethod
        The method.
    scope : tuple
        The store and its version, which are part of the cache's keys, because take ids are unique within these only.
    """

    method: Any
    scope: tuple[object, ...]

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the method."""
        return getattr(self.method, name)

    def annotate(self, takes: Takes) -> list[list[Segment]]:
        """Label takes as the method does."""
        found: list[list[Segment]] = self.method.of_matches(self.matches(takes.words, takes.ranges), takes.words)
        return found

    def matches(self, words: TakeWords, ranges: Sequence[I64]) -> Matches:
        """Return the matches of each template as the method does, from the cache if it has them."""
        taus = self.method.thresholds[self.method.class_index]
        takes = words.take_ids.tobytes()
        keys = [
            (*self.scope, takes, own.tobytes(), *template_key(one))
            for one, own in zip(self.method.templates, ranges, strict=True)
        ]
        found = {
            place: held.below(tau)
            for place, (key, tau) in enumerate(zip(keys, taus.tolist(), strict=True))
            if (held := MATCHES.get(key)) is not None and held.tau >= tau
        }
        missing = [place for place in range(len(keys)) if place not in found]
        if missing:
            parts = self.method.only(missing).matches(words, [ranges[place] for place in missing]).parts()
            for place, own in zip(missing, parts, strict=True):
                found[place] = own
                starts, ends, costs = own
                held = CachedMatches(float(taus[place]), starts.astype(np.int32), ends.astype(np.int32), costs)
                MATCHES.put(keys[place], held)
        return Matches.of([found[place] for place in range(len(keys))])


def template_key(template: QuantisedTemplate) -> tuple[bytes, bytes, bytes]:
    """Return the part of a cache key that identifies a template by everything that its matches depend on."""
    weights = b"" if template.feature_weights is None else template.feature_weights.tobytes()
    return template.mask.tobytes(), template.value.tobytes(), weights


@dataclass(frozen=True)
class PipelineMaterial:
    """The inputs of a pipeline's annotation besides templates; each is read when it is first needed.

    Attributes
    ----------
    store : Store
        The store.
    use : TemplateUse
        The templates of the stage, and how its pipeline annotates with them.
    """

    store: Store
    use: TemplateUse

    @cached_property
    def queries(self) -> tuple[list[KeyframeQuery], list[KeyframeQuery]]:
        """The keyframe queries of files, and the queries that the pipeline has learned."""
        given, learned = queries_of(self.store, self.use.params), self.use.keyframes
        return given, [] if learned is None else learned_queries(self.store, learned)

    @cached_property
    def _made_with(self) -> TemplateParameters:
        record = self.store.manifest.stages.get(self.use.stage)
        try:
            return TemplateParameters.model_validate({} if record is None else record.summary.get("params") or {})
        except ValidationError:
            raise KinedexError(
                f"the parameters of {self.use.stage} are those of another version of kinedex, and this method needs "
                "them; run the pipeline again"
            ) from None

    @cached_property
    def _examples(self) -> list[TrainingClips]:
        return training_material(self.store, self._made_with).clips

    @cached_property
    def _rejected(self) -> list[Rejected]:
        return rejected_examples(self.store, self._made_with, of_any=True)

    @cached_property
    def _materials(self) -> dict[frozenset[str], Material]:
        return {}

    def _material_of(self, templates: Sequence[SubclassTemplate]) -> Material:
        """Return what the method is fitted with for templates, which is read once."""
        method = self.use.params.annotation_method
        made_with = TemplateParameters.model_validate({}) if method.needs.templates == "learned" else self._made_with
        names = frozenset(f"{one.subclass}/{name}" for one in templates for name in one.clips)
        if names not in self._materials:
            of_files = {one.subclass for one in templates if not one.clips}
            made = archive_material(
                self.store, self.use.params, made_with, templates,
                lambda: [one for one in self._examples if one.subclass not in of_files], lambda: self._rejected,
            )  # fmt: skip
            others = next(iter(self._materials.values()), made)
            self._materials[names] = replace(made, unlabelled=others.unlabelled)
        return self._materials[names]

    def annotator(
        self, templates: Sequence[SubclassTemplate], classes: Classes, taus: Mapping[str, float]
    ) -> Annotator:
        """Return the annotator of the pipeline with other templates, classes and thresholds.

        Parameters
        ----------
        templates : sequence of SubclassTemplate
            The templates; those without clips come from a file.
        classes : Classes
            The classes to label with.
        taus : mapping of str to float
            The threshold of each class.
        """
        params = self.use.params.model_copy(update={"tau_by_class": {}})
        prepared = Preparation(self.store, params, classes, *self.queries)
        return prepared.annotator(templates, self._material_of(templates), Calibration(dict(taus), {}, ()))


def word_batches(store: Store, take_ids: Sequence[int]) -> list[TakeWords]:
    """Return the words of takes, sorted by take id, in batches that are each annotated by one thread."""
    words = stored_words(store, take_ids)
    found, first = [], 0
    for batch in split_takes(words.take_ids.tolist(), words.frames.tolist()):
        last = first + len(batch)
        offsets = words.offsets[first : last + 1]
        known = None if words.known is None else words.known[first:last]
        found.append(
            TakeWords(words.take_ids[first:last], offsets - offsets[0], words.words[offsets[0] : offsets[-1]], known)
        )
        first = last
    return found


def class_segments(
    store: Store, annotator: Annotator, label: str, batches: Sequence[TakeWords], step: Step
) -> list[tuple[Segment, ...]]:
    """Return the segments of a class in the takes of some batches, in the order of the takes.

    Parameters
    ----------
    store : Store
        The store of the takes.
    annotator : Annotator
        The annotator.
    label : str
        The class.
    batches : sequence of TakeWords
        The words of the takes.
    step : callable
        Called after each batch.
    """
    if annotator.method.offers.matches and not any(annotator.queries):
        kept: Any = CachingMethod(annotator.method, (str(store.path), store.manifest.version))
        annotator = replace(annotator, method=kept)
    place = annotator.classes.index(label)
    found: list[tuple[Segment, ...]] = []
    read = store if annotator.method.needs.positions else None
    for annotated in in_threads(partial(annotate_words, annotator, store=read), batches, cores()):
        found += [tuple(one for one in each.segments if one.class_index == place) for each in annotated]
        step()
    return found
