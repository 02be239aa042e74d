"""Stage report_limb_errors: write an HTML page about takes and inertial sensors, from the results of the pipeline."""

from __future__ import annotations

from importlib import resources
from typing import ClassVar

from pydantic import BaseModel, ConfigDict, Field

from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.digests import files_digest
from kinedex.pipelines.engine.page_files import write_page
from kinedex.pipelines.engine.stage import Input, Stage
from kinedex.reports.limb_error_data import StageKeys
from kinedex.reports.limb_errors_page import limb_errors_page
from kinedex.storage.store.store import Store


class Params(BaseModel):
    """The parameters of the stage `report_limb_errors`."""

    model_config = ConfigDict(extra="forbid")

    title: str = Field("Takes against inertial sensors", description="title of the page")
    takes: int = Field(20, ge=1, description="takes on the page, those first in which most frames are wrong")
    demonstration: bool = Field(
        False, description="show how a wrong mapping between sensor and limb hides errors, on orientations made for it"
    )


class ReportLimbErrors(Stage[Params]):
    """Writes an HTML page about takes and inertial sensors, from the results of the pipeline (thesis, Fig. 7.7)."""

    name = "report_limb_errors"
    parameters = Params
    inputs: ClassVar = {
        "errors": Input("limb_errors"),
        "clocks": Input("synchronise"),
        "calibration": Input("calibrate_sensors"),
        "sensors": Input("read_imu"),
        "limbs": Input("limb_orientations"),
        "broken": Input("break_track", optional=True),
        "evaluation": Input("evaluate_limb_errors", optional=True),
    }

    def external_digest(self, params: Params, store: Store | None) -> str:
        """Return a hash of the page's templates, scripts and styles."""
        pages = resources.files("kinedex.reports").joinpath("pages")
        names = ("limb_errors.html.j2", "layout.html.j2", "player.html.j2", "player.js", "behaviour.js", "style.css")
        with resources.as_file(pages) as folder:
            return files_digest([folder / name for name in names])

    def run(self, context: StageContext, params: Params) -> dict[str, object]:
        """Write `limb-errors.html` into the pipeline's report folder."""
        inputs = context.inputs
        keys = StageKeys(
            errors=context.key(inputs["errors"]),
            clocks=context.key(inputs["clocks"]),
            calibration=context.key(inputs["calibration"]),
            sensors=context.key(inputs["sensors"]),
            limbs=context.key(inputs.get("broken", inputs["limbs"])),
            evaluation=context.key(inputs["evaluation"]) if "evaluation" in inputs else None,
        )
        page = limb_errors_page(context.open(), keys, params.title, params.takes, demonstration=params.demonstration)
        path = context.report_file("limb-errors.html")
        size = write_page(page, path)
        context.say(f"report: {path.resolve()} ({size / 1e3:.0f} kB)")
        return {"files": [path.relative_to(context.store_path).as_posix()], "bytes": size}
