"""Stage report_limb_errors: write an HTML page about takes and inertial sensors, from the results of the pipeline."""

from __future__ import annotations

from typing import ClassVar

from pydantic import BaseModel, ConfigDict, Field

from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.stage import Input
from kinedex.reports.limb_error_data import StageKeys
from kinedex.reports.limb_errors_page import limb_errors_page
from kinedex.reports.page_environment import PageStage


class Params(BaseModel):
    """The parameters of the stage `report_limb_errors`."""

    model_config = ConfigDict(extra="forbid")

    title: str = Field("Takes against inertial sensors", description="title of the page")
    takes: int = Field(20, ge=1, description="number of takes on the page: those with the most wrong frames")
    demonstration: bool = Field(
        False, description="show how a wrong mapping between sensor and limb hides errors, with an example"
    )


class ReportLimbErrors(PageStage[Params]):
    """Writes an HTML page about takes and inertial sensors, from the results of the pipeline (thesis, Fig. 7.7)."""

    name = "report_limb_errors"
    parameters = Params
    file = "limb-errors.html"
    inputs: ClassVar = {
        "errors": Input("limb_errors"),
        "clocks": Input("synchronise"),
        "calibration": Input("calibrate_sensors"),
        "sensors": Input("read_imu"),
        "limbs": Input("limb_orientations"),
        "broken": Input("break_track", optional=True),
        "evaluation": Input("evaluate_limb_errors", optional=True),
    }

    def page(self, context: StageContext, params: Params) -> str:
        """Return the page about takes and sensors."""
        inputs = context.inputs
        keys = StageKeys(
            errors=context.key(inputs["errors"]),
            clocks=context.key(inputs["clocks"]),
            calibration=context.key(inputs["calibration"]),
            sensors=context.key(inputs["sensors"]),
            limbs=context.key(inputs.get("broken", inputs["limbs"])),
            evaluation=context.key(inputs["evaluation"]) if "evaluation" in inputs else None,
        )
        return limb_errors_page(context.open(), keys, params.title, params.takes, demonstration=params.demonstration)
