"""Stage report_reconstruction: write an HTML page about takes made from depth, from the results of the pipeline."""

from __future__ import annotations

from typing import ClassVar

from pydantic import BaseModel, ConfigDict, Field

from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.stage import Input
from kinedex.reports.page_environment import PageStage
from kinedex.reports.reconstruction_page import reconstruction_page


class Params(BaseModel):
    """The parameters of the stage `report_reconstruction`."""

    model_config = ConfigDict(extra="forbid")

    title: str = Field("Motion from a depth camera", description="title of the page")
    takes: int = Field(
        20, ge=1, description="number of takes on the page: those farthest from the truth, or of the largest cost"
    )


class ReportReconstruction(PageStage[Params]):
    """Writes an HTML page about takes made from depth, from the results of the pipeline."""

    name = "report_reconstruction"
    parameters = Params
    file = "reconstruction.html"
    inputs: ClassVar = {
        "reconstructions": Input("reconstruct"),
        "evaluation": Input("evaluate_reconstruction", optional=True),
    }

    def page(self, context: StageContext, params: Params) -> str:
        """Return the page about takes made from depth."""
        stage = context.key(context.inputs["reconstructions"])
        evaluation = context.key(context.inputs["evaluation"]) if "evaluation" in context.inputs else None
        return reconstruction_page(context.open(), stage, evaluation, params.title, params.takes)
