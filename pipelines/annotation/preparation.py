"""What annotation needs besides templates: takes, classes, queries, background and thresholds."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import polars as pl

from kinedex.catalog.classes import OWN, Classes, load_classes
from kinedex.catalog.queries.keyframe_query import KeyframeQuery
from kinedex.catalog.queries.query_files import read_query_files
from kinedex.ops.annotation.decoding import background
from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.pipelines.annotation.annotators import Annotator
from kinedex.pipelines.annotation.parameters import CALIBRATED, AnnotationParameters
from kinedex.pipelines.annotation.threshold_calibration import Calibration, calibrate
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.keyframes.learning import every_query
from kinedex.pipelines.keyframes.runs import outcomes_of
from kinedex.pipelines.templates.learning import (
    SubclassTemplate,
    TrainingClips,
    learn_templates,
    read_templates,
    run_of,
)
from kinedex.pipelines.templates.recipes import feature_weights
from kinedex.pipelines.templates.training import (
    TemplateParameters,
    clips_to_learn_from,
    completed,
    takes_to_learn_from,
)
from kinedex.storage.store.store import Store

F64 = npt.NDArray[np.float64]


def without_effect(params: AnnotationParameters) -> list[str]:
    """What is asked for, and does not matter to the method, in words."""
    asked = ["`tau: calibrated`"] * (params.tau == CALIBRATED) + ["`tau_by_class`"] * bool(params.tau_by_class)
    if params.method != "best" or not asked:
        return []
    have = "has" if len(asked) == 1 else "have"
    return [f"{' and '.join(asked)} {have} no effect with `method: best`, in which τ does not matter"]


def calibrated(
    context: StageContext,
    store: Store,
    params: AnnotationParameters,
    classes: Classes,
    clips: Sequence[TrainingClips] | None = None,
) -> Calibration:
    """The calibrated thresholds of classes, none where they are not asked for or do not matter.

    Parameters
    ----------
    clips: what to calibrate on; None: all clips that the templates were learned from.
    """
    if params.tau != CALIBRATED or params.method == "best":
        return Calibration({}, {}, ())
    learned = context.params_of("templates", TemplateParameters)
    counts = feature_weights(learned.weights, store.feature_set)

    def learn(some: Sequence[TrainingClips]) -> list[SubclassTemplate]:
        features, kinds = len(store.feature_set.features), [params.templates]
        found = [one for task in learn_templates(some, kinds, features, context.executor, counts) for one in task]
        return completed(found, learned, store.feature_set, kinds, where_possible=True)

    if clips is None:
        clips = clips_to_learn_from(store, learned, takes_to_learn_from(store, learned))
    actors = dict(store.takes().select("name", "actor").iter_rows())  # a split's clips need not be the stage's
    return calibrate(clips, actors, classes, params.delta, learn, context.executor)


def refined(
    annotator: Annotator, params: AnnotationParameters, rate_hz: float, calibrated: Mapping[str, float] | None = None
) -> Annotator:
    """An annotator with the thresholds of classes, which rows of templates have none of, and the least length of
    segments.

    Parameters
    ----------
    calibrated: class → τ, where that was asked for; `tau_by_class` goes before it.

    Raises
    ------
    KinedexError: `tau_by_class` names no class.
    """
    least = math.ceil(round(params.min_seconds * rate_hz, 9))
    wrong = sorted(set(params.tau_by_class) - set(annotator.classes))
    if wrong:
        raise KinedexError(f"tau_by_class: no class is named '{wrong[0]}'{did_you_mean(wrong[0], annotator.classes)}")
    given = {} if annotator.row is not None else {**(calibrated or {}), **params.tau_by_class}
    taus = np.array([given.get(name, annotator.tau) for name in annotator.classes]) if given else None
    return replace(annotator, taus=taus, min_frames=least)


def takes_to_annotate(store: Store, params: AnnotationParameters) -> pl.DataFrame:
    """The takes that the filter selects, sorted by name; a KinedexError where there are none."""
    takes = store.takes(params.where)
    if not takes.height:
        every = store.takes()
        raise KinedexError(
            f"no take to annotate: the filter `{params.where}` selects none of {every.height} takes, "
            f"{every.filter(pl.col('class').is_null()).height} of which have no class"
        )
    return takes


def classes_of(store: Store, params: AnnotationParameters, templates: Sequence[SubclassTemplate]) -> Classes:
    """The classes of the class file, or with "own" those that have templates.

    A class file may name every subclass that the archive has, also those that are not learned from.
    """
    learned = {one.subclass for one in templates}
    labelled = set(store.takes()["class"].drop_nulls().unique())
    return load_classes(params.classes, learned if params.classes == OWN else learned | labelled)


def annotated_classes(context: StageContext, store: Store, stage: str) -> Classes:
    """Return the classes that a stage `annotate` of this pipeline has annotated with."""
    params = context.params[stage]
    assert isinstance(params, AnnotationParameters)
    record = store.manifest.stages[context.key(stage)]
    templates = read_templates(store, context.key(record.summary["inputs"]["templates"]), params.templates)
    return classes_of(store, params, templates)


def usual_features(store: Store, templates: Sequence[SubclassTemplate]) -> F64:
    """The usual postures in the clips that templates were learned from, or in all takes where they are of none."""
    clips = {name for one in templates for name in one.clips}
    takes = store.takes().filter(pl.col("name").is_in(clips))
    words = store.words(takes["take_id"].to_list() if takes.height else None)
    return background([words.words], len(store.feature_set.features))


def learned_queries(context: StageContext, store: Store) -> list[KeyframeQuery]:
    """The queries that the pipeline's stage `learn_keyframes` learned; none where it has no such stage."""
    if "keyframes" not in context.inputs:
        return []
    table = store.result("queries", run=run_of(store, context.key(context.inputs["keyframes"])))
    return every_query(outcomes_of(table), store.feature_set)


def queries_of(store: Store, params: AnnotationParameters) -> list[KeyframeQuery]:
    """All queries of the query files."""
    return read_query_files(params.query_files, store.feature_set, store.rate_hz)
