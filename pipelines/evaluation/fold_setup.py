"""Prepare a comparison of methods: learn templates and queries, and calibrate thresholds, for every fold."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

from kinedex.catalog.classes import Classes, load_classes
from kinedex.catalog.queries.keyframe_query import KeyframeQuery
from kinedex.ops.errors import KinedexError
from kinedex.ops.templates.templates import Kind
from kinedex.ops.wording import name_list
from kinedex.ops.words import ALL_KNOWN
from kinedex.pipelines.annotation.annotation_setup import Preparation, queries_of, template_learner
from kinedex.pipelines.annotation.annotators import unknown_targets
from kinedex.pipelines.annotation.material import clip_examples
from kinedex.pipelines.annotation.methods import Material, Motion, Motions, Needs
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.evaluation.comparison_cells import Cell, cell_key
from kinedex.pipelines.evaluation.comparison_parameters import Method
from kinedex.pipelines.evaluation.folds import Fold
from kinedex.pipelines.keyframes.learning_runs import ClassRuns, StoredRuns, known_runs, learn_queries
from kinedex.pipelines.keyframes.parameters import KeyframeParameters, setting_of
from kinedex.pipelines.keyframes.query_learning import Outcome, TrainingSet, every_query, training_sets
from kinedex.pipelines.templates.template_learning import SubclassTemplate, learn_templates
from kinedex.pipelines.templates.training import TemplateParameters, feature_weights, with_given_templates
from kinedex.storage.store.store import Store


class QueryLearner:
    """Learns the queries of folds as the stage `learn_keyframes` does.

    Learning runs that were finished earlier are reused, including those of the stage. The store keeps a run as long as
    a fold has the same clips, whatever the settings are. The parameters' filter of takes is not used, because each fold
    has its own clips.
    """

    def __init__(self, context: StageContext, params: KeyframeParameters) -> None:
        self._context = context
        self._params = params
        self._outcomes: dict[tuple[str, str], list[Outcome]] = {}

    def learn(self, folds: Sequence[Fold]) -> None:
        """Learn the queries of all folds; finished learning runs are stored at intervals."""
        context, params = self._context, self._params
        store = context.open()
        setting, rounds = setting_of(params, store), params.rounds()
        wanted = [self._trainings(fold) for fold in folds]
        kept = StoredRuns(context, [training for own in wanted for training in own])
        others = known_runs(store.result("keyframe_runs", pipeline=context.pipeline))
        finished: list[ClassRuns] = []
        with context.progress("runs", rounds.runs * sum(map(len, wanted))) as progress:
            for fold, own in zip(folds, wanted, strict=True):
                known = [*others, *kept.known()]  # including those of the folds before
                classes = learn_queries(own, setting, rounds, context.executor, known, kept.save, progress.advance)
                finished += classes
                self._outcomes[fold.split, fold.name] = [one.outcome for one in classes]
        kept.save(finished)

    def _trainings(self, fold: Fold) -> list[TrainingSet]:
        """Return the training sets of a fold; raise a KinedexError if a class has no negative clip."""
        names = [one.subclass for one in fold.clips]
        wanted = training_sets(fold.clips, load_classes(self._params.classes, names))
        bare = [one.subclass for one in wanted if not one.negatives]
        if bare:
            raise KinedexError(
                f"split '{fold.split}', {fold.name}: no training clip is of another class than {bare[0]}, so "
                "there is nothing to tell it from"
            )
        return wanted

    def queries(self, fold: Fold) -> list[KeyframeQuery]:
        """Return the learned queries of a fold."""
        feature_set = self._context.feature_set
        return every_query(self._outcomes[fold.split, fold.name], feature_set)


@dataclass(frozen=True)
class StudyMaterial:
    """The data and parameters that the folds of all splits share.

    Attributes
    ----------
    store : Store
        The store.
    classes : Classes
        The classes to label with.
    learned_with : TemplateParameters
        The parameters that templates are learned with, except the filter of takes.
    templates : dict
        The learned templates by subclass, clips and kind.
    learned_queries : QueryLearner, optional
        Learns the queries of each fold, if any method uses learned queries.
    unlabelled : callable
        Returns the takes of the store with what a method needs, which all folds share.
    """

    store: Store
    classes: Classes
    learned_with: TemplateParameters
    templates: dict[tuple[str, tuple[str, ...], Kind], SubclassTemplate]
    learned_queries: QueryLearner | None
    unlabelled: Callable[[Needs], Motions[Motion]]


def with_templates(
    context: StageContext, methods: Sequence[Method], known: StudyMaterial, folds: Sequence[Fold]
) -> StudyMaterial:
    """Learn each template that folds need once, and the queries if a method uses learned ones."""
    kinds = list(dict.fromkeys(method.templates for method in methods if method.uses_templates))
    wanted = {(one.subclass, one.names): one for fold in folds for one in fold.clips}
    features = len(context.feature_set.features)
    weights = feature_weights(known.learned_with.weights, context.feature_set)
    templates = dict(known.templates)
    with context.progress("templates", len(wanted) * len(kinds)) as progress:
        for some in learn_templates(list(wanted.values()), kinds, features, context.executor, weights) if kinds else ():
            templates |= {(one.subclass, one.clips, one.kind): one for one in some}
            progress.advance(len(some))
    if known.learned_queries is not None:
        known.learned_queries.learn(folds)
    return replace(known, templates=templates)


def method_remarks(methods: Sequence[Method], known: StudyMaterial) -> list[str]:
    """Return remarks on queries whose target is none of the classes, and on parameters without effect."""
    remarks = []
    for method in methods:
        unknown = unknown_targets(queries_of(known.store, method), known.classes)
        if unknown:
            remarks.append(f"{method.name}: keyframe queries for other classes, excluded: {name_list(unknown)}")
        remarks += [f"{method.name}: {remark}" for remark in method.without_effect()]
    return remarks


def make_cell(context: StageContext, known: StudyMaterial, fold: Fold, method: Method) -> Cell:
    """Make the cell of a method in a fold, with an annotator for its takes."""
    store = known.store
    templates = _templates_of(known, fold, method) if method.uses_templates else []
    if method.learned_queries:
        assert known.learned_queries is not None
        queries: Sequence[KeyframeQuery] = known.learned_queries.queries(fold)
    else:
        queries = queries_of(store, method)
    prepared = Preparation(store, method, known.classes, queries)
    learn = template_learner(store, method, known.learned_with, context.executor)
    calibration = prepared.thresholds(lambda: fold.clips, learn, context.executor)
    needs = method.annotation_method.needs
    weights = feature_weights(known.learned_with.weights, store.feature_set)
    material = Material(
        Motions(partial(clip_examples, store, fold.clips, (), needs)), known.unlabelled(needs), store.rate_hz, weights,
        known.learned_with.mirror,
    )  # fmt: skip
    annotator = prepared.annotator(templates, material, calibration)
    masks = dict(enumerate(mask for one in fold.test_takes if (mask := one.known(store.known)) != ALL_KNOWN))
    remarks = (*annotator.remarks, *calibration.remarks, *annotator.remarks_on(masks))
    return Cell(cell_key(fold, annotator, store), fold, method, annotator, remarks)


def _templates_of(known: StudyMaterial, fold: Fold, method: Method) -> list[SubclassTemplate]:
    """Return the templates of a fold, learned ones and those of files and combinations."""
    own = [known.templates[one.subclass, one.names, method.templates] for one in fold.clips]
    kinds = [method.templates]
    return with_given_templates(own, known.learned_with, known.store.feature_set, kinds, where_possible=True)
