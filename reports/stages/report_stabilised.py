"""Stage report_stabilised: write an HTML page about stabilised takes, from the results of the pipeline."""

from __future__ import annotations

from typing import ClassVar

from pydantic import BaseModel, ConfigDict, Field

from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.stage import Input
from kinedex.reports.page_environment import PageStage
from kinedex.reports.stabilised_page import stabilised_page


class Params(BaseModel):
    """The parameters of the stage `report_stabilised`."""

    model_config = ConfigDict(extra="forbid")

    title: str = Field("Stabilised takes, before and after", description="title of the page")
    takes: int = Field(20, ge=1, description="number of takes on the page: those that priors have moved most")


class ReportStabilised(PageStage[Params]):
    """Writes an HTML page about stabilised takes, from the results of the pipeline."""

    name = "report_stabilised"
    parameters = Params
    file = "stabilised.html"
    inputs: ClassVar = {
        "stabilised": Input("stabilise"),
        "evaluation": Input("evaluate_track", optional=True),
    }

    def page(self, context: StageContext, params: Params) -> str:
        """Return the page about stabilised takes."""
        stage = context.key(context.inputs["stabilised"])
        return stabilised_page(context.open(), stage, params.title, params.takes)
