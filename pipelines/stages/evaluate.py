"""Stage evaluate: compare annotations with ground truth, by frames and by segments."""

from __future__ import annotations

from typing import ClassVar

import pyarrow as pa

from kinedex.ops.wording import counted
from kinedex.pipelines.annotation.annotation_setup import annotated_classes
from kinedex.pipelines.annotation.annotation_tables import annotated_takes
from kinedex.pipelines.annotation.parameters import AnnotationParameters
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.stage import Input, Stage
from kinedex.pipelines.evaluation.annotation_scores import (
    SCOPES,
    evaluate,
    measures,
    metrics_rows,
    metrics_table,
    write_metrics,
)
from kinedex.pipelines.evaluation.ground_truth import (
    NONE,
    GroundTruthParameters,
    ground_truth,
    ground_truth_digest,
    ground_truth_rows,
    not_labelled,
    with_own_classes,
)
from kinedex.pipelines.templates.template_learning import run_of
from kinedex.storage.store.store import Store

SET_IT = "`--set evaluate.ground_truth=PATTERN` names label files"
MAX_TAKES_SHOWN = 20
"""The largest number of takes for which the table on the terminal has a row per take."""


class Evaluate(Stage[GroundTruthParameters]):
    """Compares annotations with ground truth, by frames and by segments."""

    name = "evaluate"
    parameters = GroundTruthParameters
    inputs: ClassVar = {"annotations": Input("annotate")}

    def external_digest(self, params: GroundTruthParameters, store: Store | None) -> str:
        """Return a hash of the label files."""
        return ground_truth_digest(params, store)

    def run(self, context: StageContext, params: GroundTruthParameters) -> dict[str, object]:
        """Evaluate, store the metrics, and show them."""
        report = context.report_file("metrics.json")
        store = context.open()
        takes = annotated_takes(store, context.key(context.inputs["annotations"]))
        given, params = params, with_own_classes(params, takes)
        if not_labelled(params, takes["source_root"].unique()):
            report.unlink(missing_ok=True)
            context.put_results(metrics=pa.table({}), ground_truth=pa.table({}))
            named = params.ground_truth == NONE
            context.message(
                "no ground truth, nothing to evaluate"
                + ("" if named else f": the source has no file '{params.ground_truth}'; {SET_IT}")
            )
            return {"evaluated_takes": 0}
        annotated = context.params_of("annotations", AnnotationParameters)
        classes = annotated_classes(store, annotated, context.key(context.inputs["annotations"]))
        if params is not given:
            context.message(
                f"the source has no label file '{given.ground_truth}': each take's own class is its ground truth"
            )
        truth = ground_truth(store, params, takes, classes)
        annotations = store.result("annotations", run=run_of(store, context.key(context.inputs["annotations"])))
        evaluation = evaluate("annotate", annotations, truth, classes.names)
        context.put_results(
            metrics=metrics_rows(evaluation, context.run), ground_truth=ground_truth_rows(truth, context.run)
        )
        annotation = store.manifest.stages[context.key(context.inputs["annotations"])]
        remarks = [*annotation.summary.get("remarks", ()), *truth.remarks]
        about = {"pipeline": context.pipeline, "annotate": annotated.model_dump(mode="json"), "remarks": remarks}
        write_metrics(report, evaluation, context.run, **about)
        context.report_unmatched(truth.unmatched)
        context.message(*truth.remarks)
        few = len(truth.takes) <= MAX_TAKES_SHOWN
        scopes = SCOPES if few else SCOPES[:-1]
        context.terminal.show(
            metrics_table(evaluation, f"{counted(len(truth.takes), 'take')} against ground truth", scopes)
        )
        context.message(f"metrics{'' if few else ', take by take as well'}: {report}")
        counts = evaluation.pooled
        return {
            "evaluated_takes": len(truth.takes),
            "segments": len(truth.segments),
            "files": [report.relative_to(context.store_path).as_posix()],
            **measures(counts),
        }
