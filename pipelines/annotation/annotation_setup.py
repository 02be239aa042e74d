"""Prepare an annotation of a store: select takes and classes, read queries, calibrate, make the annotator."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import polars as pl

from kinedex.catalog.classes import OWN, Classes, load_classes
from kinedex.catalog.queries.keyframe_query import KeyframeQuery
from kinedex.catalog.queries.query_reader import read_query_files
from kinedex.ops.arrays import U64
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.annotation.annotators import Annotator, make_annotator
from kinedex.pipelines.annotation.confidence_calibration import CalibratedConfidence, Target, calibrate_confidence
from kinedex.pipelines.annotation.parameters import CALIBRATED, AnnotationParameters, MethodParameters, least_frames
from kinedex.pipelines.annotation.single_examples import usual_postures, with_single_examples
from kinedex.pipelines.annotation.threshold_calibration import Calibration, Learn, calibrate
from kinedex.pipelines.engine.executors import Executor
from kinedex.pipelines.keyframes.learning_runs import outcomes_of
from kinedex.pipelines.keyframes.query_learning import every_query
from kinedex.pipelines.templates.examples import Rejected, interval_of
from kinedex.pipelines.templates.template_learning import (
    SubclassTemplate,
    TrainingClips,
    learn_templates,
    read_templates,
    run_of,
)
from kinedex.pipelines.templates.training import TemplateParameters, feature_weights, with_given_templates
from kinedex.storage.store.store import Store

Single = Callable[[Annotator, Sequence[TrainingClips], Sequence[Rejected]], Annotator]
"""A function that returns an annotator with each example as a template and rejected intervals as rivals."""


def takes_to_annotate(store: Store, where: str) -> pl.DataFrame:
    """Return the takes that a SQL filter selects, sorted by name; raise a KinedexError if there are none."""
    takes = store.takes(where)
    if not takes.height:
        every = store.takes()
        raise KinedexError(
            f"no take to annotate: the filter `{where}` selects none of {every.height} takes, "
            f"{every.filter(pl.col('class').is_null()).height} of which have no class"
        )
    return takes


def annotation_classes(store: Store, classes: str, templates: Sequence[SubclassTemplate]) -> Classes:
    """Return the classes of a class file, or with "own" one class for each subclass that has a template.

    A class file may name any subclass of the archive, including those without templates.
    """
    learned = {one.subclass for one in templates}
    labelled = set(store.takes()["class"].drop_nulls().unique())
    return load_classes(classes, learned if classes == OWN else learned | labelled)


def queries_of(store: Store, params: MethodParameters) -> list[KeyframeQuery]:
    """Return all queries in the query files of an annotation."""
    return read_query_files(params.query_files, store.feature_set, store.rate_hz)


def template_words(store: Store, templates: Sequence[SubclassTemplate]) -> list[U64]:
    """Return the words of the clips that templates were learned from, or of all takes if there are no such clips.

    Clips whose bodies lack joints are excluded, unless all do.
    """
    clips = {name for one in templates for name in one.clips}
    takes = store.takes().filter(pl.col("name").is_in(clips))
    parts = {name: interval_of(name, store.take_ids) for name in sorted(clips - set(takes["name"]))}
    cut = [
        store.words([store.take_ids[take]]).words[frames]
        for take, frames in parts.values()
        if take in store.take_ids and store.take_ids[take] not in store.known
    ]
    if cut and not takes.height:
        return cut
    return [store.words(takes["take_id"].to_list() if takes.height else None).best_known, *cut]


@dataclass(frozen=True)
class Preparation:
    """The settings of an annotation, from which annotators are made and calibrated.

    Attributes
    ----------
    store : Store
        The store, for its features, its rate, and the actors of takes.
    params : MethodParameters
        The method and its parameters.
    classes : Classes
        The classes to label with.
    queries, learned : sequence of KeyframeQuery
        The queries from files, and the learned ones.
    single : callable, optional
        Returns an annotator with each example as a template (`single_examples_of`).
    """

    store: Store
    params: MethodParameters
    classes: Classes
    queries: Sequence[KeyframeQuery] = ()
    learned: Sequence[KeyframeQuery] = ()
    single: Single | None = None

    def annotator(
        self, templates: Sequence[SubclassTemplate], clips: Callable[[], Sequence[U64]], calibration: Calibration
    ) -> Annotator:
        """Make the annotator of templates.

        Parameters
        ----------
        templates : sequence of SubclassTemplate
            The templates, of the kind that the parameters name.
        clips : callable
            Returns the words of the training clips; called only if the method needs them.
        calibration : Calibration
            The calibrated thresholds, see `thresholds`; those of `tau_by_class` take precedence.

        Raises
        ------
        KinedexError
            No template can be used, or `tau_by_class` names no class.
        """
        params, classes = self.params, self.classes
        taus = params.thresholds(classes.names, calibration.taus)
        method = params.annotation_method
        made = make_annotator(
            self.store.feature_set, templates, classes, params.delta, taus, self.queries, method, clips
        ).with_learned(self.learned, classes)
        return replace(made, min_frames=least_frames(params.min_seconds, self.store.rate_hz))

    def thresholds(
        self,
        clips: Callable[[], Sequence[TrainingClips]],
        learn: Learn,
        executor: Executor,
        rejected: Callable[[], Sequence[Rejected]] = tuple,
    ) -> Calibration:
        """Calibrate the thresholds of classes, if the parameters require it and the method uses thresholds.

        Parameters
        ----------
        clips : callable
            Returns the clips to calibrate on; called only if they are needed.
        learn : callable
            Learns templates from clips (`template_learner`).
        executor : Executor
            The workers.
        rejected : callable, optional
            Returns the intervals that people have rejected; called only if they are needed.
        """
        if self.params.tau != CALIBRATED or not self.params.annotation_method.uses_thresholds:
            return Calibration({}, {}, ())
        return calibrate(clips(), self._actors(), self.classes, self.params.delta, learn, executor, rejected())

    def confidence(
        self,
        clips: Sequence[TrainingClips],
        takes: pl.DataFrame,
        calibration: Calibration,
        learn: Learn,
        executor: Executor,
        rejected: Sequence[Rejected] = (),
    ) -> CalibratedConfidence:
        """Learn the confidence of labels from held-out examples.

        Parameters
        ----------
        clips : sequence of TrainingClips
            The examples.
        takes : polars.DataFrame
            Rows of the takes to annotate; their lengths and actors are used.
        calibration : Calibration
            The thresholds, which are those of all examples.
        learn, executor
            See `thresholds`.
        rejected : sequence of Rejected, optional
            Intervals that people have rejected, if every example is a template.
        """

        def make(rest: Sequence[TrainingClips], refused: Sequence[Rejected]) -> Annotator:
            words = [words for one in rest for words in one.words]
            if self.single is None:
                return self.annotator(learn(rest), lambda: words, calibration)
            # templates then only provide class names and numbers of columns (those of the first clips)
            made = self.annotator(learn([one.first() for one in rest]), lambda: words[:1], calibration)
            return self.single(made, rest, refused)

        target = Target(takes["frames"].to_list(), takes["actor"].to_list())
        actors, classes = self._actors(), self.classes
        return calibrate_confidence(clips, actors, classes, self.params.method, target, make, executor, rejected)

    def _actors(self) -> dict[str, str | None]:
        return dict(self.store.takes().select("name", "actor").iter_rows())


def own_thresholds(params: MethodParameters, calibration: Calibration, annotator: Annotator) -> dict[str, float]:
    """Return the threshold of each class that has a template; empty if all classes share one threshold."""
    if not (calibration.taus or params.tau_by_class) or not params.annotation_method.uses_thresholds:
        return {}
    thresholds = params.thresholds(annotator.classes, calibration.taus)
    labelled = [annotator.classes[index] for index in sorted(set(annotator.class_index.tolist()))]
    return {name: thresholds[name] for name in labelled}


def template_learner(
    store: Store, params: MethodParameters, learned_with: TemplateParameters, executor: Executor
) -> Learn:
    """Return a function that learns templates from clips with the parameters of a pipeline."""
    weights = feature_weights(learned_with.weights, store.feature_set)

    def learn(some: Sequence[TrainingClips]) -> list[SubclassTemplate]:
        features, kinds = len(store.feature_set.features), [params.templates]
        found = [one for task in learn_templates(some, kinds, features, executor, weights) for one in task]
        return with_given_templates(found, learned_with, store.feature_set, kinds, where_possible=True)

    return learn


def single_examples_of(store: Store, params: MethodParameters, templates: TemplateParameters) -> Single:
    """Return a function that makes each example of an annotator a template; the words of the store are read once."""
    features = len(store.feature_set.features)
    usual = cache(lambda: usual_postures(store.words(None).best_known, features))
    weights = feature_weights(templates.weights, store.feature_set)

    def single(made: Annotator, clips: Sequence[TrainingClips], rejected: Sequence[Rejected]) -> Annotator:
        return with_single_examples(made, clips, rejected, usual(), params.delta, weights)

    return single


def annotated_classes(store: Store, params: AnnotationParameters, stage: str) -> Classes:
    """Return the classes that a stage `annotate` has used.

    Parameters
    ----------
    store : Store
        The store that holds the annotations of the stage.
    params : AnnotationParameters
        The parameters of the stage.
    stage : str
        "<pipeline>/<stage>".
    """
    learned = f"{stage.split('/', 1)[0]}/{store.manifest.stages[stage].summary['inputs']['templates']}"
    return annotation_classes(store, params.classes, read_templates(store, learned, params.templates))


def learned_queries(store: Store, stage: str) -> list[KeyframeQuery]:
    """Return the queries that a stage `learn_keyframes`, given as "<pipeline>/<stage>", has learned."""
    return every_query(outcomes_of(store.result("queries", run=run_of(store, stage))), store.feature_set)
