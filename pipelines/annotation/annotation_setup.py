"""Prepare an annotation of a store: select takes and classes, read queries, calibrate, make the annotator."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import polars as pl

from kinedex.catalog.classes import OWN, Classes, load_classes
from kinedex.catalog.queries.keyframe_query import KeyframeQuery
from kinedex.catalog.queries.query_reader import read_query_files
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.annotation.annotators import Annotator, make_annotator
from kinedex.pipelines.annotation.confidence_calibration import CalibratedConfidence, Target, calibrate_confidence
from kinedex.pipelines.annotation.material import clip_examples, template_examples, unlabelled_takes
from kinedex.pipelines.annotation.methods import LabelledMotion, Material, Motions
from kinedex.pipelines.annotation.parameters import CALIBRATED, AnnotationParameters, MethodParameters, least_frames
from kinedex.pipelines.annotation.threshold_calibration import Calibration, Learn, calibrate
from kinedex.pipelines.engine.executors import Executor
from kinedex.pipelines.keyframes.learning_runs import outcomes_of
from kinedex.pipelines.keyframes.query_learning import every_query
from kinedex.pipelines.templates.examples import Rejected
from kinedex.pipelines.templates.template_learning import (
    SubclassTemplate,
    TrainingClips,
    learn_templates,
    read_templates,
    run_of,
)
from kinedex.pipelines.templates.training import TemplateParameters, feature_weights, with_given_templates
from kinedex.storage.store.store import Store

OWN_PROBABILITIES = "confidences are the probabilities that the method gives"
OF_POSITIONS = "no confidence: the method needs positions, and gives no probabilities"


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
    """

    store: Store
    params: MethodParameters
    classes: Classes
    queries: Sequence[KeyframeQuery] = ()
    learned: Sequence[KeyframeQuery] = ()

    def annotator(
        self, templates: Sequence[SubclassTemplate], material: Material, calibration: Calibration
    ) -> Annotator:
        """Make the annotator of templates.

        Parameters
        ----------
        templates : sequence of SubclassTemplate
            The templates, of the kind that the parameters name.
        material : Material
            What the method is fitted with.
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
            self.store.feature_set, templates, classes, params.delta, taus, self.queries, method, material
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
        if self.params.tau != CALIBRATED or not self.params.annotation_method.needs.thresholds:
            return Calibration({}, {}, ())
        return calibrate(clips(), self._actors(), self.classes, self.params.delta, learn, executor, rejected())

    def confidence(
        self,
        clips: Sequence[TrainingClips],
        takes: pl.DataFrame,
        calibration: Calibration,
        learn: Learn,
        executor: Executor,
        material: Material,
        rejected: Sequence[Rejected] = (),
    ) -> CalibratedConfidence:
        """Learn the confidence of labels from held-out examples, if the method does not give probabilities.

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
        material : Material
            What the method is fitted with, whose examples are those that are not held out.
        rejected : sequence of Rejected, optional
            Intervals that people have rejected.
        """
        needs, offers = self.params.annotation_method.needs, self.params.annotation_method.offers
        if offers.probabilities or needs.positions:
            return CalibratedConfidence(None, 0, 0, OWN_PROBABILITIES if offers.probabilities else OF_POSITIONS)

        def make(rest: Sequence[TrainingClips], refused: Sequence[Rejected]) -> Annotator:
            shown = rest if needs.templates == "learned" else [one.first() for one in rest]
            examples = Motions(partial(clip_examples, self.store, rest, refused, needs))
            return self.annotator(learn(shown), replace(material, examples=examples), calibration)

        target = Target(takes["frames"].to_list(), takes["actor"].to_list())
        actors, classes = self._actors(), self.classes
        return calibrate_confidence(clips, actors, classes, self.params.method, target, make, executor, rejected)

    def _actors(self) -> dict[str, str | None]:
        return dict(self.store.takes().select("name", "actor").iter_rows())


def own_thresholds(params: MethodParameters, calibration: Calibration, annotator: Annotator) -> dict[str, float]:
    """Return the threshold of each class that has a template; empty if all classes share one threshold."""
    if not (calibration.taus or params.tau_by_class) or not params.annotation_method.needs.thresholds:
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


def archive_material(
    store: Store,
    params: MethodParameters,
    made_with: TemplateParameters,
    templates: Sequence[SubclassTemplate],
    clips: Callable[[], Sequence[TrainingClips]],
    rejected: Callable[[], Sequence[Rejected]],
) -> Material:
    """Return what a method is fitted with for the takes of a store.

    Parameters
    ----------
    store : Store
        The store.
    params : MethodParameters
        The method and its parameters.
    made_with : TemplateParameters
        The parameters that templates are learned with.
    templates : sequence of SubclassTemplate
        The templates, whose clips are the examples of a method that needs learned templates.
    clips, rejected : callable
        Return the examples of other methods, and the intervals that people have rejected.
    """
    needs = params.annotation_method.needs

    def examples() -> list[LabelledMotion]:
        if needs.templates == "learned":
            return template_examples(store, templates, needs)
        return clip_examples(store, clips(), rejected(), needs)

    weights = feature_weights(made_with.weights, store.feature_set)
    unlabelled = Motions(partial(unlabelled_takes, store, needs))
    return Material(Motions(examples), unlabelled, store.rate_hz, weights, made_with.mirror)


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
