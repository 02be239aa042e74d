"""Stage leave_one_out: the same annotation and evaluation for each actor, with templates of the others only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import polars as pl
import pyarrow as pa
from pydantic import BaseModel, ConfigDict, Field

from kinedex.catalog.classes import Classes
from kinedex.catalog.queries.keyframe_query import KeyframeQuery
from kinedex.ops.annotation.decoding import background
from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.pipelines.annotation.annotators import make_annotator
from kinedex.pipelines.annotation.batches import annotate_takes
from kinedex.pipelines.annotation.parameters import AnnotationParameters
from kinedex.pipelines.annotation.preparation import annotated_classes, calibrated, queries_of, refined
from kinedex.pipelines.annotation.tables import annotated_takes, annotations_table
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.stage import Input, Stage
from kinedex.pipelines.evaluation.annotation_scores import (
    SCOPES,
    Evaluation,
    evaluate,
    measures,
    metrics_rows,
    metrics_table,
    pool_folds,
    write_metrics,
)
from kinedex.pipelines.evaluation.ground_truth import GroundTruth
from kinedex.pipelines.evaluation.label_files import GroundTruthParameters, ground_truth, not_labelled
from kinedex.pipelines.templates.learning import (
    SubclassTemplate,
    TrainingClips,
    learn_templates,
    read_templates,
)
from kinedex.pipelines.templates.recipes import feature_weights
from kinedex.pipelines.templates.training import TemplateParameters, clips_to_learn_from, completed, takes_to_learn_from
from kinedex.storage.store.store import Store


class Params(BaseModel):
    """What the stage `leave_one_out` takes; all else is as in the stages that it repeats."""

    model_config = ConfigDict(extra="forbid")

    column: str = Field(
        "actor", description="column of takes; each value that annotated takes have is left out of the training once"
    )


@dataclass(frozen=True)
class Fold:
    """One value that is left out: the takes to annotate, their ground truth, and the clips that remain."""

    value: str
    takes: pl.DataFrame
    truth: GroundTruth
    clips: tuple[TrainingClips, ...]


@dataclass(frozen=True)
class Setting:
    """What all folds share: the store, the classes, the queries, and how to annotate."""

    store: Store
    params: AnnotationParameters
    classes: Classes
    queries: Sequence[KeyframeQuery]


class LeaveOneOut(Stage[Params]):
    """The same annotation and evaluation for each actor, with templates of the others only."""

    name = "leave_one_out"
    parameters = Params
    inputs: ClassVar = {
        "templates": Input("learn_templates"),
        "annotations": Input("annotate"),
        "evaluation": Input("evaluate"),
    }
    outputs = ("metrics",)

    def run(self, context: StageContext, params: Params) -> dict[str, object]:
        """Annotate and evaluate every fold, store the pooled metrics, and print them."""
        report = context.report_file("leave_one_out.json")
        report.unlink(missing_ok=True)
        name = f"leave one {params.column} out"
        folds = _evaluate_folds(context, params, name)
        evaluation = pool_folds(name, folds)
        rows = metrics_rows(evaluation, context.run) if folds else pa.table({})
        with context.writer() as writer:
            writer.put_results("metrics", rows, stage=context.key(), run=context.run)
            writer.commit()
        if not folds:
            context.say(f"nothing to evaluate: {name} has no fold")
            return {"folds": 0}
        annotated = context.params[context.inputs["annotations"]].model_dump(mode="json")
        write_metrics(
            report, evaluation, context.run, pipeline=context.pipeline, column=params.column, annotate=annotated
        )
        context.terminal.show(metrics_table(evaluation, name, SCOPES[:2]))
        context.say(f"metrics, by class and take as well: {report}")
        files = [report.relative_to(context.store_path).as_posix()]
        return {"folds": len(folds), "files": files, **measures(evaluation.pooled)}


def _evaluate_folds(context: StageContext, params: Params, name: str) -> list[tuple[str, Evaluation]]:
    evaluated = context.params_of("evaluation", GroundTruthParameters)
    learned = context.params_of("templates", TemplateParameters)
    annotated = context.params_of("annotations", AnnotationParameters)
    store = context.open()
    takes = annotated_takes(store, context.key(context.inputs["annotations"]))
    if not_labelled(evaluated, takes["source_root"].unique()):
        return []
    if params.column not in takes.columns:
        raise KinedexError(f"takes have no column '{params.column}'{did_you_mean(params.column, takes.columns)}")
    classes = annotated_classes(context, store, context.inputs["annotations"])
    truth = ground_truth(store, evaluated, takes, classes)
    training = takes_to_learn_from(store, learned)
    clips = clips_to_learn_from(store, learned, training)
    folds = _folds(context, params.column, takes, truth, training, clips)
    plain = read_templates(store, context.key(context.inputs["templates"]), annotated.templates)
    templates = _templates(context, folds, plain, annotated, learned)
    setting = Setting(store, annotated, classes, queries_of(store, annotated))
    annotation = store.manifest.stages[context.key(context.inputs["annotations"])]
    if "keyframes" in annotation.summary["inputs"]:
        context.say("learned keyframe queries know the clips that are left out, so the folds do without them")
    results = []
    with context.progress("folds", len(folds)) as progress:
        for fold in folds:
            known = [templates[one.subclass, one.names] for one in fold.clips]
            own = completed(known, learned, store.feature_set, [annotated.templates], where_possible=True)
            results.append((fold.value, _evaluate_fold(context, setting, fold, own, name)))
            progress.advance()
    return results


def _folds(
    context: StageContext,
    column: str,
    takes: pl.DataFrame,
    truth: GroundTruth,
    training: pl.DataFrame,
    clips: Sequence[TrainingClips],
) -> list[Fold]:
    """Make a fold for each value, and say which takes or values make none."""
    with_truth = takes.filter(pl.col("name").is_in(truth.takes))
    nameless = with_truth.filter(pl.col(column).is_null()).height
    if nameless:
        context.say(f"{nameless} takes have no {column} and are in no fold")
    folds = []
    for value in sorted(with_truth[column].drop_nulls().unique().to_list()):
        left_out = set(training.filter(pl.col(column) == value)["name"].to_list())
        remaining = tuple(rest for one in clips if (rest := one.without(left_out)).names)
        if not left_out:
            context.say(f"{value}: no training clip is of {column} {value}, so the fold equals the plain result")
        if clips and not remaining:
            context.say(f"{value}: all training clips are of {column} {value}; there is no fold without them")
            continue
        gone = sorted({one.subclass for one in clips} - {one.subclass for one in remaining})
        if gone:
            context.say(f"{value}: no clips of others, so no template: {', '.join(gone)}")
        own = with_truth.filter(pl.col(column) == value)
        names = set(own["name"].to_list())
        segments = tuple(segment for segment in truth.segments if segment.take in names)
        folds.append(Fold(str(value), own, GroundTruth(segments, tuple(sorted(names))), remaining))
    return folds


def _templates(
    context: StageContext,
    folds: Sequence[Fold],
    plain: Sequence[SubclassTemplate],
    params: AnnotationParameters,
    learned_with: TemplateParameters,
) -> dict[tuple[str, tuple[str, ...]], SubclassTemplate]:
    """Learn each template that any fold needs once; those of all clips are known already. Key: subclass, clips."""
    known = {(one.subclass, one.clips): one for one in plain}
    wanted = {(one.subclass, one.names): one for fold in folds for one in fold.clips}
    missing = [clips for key, clips in wanted.items() if key not in known]
    features = len(context.feature_set.features)
    counts = feature_weights(learned_with.weights, context.feature_set)
    with context.progress("templates", len(missing)) as progress:
        for learned in learn_templates(missing, [params.templates], features, context.executor, counts):
            known |= {(one.subclass, one.clips): one for one in learned}
            progress.advance(len(learned))
    return known


def _evaluate_fold(
    context: StageContext, setting: Setting, fold: Fold, templates: Sequence[SubclassTemplate], name: str
) -> Evaluation:
    store, params = setting.store, setting.params
    usual = None
    if params.method == "best":
        usual = background([words for one in fold.clips for words in one.words], len(store.feature_set.features))
    annotator = make_annotator(
        store.feature_set, templates, setting.classes, params.delta, params.common_tau, setting.queries, usual
    )
    calibration = calibrated(context, store, params, setting.classes, fold.clips)
    annotator = refined(annotator, params, store.rate_hz, calibration.taus)
    batches = annotate_takes(context.store_path, annotator, fold.takes, context.executor, keep_curves=False)
    for remark in (*annotator.remarks, *calibration.remarks):
        context.say(f"{fold.value}: {remark}")
    found = [one for batch in batches for one in batch]
    names = dict(fold.takes.select("take_id", "name").iter_rows())
    table = annotations_table(found, annotator, names, store.rate_hz, context.run)
    return evaluate(name, table, fold.truth, setting.classes.names)
