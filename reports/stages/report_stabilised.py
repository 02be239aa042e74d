"""Stage report_stabilised: write an HTML page about stabilised takes, from the results of the pipeline."""

from __future__ import annotations

from importlib import resources
from typing import ClassVar

from pydantic import BaseModel, ConfigDict, Field

from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.digests import files_digest
from kinedex.pipelines.engine.page_files import write_page
from kinedex.pipelines.engine.stage import Input, Stage
from kinedex.reports.stabilised_page import stabilised_page
from kinedex.storage.store.store import Store


class Params(BaseModel):
    """The parameters of the stage `report_stabilised`."""

    model_config = ConfigDict(extra="forbid")

    title: str = Field("Stabilised takes, before and after", description="title of the page")
    takes: int = Field(20, ge=1, description="takes on the page, those first that priors have moved most")


class ReportStabilised(Stage[Params]):
    """Writes an HTML page about stabilised takes, from the results of the pipeline."""

    name = "report_stabilised"
    parameters = Params
    inputs: ClassVar = {
        "stabilised": Input("stabilise"),
        "evaluation": Input("evaluate_track", optional=True),
    }

    def external_digest(self, params: Params, store: Store | None) -> str:
        """Return a hash of the page's templates, scripts and styles."""
        pages = resources.files("kinedex.reports").joinpath("pages")
        names = ("stabilised.html.j2", "layout.html.j2", "player.html.j2", "player.js", "behaviour.js", "style.css")
        with resources.as_file(pages) as folder:
            return files_digest([folder / name for name in names])

    def run(self, context: StageContext, params: Params) -> dict[str, object]:
        """Write `stabilised.html` into the pipeline's report folder."""
        store = context.open()
        page = stabilised_page(store, context.key(context.inputs["stabilised"]), params.title, params.takes)
        path = context.report_file("stabilised.html")
        size = write_page(page, path)
        context.say(f"report: {path.resolve()} ({size / 1e3:.0f} kB)")
        return {"files": [path.relative_to(context.store_path).as_posix()], "bytes": size}
