"""Stage report_reconstruction: write an HTML page about takes made from depth, from the results of the pipeline."""

from __future__ import annotations

from importlib import resources
from typing import ClassVar

from pydantic import BaseModel, ConfigDict, Field

from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.digests import files_digest
from kinedex.pipelines.engine.page_files import write_page
from kinedex.pipelines.engine.stage import Input, Stage
from kinedex.reports.reconstruction_page import reconstruction_page
from kinedex.storage.store.store import Store


class Params(BaseModel):
    """The parameters of the stage `report_reconstruction`."""

    model_config = ConfigDict(extra="forbid")

    title: str = Field("Motion from a depth camera", description="title of the page")
    takes: int = Field(
        20, ge=1, description="takes on the page, those first that are farthest from the truth, or cost most"
    )


class ReportReconstruction(Stage[Params]):
    """Writes an HTML page about takes made from depth, from the results of the pipeline."""

    name = "report_reconstruction"
    parameters = Params
    inputs: ClassVar = {
        "reconstructions": Input("reconstruct"),
        "evaluation": Input("evaluate_reconstruction", optional=True),
    }

    def external_digest(self, params: Params, store: Store | None) -> str:
        """Return a hash of the page's templates, scripts and styles."""
        pages = resources.files("kinedex.reports").joinpath("pages")
        names = ("reconstruction.html.j2", "layout.html.j2", "player.html.j2", "player.js", "behaviour.js", "style.css")
        with resources.as_file(pages) as folder:
            return files_digest([folder / name for name in names])

    def run(self, context: StageContext, params: Params) -> dict[str, object]:
        """Write `reconstruction.html` into the pipeline's report folder."""
        store = context.open()
        stage = context.key(context.inputs["reconstructions"])
        evaluation = context.key(context.inputs["evaluation"]) if "evaluation" in context.inputs else None
        page = reconstruction_page(store, stage, evaluation, params.title, params.takes)
        path = context.report_file("reconstruction.html")
        size = write_page(page, path)
        context.say(f"report: {path.resolve()} ({size / 1e3:.0f} kB)")
        return {"files": [path.relative_to(context.store_path).as_posix()], "bytes": size}
