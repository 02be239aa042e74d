"""What a comparison of methods needs before it can annotate: templates, queries and thresholds of every fold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from kinedex.catalog.classes import Classes
from kinedex.catalog.queries.keyframe_query import KeyframeQuery
from kinedex.ops.annotation.decoding import background
from kinedex.ops.templates.templates import Kind
from kinedex.pipelines.annotation.annotators import make_annotator, targets_unknown
from kinedex.pipelines.annotation.parameters import AnnotationParameters
from kinedex.pipelines.annotation.preparation import calibrated, queries_of, refined, without_effect
from kinedex.pipelines.console.wording import few
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.evaluation.grid import Cell, cell_key
from kinedex.pipelines.evaluation.queries import QueryLearner
from kinedex.pipelines.evaluation.scheme import Method
from kinedex.pipelines.evaluation.test_takes import Fold
from kinedex.pipelines.templates.learning import SubclassTemplate, learn_templates
from kinedex.pipelines.templates.recipes import feature_weights
from kinedex.pipelines.templates.training import TemplateParameters, completed
from kinedex.storage.store.store import Store


@dataclass(frozen=True)
class Known:
    """What folds share. templates: by subclass, clips and kind. queries: by fold, those that are learned."""

    store: Store
    classes: Classes
    learned_with: TemplateParameters
    templates: dict[tuple[str, tuple[str, ...], Kind], SubclassTemplate]
    learned_queries: QueryLearner | None


def with_templates(context: StageContext, methods: Sequence[Method], known: Known, folds: Sequence[Fold]) -> Known:
    """Learn each template that any fold needs once; and the queries, where they are learned."""
    kinds = list(dict.fromkeys(method.templates for method in methods))
    wanted = {(one.subclass, one.names): one for fold in folds for one in fold.clips}
    features = len(context.feature_set.features)
    counts = feature_weights(known.learned_with.weights, context.feature_set)
    templates = dict(known.templates)
    with context.progress("templates", len(wanted) * len(kinds)) as progress:
        for some in learn_templates(list(wanted.values()), kinds, features, context.executor, counts):
            templates |= {(one.subclass, one.clips, one.kind): one for one in some}
            progress.advance(len(some))
    if known.learned_queries is not None:
        known.learned_queries.learn(folds)
    return replace(known, templates=templates)


def said_of(methods: Sequence[Method], known: Known) -> list[str]:
    """What is to be known of methods: queries for none of the classes, and parameters without effect, in words."""
    remarks = []
    for method in methods:
        unknown = targets_unknown(_queries(known.store, method), known.classes)
        if unknown:
            remarks.append(f"{method.name}: keyframe queries for other classes, left out: {few(unknown)}")
        remarks += [f"{method.name}: {remark}" for remark in without_effect(_params(method))]
    return remarks


def _queries(store: Store, method: Method) -> list[KeyframeQuery]:
    return queries_of(store, _params(method))


def _params(method: Method) -> AnnotationParameters:
    """The parameters of the stage `annotate` that mean the same method."""
    return AnnotationParameters.model_validate(method.model_dump(exclude={"name"}) | {"queries": method.query_files})


def make_cell(context: StageContext, known: Known, fold: Fold, method: Method) -> Cell:
    """A method in a fold, with all that annotates its takes."""
    own = [known.templates[one.subclass, one.names, method.templates] for one in fold.clips]
    feature_set = known.store.feature_set
    templates = completed(own, known.learned_with, feature_set, [method.templates], where_possible=True)
    if method.learned_queries:
        assert known.learned_queries is not None
        queries: Sequence[KeyframeQuery] = known.learned_queries.queries(fold)
    else:
        queries = _queries(known.store, method)
    usual = None
    if method.method == "best":
        usual = background([words for one in fold.clips for words in one.words], len(feature_set.features))
    params = _params(method)
    annotator = make_annotator(feature_set, templates, known.classes, method.delta, params.common_tau, queries, usual)
    calibration = calibrated(context, known.store, params, known.classes, fold.clips)
    annotator = refined(annotator, params, known.store.rate_hz, calibration.taus)
    remarks = (*annotator.remarks, *calibration.remarks)
    return Cell(cell_key(fold, annotator, known.store), fold, method, annotator, remarks)
