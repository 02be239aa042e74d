"""Stage report_retrieval: write an HTML page about ranking, from the results of the pipeline."""

from __future__ import annotations

from typing import ClassVar

from pydantic import BaseModel, ConfigDict, Field

from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.stage import Input
from kinedex.pipelines.templates.template_learning import run_of
from kinedex.reports.motion_pages.hits_page import best_hits
from kinedex.reports.page_environment import PageStage
from kinedex.reports.retrieval_page import retrieval_page


class Params(BaseModel):
    """The parameters of the stage `report_retrieval`."""

    model_config = ConfigDict(extra="forbid")

    title: str = Field("How motions are ranked", description="title of the page")
    figures: int = Field(6, ge=0, description="number of hits of each template that the page plays")


class ReportRetrieval(PageStage[Params]):
    """Writes an HTML page about ranking, from the results of the pipeline."""

    name = "report_retrieval"
    parameters = Params
    file = "retrieval.html"
    inputs: ClassVar = {
        "ranking": Input("rank"),
        "evaluation": Input("evaluate_ranking"),
        "stiffness": Input("vary_stiffness"),
    }

    def page(self, context: StageContext, params: Params) -> str:
        """Return the page about ranking; where an input is missing, a sentence on the page says so."""
        store = context.open()
        keys = {role: context.key(stage) for role, stage in context.inputs.items()}
        evaluation = store.result("retrieval", run=run_of(store, keys["evaluation"])).to_pylist()
        stiffness = store.result("precision_recall", run=run_of(store, keys["stiffness"])).to_pylist()
        summary = store.manifest.stages[keys["ranking"]].summary
        hits = store.result("ranked_hits", run=run_of(store, keys["ranking"]))
        figures = best_hits(store, hits, context.pipeline, params.figures)
        return retrieval_page(params.title, summary, hits.to_pylist(), evaluation, stiffness, figures)
