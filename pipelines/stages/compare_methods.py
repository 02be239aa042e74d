"""Stage compare_methods: compare several annotation methods on splits of the archive, in one report."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import pyarrow as pa

from kinedex.catalog.classes import class_files
from kinedex.catalog.plugins import Plugins
from kinedex.catalog.queries.query_reader import query_file_paths
from kinedex.ops.wording import name_list
from kinedex.pipelines.annotation.methods import METHODS
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.digests import files_digest
from kinedex.pipelines.engine.page_files import drawn_by, write_page
from kinedex.pipelines.engine.stage import Input, Stage
from kinedex.pipelines.evaluation.annotation_scores import Evaluation, measures, metrics_rows
from kinedex.pipelines.evaluation.comparison import Plan, compare_methods, plan_comparison
from kinedex.pipelines.evaluation.comparison_parameters import ComparisonParameters
from kinedex.pipelines.evaluation.comparison_results import Study, evaluation_rows, study_json
from kinedex.pipelines.evaluation.ground_truth import ground_truth_digest
from kinedex.storage.formats.json_text import json_text
from kinedex.storage.store.store import Store

FILES = ("methods.html", "methods.md", "methods.json")

PAGE = "kinedex.reports.methods_page:study_page"
"""The function that draws the page of the stage."""

MARKDOWN, OVERVIEW = "kinedex.reports.comparison_tables:markdown", "kinedex.reports.comparison_tables:overview"
"""The functions that format the comparison as Markdown, and as tables for the terminal."""


class CompareMethods(Stage[ComparisonParameters]):
    """Compares several annotation methods on splits of the archive, in one report."""

    name = "compare_methods"
    parameters = ComparisonParameters
    inputs: ClassVar = {
        "templates": Input("learn_templates"),
        "keyframes": Input("learn_keyframes", optional=True),
        "annotations": Input("annotate", optional=True),
        "evaluation": Input("evaluate", optional=True),
    }

    def external_digest(self, params: ComparisonParameters, store: Store | None) -> str:
        """Return a hash of the class file, the query files and the ground truth."""
        files = [*query_file_paths(params.query_files), *class_files(params.classes)]
        return files_digest(files) + ground_truth_digest(params, store)

    def named_parts(self, params: ComparisonParameters) -> Sequence[tuple[Plugins[Any], str]]:
        """Return the annotation methods."""
        return [(METHODS, name) for name in sorted({one.method for one in params.methods})]

    def run(self, context: StageContext, params: ComparisonParameters) -> dict[str, object]:
        """Compare the methods, store the metrics, and write the report."""
        plan = plan_comparison(context, params)
        study = compare_methods(context, plan)
        _store_metrics(context, plan, study)
        if study is None:
            for name in FILES:
                context.report_file(name).unlink(missing_ok=True)
            return {"splits": 0, "methods": len(plan.params.methods)}
        files = _write(context, params, study)
        context.terminal.show(*drawn_by(OVERVIEW)(study))
        context.message(*study.remarks, *_remarks(study))
        context.message(f"report: {(context.store_path / files[0]).resolve()}")
        first = study.splits[0]
        return {
            "splits": len(study.splits),
            "methods": len(study.methods),
            "folds": sum(len(result.folds) for result in study.splits),
            "leading": first.leading,
            **measures(first.judgements[first.leading].pooled),
            "files": files,
        }


def _remarks(study: Study) -> list[str]:
    """Return the distinct remarks of all splits, each with the names of its splits if there are several splits."""
    found: dict[str, list[str]] = {}
    for result in study.splits:
        for remark in result.remarks:
            found.setdefault(remark, []).append(result.split.name)
    several = len(study.splits) > 1
    return [(f"{name_list(splits)}: " if several else "") + remark for remark, splits in found.items()]


def _store_metrics(context: StageContext, plan: Plan, study: Study | None) -> None:
    """Store the metrics of every split and method.

    Their evaluation is named after split and method, or after the split alone if the only method is that of a stage
    `annotate`.
    """
    tables = [
        metrics_rows(
            Evaluation(
                result.split.name if plan.annotated is not None else f"{result.split.name}: {name}",
                evaluation_rows(judged, result.folds),
            ),
            context.run,
        )
        for result in (study.splits if study is not None else ())
        for name, judged in result.judgements.items()
    ]
    context.put_results(metrics=pa.concat_tables(tables) if tables else pa.table({}))


def _write(context: StageContext, params: ComparisonParameters, study: Study) -> list[str]:
    """Write the page of a comparison, its summary and its JSON file, and return their paths within the store."""
    page = drawn_by(PAGE)(context.open(), study, params.embed, context.stage, context.progress)
    as_json = json_text(study_json(study))
    files = []
    for name, text in zip(FILES, (page, drawn_by(MARKDOWN)(study), as_json), strict=True):
        path = context.report_file(name)
        write_page(text, path)
        files.append(path.relative_to(context.store_path).as_posix())
    return files
