"""Stage evaluate_ranking: compute the average precision of every class, in takes with ground truth and among clips."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import polars as pl
from pydantic import Field

from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.templates.templates import Kind, quantise
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.digests import files_digest
from kinedex.pipelines.engine.file_parameters import StageParameters
from kinedex.pipelines.engine.stage import Input, Stage
from kinedex.pipelines.templates.ranked_hits import RankedTemplate
from kinedex.pipelines.templates.ranking import rank_takes
from kinedex.pipelines.templates.ranking_evaluation import (
    EvaluatedRanking,
    Fold,
    clip_costs,
    evaluate_clips,
    evaluate_hits,
    mean_average_precision,
    names_filter,
    read_truth,
    recall_at_tau,
    retrieval_rows,
    retrieval_table,
)
from kinedex.pipelines.templates.template_learning import learn_templates, read_templates, training_clips
from kinedex.storage.formats.labels.formats import ground_truth_files
from kinedex.storage.store.store import Store

NONE = "none"


class Params(StageParameters):
    """The parameters of the stage `evaluate_ranking`."""

    ground_truth: str = Field(
        "**/ground_truth.csv",
        description="CSV files with take, class, start, stop in source frames, a glob below the takes' source folders; "
        "'none': no takes are judged",
    )
    where: str = Field("class IS NULL", description="takes to judge: a SQL filter over the columns of takes")
    clips: str = Field("class IS NOT NULL", description="clips to judge: a SQL filter over the columns of takes")
    leave_out: str | None = Field(
        "actor", description="column of takes; the clips of each value are ranked by templates learned from other clips"
    )
    folds: list[Fold] = Field([], description="folds by filters of takes, used instead of leave_out")
    templates: Kind = Field("soft", description="which templates: soft or hard")
    delta: float = Field(0.1, ge=0, lt=0.5, description="template values within delta of 0 or 1 count")
    tau: float = Field(0.1, gt=0, le=1, description="recall is reported at this threshold")


class EvaluateRanking(Stage[Params]):
    """Computes the average precision of every class, in takes with ground truth and among clips of other folds."""

    name = "evaluate_ranking"
    parameters = Params
    inputs: ClassVar = {"templates": Input("learn_templates")}

    def external_digest(self, params: Params, store: Store | None) -> str:
        """Return a hash of the ground truth."""
        if params.ground_truth == NONE or store is None:
            return ""
        try:
            return files_digest(ground_truth_files(params.ground_truth, sorted(store.takes()["source_root"].unique())))
        except KinedexError:
            return "none to be read"

    def run(self, context: StageContext, params: Params) -> dict[str, object]:
        """Evaluate the rankings, show a table for takes and one for clips, and store the results."""
        store = context.open()
        summary: dict[str, object] = {"tau": params.tau, "delta": params.delta}
        judged: list[EvaluatedRanking] = []
        in_takes = _takes(context, store, params)
        for what, found in (("takes", in_takes), ("clips", _clips(context, store, params))):
            if found:
                title = {"takes": "hits in takes against ground truth", "clips": "clips that were not learned from"}[
                    what
                ]
                context.terminal.show(retrieval_table(found, title, params.tau))
                summary |= {f"{what}_map": mean_average_precision(found), f"{what}_recall": recall_at_tau(found)}
                judged += found
        context.put_results(retrieval=retrieval_rows(judged, context.run))
        return summary


def _takes(context: StageContext, store: Store, params: Params) -> list[EvaluatedRanking]:
    """Evaluate the ranking of all hits in takes for each class."""
    if params.ground_truth == NONE:
        return []
    learned = read_templates(store, context.key(context.inputs["templates"]), params.templates)
    truth = read_truth(store, params.ground_truth, params.where, [one.subclass for one in learned])
    context.report_unmatched(truth.unmatched)
    context.message(*truth.remarks)
    searched = [RankedTemplate(one.subclass, quantise(one.learned.template, params.delta)) for one in learned]
    rankings = rank_takes(store, searched, 1.0, None, f"({params.where}) AND {names_filter(truth.takes)}")
    return [evaluate_hits(one.name, one.hits, truth.segments, params.tau) for one in rankings]


def _clips(context: StageContext, store: Store, params: Params) -> list[EvaluatedRanking]:
    """Evaluate the rankings of the clips of each fold by templates learned from the other folds."""
    folds = _folds(store, params)
    judged: list[EvaluatedRanking] = []
    with context.progress("folds", len(folds)) as bar:
        for fold in folds:
            judged += _clips_of(fold, context, store, params)
            bar.advance()
    return judged


def _clips_of(fold: Fold, context: StageContext, store: Store, params: Params) -> list[EvaluatedRanking]:
    """Evaluate the rankings of the clips of one fold."""
    training = store.takes(f"({params.clips}) AND ({fold.learn})")
    ranked = store.takes(f"({params.clips}) AND ({fold.rank})").sort("take_id")
    if not training.height or not ranked.height:
        context.message(f"{fold.name}: {training.height} clips to learn from, {ranked.height} to rank; excluded")
        return []
    clips, features = training_clips(store, training), len(store.feature_set.features)
    templates = {
        one.subclass: quantise(one.learned.template, params.delta)
        for group in learn_templates(clips, [params.templates], features, context.executor)
        for one in group
    }
    costs = clip_costs(templates, store.words(ranked["take_id"].to_list()))
    labels, names = ranked["class"].to_list(), ranked["name"].to_list()
    missing = sorted(set(labels) - set(templates))
    if missing:
        context.message(f"{fold.name}: no clips of others, so no template: {', '.join(missing)}")
    return [evaluate_clips(fold.name, label, costs[label], labels, names, params.tau) for label in templates]


def _folds(store: Store, params: Params) -> Sequence[Fold]:
    if params.folds or params.leave_out is None:
        return params.folds
    takes = store.takes(params.clips)
    if params.leave_out not in takes.columns:
        known = did_you_mean(params.leave_out, takes.columns)
        raise KinedexError(f"leave_out: takes have no column '{params.leave_out}'{known}")
    values = takes[params.leave_out].cast(pl.String).drop_nulls().unique().sort().to_list()
    column = f'CAST("{params.leave_out}" AS VARCHAR)'
    quoted = [(value, "'" + value.replace("'", "''") + "'") for value in values]
    return [Fold(name=value, learn=f"{column} <> {text}", rank=f"{column} = {text}") for value, text in quoted]
