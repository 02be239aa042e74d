"""Compare annotation methods: make the folds of all splits, compute every method in every fold, and score methods."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial

import polars as pl

from kinedex.catalog.classes import OWN, Classes, load_classes
from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.evaluation.metrics import pooled
from kinedex.ops.wording import name_list
from kinedex.pipelines.annotation.annotation_tables import annotated_takes
from kinedex.pipelines.annotation.material import unlabelled_takes
from kinedex.pipelines.annotation.methods import Motions
from kinedex.pipelines.annotation.parameters import AnnotationParameters, MethodParameters
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.evaluation.comparison_cells import (
    Cell,
    SegmentsByTake,
    cells_table,
    known_cells,
    remarks_of,
    run_cells,
)
from kinedex.pipelines.evaluation.comparison_parameters import ComparisonParameters, Method, Split
from kinedex.pipelines.evaluation.comparison_results import SplitResult, Study, Threshold
from kinedex.pipelines.evaluation.fold_setup import (
    QueryLearner,
    StudyMaterial,
    make_cell,
    method_remarks,
    with_templates,
)
from kinedex.pipelines.evaluation.folds import Fold, Material, NoFoldsError, make_folds
from kinedex.pipelines.evaluation.ground_truth import (
    NONE,
    GroundTruth,
    GroundTruthParameters,
    ground_truth,
    not_labelled,
    with_own_classes,
)
from kinedex.pipelines.evaluation.method_scores import MethodScores, counts_of, score_method, segment_outcomes
from kinedex.pipelines.keyframes.parameters import KeyframeParameters
from kinedex.pipelines.templates.training import TemplateParameters, templates_of_files, training_material
from kinedex.storage.snapshot.manifest import now
from kinedex.storage.store.store import Store

WITHOUT_LEARNED = (
    "learned keyframe queries know the clips of all folds, so the folds do without them; `queries: learned` of a "
    "method learns them in each fold"
)


@dataclass(frozen=True)
class Plan:
    """The parameters of a comparison, completed by those of the other stages of its pipeline.

    Attributes
    ----------
    params : ComparisonParameters
        The parameters, with at least one method and without repeated methods.
    truth : GroundTruthParameters
        The parameters that select ground truth: `params` if it sets any of them, else those of the stage evaluate.
    annotated : str, optional
        The stage `annotate` whose method is repeated, "<pipeline>/<stage>".
    remarks : tuple of str
        Remarks on methods that equal an earlier one, and on queries that are not used.
    """

    params: ComparisonParameters
    truth: GroundTruthParameters
    annotated: str | None = None
    remarks: tuple[str, ...] = ()

    def tested(self, store: Store, split: Split) -> pl.DataFrame:
        """Return the takes of a split that are to be annotated."""
        if self.annotated is not None and "test" not in split.model_fields_set:
            return annotated_takes(store, self.annotated)
        return store.takes(split.test)


def plan_comparison(context: StageContext, params: ComparisonParameters) -> Plan:
    """Complete the parameters of a comparison by those of its input stages.

    Raises
    ------
    KinedexError
        There is no method, and no stage `annotate` whose method could be repeated.
    """
    own = {"ground_truth", "source", "unknown_labels"} & params.model_fields_set
    truth: GroundTruthParameters = params
    if not own and "evaluation" in context.inputs:
        truth = context.params_of("evaluation", GroundTruthParameters)
    if params.methods:
        same = [method.name for method in params.methods if method not in params.distinct]
        remarks = (f"the same as an earlier method, excluded: {name_list(same)}",) if same else ()
        return Plan(params.model_copy(update={"methods": params.distinct}), truth, None, remarks)
    if "annotations" not in context.inputs:
        raise KinedexError("compare_methods needs `methods`, or a stage annotate whose method it repeats")
    stage = context.inputs["annotations"]
    annotate = context.params_of("annotations", AnnotationParameters)
    method = Method(name=stage, **{name: getattr(annotate, name) for name in MethodParameters.model_fields})
    where = context.params_of("templates", TemplateParameters).where
    splits = [
        split if "train" in split.model_fields_set else split.model_copy(update={"train": where})
        for split in params.splits
    ]
    updates: dict[str, object] = {"methods": [method], "splits": splits}
    if "classes" not in params.model_fields_set:
        updates["classes"] = annotate.classes
    record = context.open().manifest.stages.get(context.key(stage))
    remarks = () if record is None or "keyframes" not in record.summary["inputs"] else (WITHOUT_LEARNED,)
    return Plan(params.model_copy(update=updates), truth, context.key(stage), remarks)


def compare_methods(context: StageContext, plan: Plan) -> Study | None:
    """Compute every method in every fold where the store lacks the result, and score all methods.

    Parameters
    ----------
    context : StageContext
        The store, the executor and the display.
    plan : Plan
        The plan of the comparison.

    Returns
    -------
    Study, optional
        The comparison. None, after a message for each split, if the only method is that of a stage `annotate`, and no
        split has both ground truth and a fold.

    Raises
    ------
    KinedexError
        The methods were given as parameters, and a split has no ground truth or no fold; or parameters do not fit the
        store.
    """
    store, params = context.open(), plan.params
    known = _known(context, params, store)
    folds: dict[str, list[Fold]] = {}
    for split in params.splits:
        try:
            folds[split.name] = _folds(context, plan, split, known)
        except NoFoldsError as fault:
            if plan.annotated is None:
                raise
            context.message(f"nothing to compare: {fault}")
    if not folds:
        return None
    known = with_templates(context, params.methods, known, [fold for some in folds.values() for fold in some])
    variants = [*params.methods, *_swept(params)]
    cells = {
        (fold.split, fold.name, method.name): make_cell(context, known, fold, method)
        for some in folds.values()
        for fold in some
        for method in variants
    }
    found = _run(context, list(cells.values()))
    return Study(
        title=params.title,
        pipeline=context.pipeline,
        run=context.run,
        created=now(),
        store=str(context.store_path),
        archive=", ".join(sorted(store.takes()["source_root"].unique())),
        rate_hz=store.rate_hz,
        classes=known.classes.names,
        descriptions={one.name: one.description for one in known.classes.classes},
        group=params.divide_by,
        metrics=tuple(params.metrics),
        methods=tuple(params.methods),
        splits=tuple(
            _result(params, split, folds[split.name], cells, found, known.classes)
            for split in params.splits
            if split.name in folds
        ),
        remarks=(*plan.remarks, *method_remarks(params.methods, known)),
        class_of=known.classes.of_subclass(),
    )


def _known(context: StageContext, params: ComparisonParameters, store: Store) -> StudyMaterial:
    """Return the classes, and the parameters with which templates and queries are learned."""
    learned_with = context.params_of("templates", TemplateParameters)
    labelled = set(store.takes()["class"].drop_nulls().unique())
    made = set(learned_with.combine) | set(learned_with.mirror.values())
    made |= {one.name for _, one in templates_of_files(learned_with.template_files, store.feature_set)}
    for split in params.splits:
        made |= set(store.takes(split.train)["class"].drop_nulls().unique())
    classes = load_classes(params.classes, made if params.classes == OWN else made | labelled)
    learner = None
    if any(method.learned_queries for method in params.methods):
        if "keyframes" not in context.inputs:
            names = name_list([method.name for method in params.methods if method.learned_queries])
            raise KinedexError(f"queries of {names} are to be learned, so the pipeline needs a stage 'learn_keyframes'")
        learner = QueryLearner(context, context.params_of("keyframes", KeyframeParameters))
    unlabelled = cache(lambda needs: Motions(partial(unlabelled_takes, store, needs)))
    return StudyMaterial(store, classes, learned_with, {}, learner, unlabelled)


def _folds(context: StageContext, plan: Plan, split: Split, known: StudyMaterial) -> list[Fold]:
    """Return the folds of a split."""
    store, group = known.store, plan.params.divide_by
    material = training_material(store, known.learned_with.model_copy(update={"where": split.train}))
    tested = plan.tested(store, split)
    if group not in tested.columns:
        raise KinedexError(f"divide_by: takes have no column '{group}'{did_you_mean(group, tested.columns)}")
    truth = plan.truth
    if plan.annotated is not None:
        truth = with_own_classes(truth, tested)
    labels_needed = plan.annotated is not None and not split.clips_as_takes
    if labels_needed and not_labelled(truth, tested["source_root"].unique()):
        raise NoFoldsError(f"split '{split.name}': no take to annotate has ground truth")

    def place(takes: pl.DataFrame) -> GroundTruth:
        if truth.ground_truth == NONE:
            raise KinedexError(
                f"split '{split.name}' has takes of its own, whose ground_truth must be given, not 'none'"
            )
        found = ground_truth(store, truth, takes, known.classes)
        context.report_unmatched(found.unmatched)
        return found

    return make_folds(split, Material(material.takes, tuple(material.clips), tested, known.classes, place, group))


def _swept(params: ComparisonParameters) -> list[Method]:
    """Return the methods that use thresholds at each threshold of the sweep, once for methods that differ only in τ."""
    curves = {method.curve_name: method for method in params.methods if method.annotation_method.needs.thresholds}
    return [method.at(tau) for method in curves.values() for tau in params.taus]


def _run(context: StageContext, cells: Sequence[Cell]) -> dict[str, SegmentsByTake]:
    """Compute and store the cells that the store lacks, and return the segments of all cells."""
    store = context.open()
    known = known_cells(store.result("method_cells", pipeline=context.pipeline))
    distinct = list({cell.key: cell for cell in cells}.values())

    def save(found: Mapping[str, SegmentsByTake]) -> None:
        context.put_results(method_cells=cells_table(cells, found, context.run))

    already = sum(cell.key in known for cell in distinct)
    if already:
        context.message(f"{already} of {len(distinct)} cells are known")
    with context.progress("cells", len(distinct)) as progress:
        found = run_cells(distinct, store, context.executor, known, save, progress.advance)
    save(found)
    return found


def _result(
    params: ComparisonParameters,
    split: Split,
    folds: Sequence[Fold],
    cells: Mapping[tuple[str, str, str], Cell],
    found: Mapping[str, SegmentsByTake],
    classes: Classes,
) -> SplitResult:
    """Return the scores of all methods in a split."""

    def outcome(method: Method) -> SegmentsByTake:
        keys = [cells[split.name, fold.name, method.name].key for fold in folds]
        return {name: segments for key in keys for name, segments in found[key].items()}

    test_takes = [test_take for fold in folds for test_take in fold.test_takes]
    outcomes = {method.name: outcome(method) for method in params.methods}
    judged: dict[str, MethodScores] = {
        name: score_method(one, test_takes, classes.names) for name, one in outcomes.items()
    }
    sweep = [
        Threshold(
            method.curve_name, float(method.tau), pooled(counts_of(outcome(method), test_takes, classes.names).values())
        )
        for method in _swept(params)
    ]
    used = [cells[split.name, fold.name, method.name] for fold in folds for method in params.methods]
    labelled = {one.annotator.classes[index] for one in used for index in one.annotator.class_index.tolist()}
    lacking = sorted({one.label for take in test_takes for one in take.truth} - labelled)
    notes = [f"without a template, so their segments cannot be found: {name_list(lacking)}"] if lacking else []
    notes += remarks_of(used)
    met = tuple(segment_outcomes(outcomes, test_takes))
    return SplitResult(split, tuple(folds), dict(outcomes), judged, tuple(sweep), met, tuple(notes))
