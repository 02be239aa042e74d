"""Stage report_retrieval: write an HTML page about ranking, from the results of the pipeline."""

from __future__ import annotations

from importlib import resources
from typing import ClassVar

from pydantic import BaseModel, ConfigDict, Field

from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.digests import files_digest
from kinedex.pipelines.engine.page_files import write_page
from kinedex.pipelines.engine.stage import Input, Stage
from kinedex.pipelines.templates.learning import run_of
from kinedex.reports.motion_pages.hits import best_hits
from kinedex.reports.retrieval_page import retrieval_page
from kinedex.storage.store.store import Store

PAGE = ("retrieval.html.j2", "wall.html.j2", "player.html.j2", "player.js", "behaviour.js", "style.css")
"""Files that the page is made of."""


class Params(BaseModel):
    """The parameters of the stage `report_retrieval`."""

    model_config = ConfigDict(extra="forbid")

    title: str = Field("How motions are ranked", description="title of the page")
    figures: int = Field(6, ge=0, description="hits of each template that the page shows in motion")


class ReportRetrieval(Stage[Params]):
    """Writes an HTML page about ranking, from the results of the pipeline."""

    name = "report_retrieval"
    parameters = Params
    inputs: ClassVar = {
        "ranking": Input("rank"),
        "evaluation": Input("evaluate_ranking"),
        "stiffness": Input("vary_stiffness"),
    }

    def external_digest(self, params: Params, store: Store | None) -> str:
        """Return a hash of the page's templates and styles."""
        pages = resources.files("kinedex.reports").joinpath("pages")
        with resources.as_file(pages) as folder:
            return files_digest([folder / name for name in PAGE])

    def run(self, context: StageContext, params: Params) -> dict[str, object]:
        """Write `retrieval.html` into the pipeline's report folder; what is missing is a sentence on the page."""
        store = context.open()
        rows = {
            role: store.result(kind, run=run_of(store, key)).to_pylist()
            for role, kind, key in (
                ("evaluation", "retrieval", context.key(context.inputs["evaluation"])),
                ("stiffness", "precision_recall", context.key(context.inputs["stiffness"])),
            )
        }
        summary = store.manifest.stages[context.key(context.inputs["ranking"])].summary
        hits = store.result("ranked_hits", run=run_of(store, context.key(context.inputs["ranking"])))
        figures = best_hits(store, hits, context.pipeline, params.figures)
        page = retrieval_page(params.title, summary, hits.to_pylist(), rows["evaluation"], rows["stiffness"], figures)
        path = context.report_file("retrieval.html")
        size = write_page(page, path)
        context.say(f"report: {path.resolve()} ({size / 1e3:.0f} kB)")
        return {"files": [path.relative_to(context.store_path).as_posix()], "bytes": size}
