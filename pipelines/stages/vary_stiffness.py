"""Stage vary_stiffness: compute precision and recall along each class's ranking for several query stiffnesses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, ClassVar

from pydantic import Field

from kinedex.catalog.queries.query_reader import query_file_paths, read_query_files
from kinedex.ops.errors import KinedexError
from kinedex.ops.templates.templates import Kind, NamedTemplate
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.digests import files_digest
from kinedex.pipelines.engine.display import ResultTable
from kinedex.pipelines.engine.file_parameters import StageParameters
from kinedex.pipelines.engine.stage import Input, Stage
from kinedex.pipelines.templates.ranking_evaluation import (
    WRITTEN,
    Trial,
    mean_average_precision,
    names_filter,
    read_truth,
    run_trials,
    trial_rows,
)
from kinedex.pipelines.templates.store_ranking import ranked_templates
from kinedex.pipelines.templates.template_learning import read_templates
from kinedex.storage.formats.labels.formats import ground_truth_files
from kinedex.storage.store.store import Store


class Params(StageParameters):
    """The parameters of the stage `vary_stiffness`."""

    ground_truth: str = Field("**/ground_truth.csv", description="as in `evaluate_ranking`")
    where: str = Field("class IS NULL", description="takes to rank: a SQL filter over the columns of takes")
    templates: Kind = Field("soft", description="which of the learned templates: soft or hard")
    delta: float = Field(0.1, ge=0, lt=0.5, description="template values within delta of 0 or 1 count")
    tau: float = Field(0.1, gt=0, le=1, description="recall is reported at this threshold")
    queries: list[str] = Field([], description="keyframe queries: files, by names or paths; without any, all frames")
    stiffness: list[Annotated[float, Field(ge=0, le=1)]] = Field(
        [1.0, 0.8, 0.6, 0.4, 0.2, 0.0], description="stiffnesses that all gaps of all queries get, one after the other"
    )


class VaryStiffness(Stage[Params]):
    """Computes precision and recall along the ranking of each class, for several stiffnesses of the queries."""

    name = "vary_stiffness"
    parameters = Params
    inputs: ClassVar = {"templates": Input("learn_templates")}

    def external_digest(self, params: Params, store: Store | None) -> str:
        """Return a hash of the query files and of the ground truth."""
        files = query_file_paths(params.queries)
        if store is not None:
            try:
                files += ground_truth_files(params.ground_truth, sorted(store.takes()["source_root"].unique()))
            except KinedexError:
                return "none to be read"
        return files_digest(files)

    def run(self, context: StageContext, params: Params) -> dict[str, object]:
        """Rank with every variant of the queries, show a row for each, and store precision and recall."""
        store = context.open()
        learned = read_templates(store, context.key(context.inputs["templates"]), params.templates)
        queries = read_query_files(params.queries, store.feature_set, store.rate_hz)
        searched, _ = ranked_templates(
            [NamedTemplate(one.subclass, one.learned.template) for one in learned], params.delta, queries
        )
        truth = read_truth(store, params.ground_truth, params.where, [one.subclass for one in learned])
        context.report_unmatched(truth.unmatched)
        takes = f"({params.where}) AND {names_filter(truth.takes)}"
        trials = run_trials(
            store, searched, truth.segments, takes, params.stiffness, params.tau, context.executor.workers,
            context.progress,
        )  # fmt: skip
        context.terminal.show(_shown(trials))
        context.put_results(precision_recall=trial_rows(trials, context.run))
        return {"trials": len(trials), "tau": params.tau, "delta": params.delta, "queried": len(trials) > len(searched)}


def _shown(trials: Sequence[Trial]) -> ResultTable:
    """Return a table with a row for each variant of the queries.

    All rows refer to the same classes, as on the page: to those with queries, or to all classes if none has a query.
    """
    asked = {trial.judged.label for trial in trials if trial.variant == WRITTEN}
    columns = ("gaps", "classes", "kept", "to find", "found below τ", "at any rank", "mean AP")
    table = ResultTable(columns, title="rankings by stiffness of the queries")
    for variant in dict.fromkeys(trial.variant for trial in trials):
        own = [trial for trial in trials if trial.variant == variant and (not asked or trial.judged.label in asked)]
        total = sum(trial.judged.total for trial in own)
        found = sum(trial.judged.found for trial in own)
        ranked = sum(sum(trial.judged.relevant) for trial in own)
        average = mean_average_precision([trial.judged for trial in own])
        shown = "–" if math.isnan(average) else f"{average:.3f}"
        kept = sum(trial.kept for trial in own) / len(own)
        table.add(variant, str(len(own)), f"{kept:.1%}", str(total), str(found), str(ranked), shown)
    return table
