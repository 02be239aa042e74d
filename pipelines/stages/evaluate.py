"""Stage evaluate: the annotations against ground truth, on the level of frames and of segments."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import polars as pl
import pyarrow as pa
from pydantic import BaseModel, ConfigDict, Field

from kinedex.catalog.classes import Classes
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.annotation.tables import annotated_takes
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.digests import files_digest
from kinedex.pipelines.evaluation.annotation_scores import (
    SCOPES,
    evaluate,
    measures,
    metrics_rows,
    metrics_table,
    write_metrics,
)
from kinedex.pipelines.evaluation.ground_truth import (
    GroundTruth,
    UnknownLabels,
    ground_truth_of_classes,
    ground_truth_rows,
    place_ground_truth,
)
from kinedex.pipelines.stages import annotate
from kinedex.pipelines.templates.learning import read_templates, run_of
from kinedex.storage.formats.labels.ground_truth import any_ground_truth, ground_truth_files, read_ground_truth
from kinedex.storage.store.store import Store

NONE, OWN_CLASS = "none", "class"
SET_IT = "`--set evaluate.ground_truth=PATTERN` names label files"
MOST_TAKES_SHOWN = 20
"""With more takes the table on the terminal leaves out the line per take."""


class Params(BaseModel):
    """What the stage `evaluate` takes."""

    model_config = ConfigDict(extra="forbid")

    ground_truth: str = Field(
        "**/ground_truth.csv",
        description="label files, read as their ending says: .csv (take, class, start, stop in source frames), .json, "
        ".eaf (ELAN), .vtt (WebVTT), .txt (Audacity); a glob below the takes' source folders, or an absolute path; "
        "'class': each take's own class for all of it; 'none': there is none. Where none is given and this one finds "
        "no file, nothing is evaluated, and that is said",
    )
    source: str | None = Field(
        None, description="the folder that ground_truth is relative to; by default the takes' source folders"
    )
    unknown_labels: UnknownLabels = Field(
        "error",
        description="a label that is neither a class nor a subclass: 'error'; 'miss' counts it as not found; 'ignore' "
        "leaves it out, and says so",
    )


def external_digest(params: Params, store: Store | None) -> str:
    """What the stage depends on outside the store: the text of the ground truth.

    Where there is none to be read, the stage runs, and says so.
    """
    if params.ground_truth in (NONE, OWN_CLASS):
        return ""
    known: set[str] = set(store.takes()["source_root"]) if store else set()
    roots = sorted(root for root in known if Path(root).is_dir())
    try:
        if not_labelled(params, roots):
            return "nobody's labels"
        return files_digest(truth_files(params, roots))
    except KinedexError:
        return "none to be read"


def run(context: StageContext, params: Params) -> dict[str, object]:
    """Evaluate, store the metrics, and print them."""
    report = context.report_file("metrics.json")
    store = context.open()
    takes = annotated_takes(store, context.key(context.inputs["annotations"]))
    if not_labelled(params, takes["source_root"].unique()):
        report.unlink(missing_ok=True)
        with context.writer() as writer:
            for kind in ("metrics", "ground_truth"):
                writer.put_results(kind, pa.table({}), stage=context.key(), run=context.run)
            writer.commit()
        named = params.ground_truth == NONE
        context.say(
            "no ground truth, nothing to evaluate"
            + ("" if named else f": the source has no file '{params.ground_truth}'; {SET_IT}")
        )
        return {"evaluated_takes": 0}
    annotated = annotate_params(context)
    classes = classes_of(context, store)
    truth = ground_truth(store, params, takes, classes)
    annotations = store.result("annotations", run=run_of(store, context.key(context.inputs["annotations"])))
    evaluation = evaluate("annotate", annotations, truth, classes.names)
    with context.writer() as writer:
        writer.put_results("metrics", metrics_rows(evaluation, context.run), stage=context.key(), run=context.run)
        writer.put_results("ground_truth", ground_truth_rows(truth, context.run), stage=context.key(), run=context.run)
        writer.commit()
    annotation = store.manifest.stages[context.key(context.inputs["annotations"])]
    remarks = [*annotation.summary.get("remarks", ()), *truth.remarks]
    about = {"pipeline": context.pipeline, "annotate": annotated.model_dump(mode="json"), "remarks": remarks}
    write_metrics(report, evaluation, context.run, **about)
    for remark in truth.remarks:
        context.say(remark)
    few = len(truth.takes) <= MOST_TAKES_SHOWN
    scopes = SCOPES if few else SCOPES[:-1]
    context.terminal.show(metrics_table(evaluation, f"{len(truth.takes)} takes against ground truth", scopes))
    context.say(f"metrics{'' if few else ', take by take as well'}: {report}")
    counts = evaluation.pooled
    return {
        "evaluated_takes": len(truth.takes),
        "segments": len(truth.segments),
        "files": [report.relative_to(context.store_path).as_posix()],
        **measures(counts),
    }


def not_labelled(params: Params, roots: Iterable[str]) -> bool:
    """Whether takes have no ground truth: it is said so, or none is given and no file is called as it usually is.

    Parameters
    ----------
    roots: the source folders of the takes.
    """
    if params.ground_truth == NONE:
        return True
    if "ground_truth" in params.model_fields_set or params.ground_truth == OWN_CLASS:
        return False
    return not any_ground_truth(params.ground_truth, _roots(params, roots))


def annotate_params(context: StageContext) -> annotate.Params:
    """The parameters of the stage whose annotations are evaluated."""
    params = context.params[context.inputs["annotations"]]
    assert isinstance(params, annotate.Params)
    return params


def classes_of(context: StageContext, store: Store) -> Classes:
    """The classes that the annotations were made with."""
    params = annotate_params(context)
    record = store.manifest.stages[context.key(context.inputs["annotations"])]
    templates = read_templates(store, context.key(record.summary["inputs"]["templates"]), params.templates)
    return annotate.classes_of(store, params, templates)


def ground_truth(store: Store, params: Params, takes: pl.DataFrame, classes: Classes) -> GroundTruth:
    """Find and place the ground truth of these takes."""
    if params.ground_truth == OWN_CLASS:
        return ground_truth_of_classes(takes, classes)
    files = truth_files(params, takes["source_root"].unique())
    return place_ground_truth(
        list(map(read_ground_truth, files)), takes, store.takes()["name"], classes, params.unknown_labels
    )


def truth_files(params: Params, roots: Iterable[str]) -> list[Path]:
    """The label files, below `source` or else below the source folders of takes."""
    return ground_truth_files(params.ground_truth, _roots(params, roots))


def _roots(params: Params, roots: Iterable[str]) -> Sequence[str]:
    return [params.source] if params.source else sorted(roots)
