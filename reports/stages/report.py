"""Stage report: write an HTML page about annotations from the results of the pipeline."""

from __future__ import annotations

from datetime import datetime
from typing import ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field

from kinedex.ops.wording import counted
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.page_files import write_page
from kinedex.pipelines.engine.stage import Input, Stage
from kinedex.reports.annotation_data import read_report_data
from kinedex.reports.annotation_page import annotation_page, hits_to_play, shown_takes
from kinedex.reports.class_explanations import explanations_of
from kinedex.reports.embedded_motions import embed
from kinedex.reports.example_motions import with_hits
from kinedex.reports.page_environment import pages_digest
from kinedex.reports.report_overview import LOOKS, SEGMENTS, csv_lines, in_order
from kinedex.storage.store.store import Store


class Params(BaseModel):
    """The parameters of the stage `report`, which select the takes, curves and motions of the page."""

    model_config = ConfigDict(extra="forbid")

    title: str | None = Field(default=None, description="Title of the page; by default the archive's folder names it.")
    takes: list[str] | None = Field(
        default=None,
        description="The takes whose timelines are shown, in this order; by default all, or a choice: with ground "
        "truth the worst, the middle and the best by F (frames), otherwise those with the most segments and with the "
        "most doubtful segments.",
    )
    max_takes: int = Field(default=40, ge=1, description="Largest number of timelines if `takes` is not given.")
    embed: Literal["auto", "all", "none"] | list[str] = Field(
        default="auto",
        description="Takes whose motion is embedded in the page, so that a click on a segment plays it: auto (as many "
        "as keep the page below 20 MB), all (that have a timeline), none, or a list of names.",
    )
    curves_take: str | None = Field(
        default=None, description="The take whose distance curves are shown; by default the median by F (frames)."
    )


class Report(Stage[Params]):
    """Writes an HTML page about annotations from the results of the pipeline."""

    name = "report"
    parameters = Params
    inputs: ClassVar = {
        "templates": Input("learn_templates"),
        "annotations": Input("annotate"),
        "evaluation": Input("evaluate", optional=True),
        "leave_one_out": Input("compare_methods", optional=True),
        "index": Input("index", optional=True),
    }

    def external_digest(self, params: Params, store: Store | None) -> str:
        """Return a hash of the page's templates and styles."""
        return pages_digest()

    def run(self, context: StageContext, params: Params) -> dict[str, object]:
        """Write `report.html` into the pipeline's report folder, and `report.segments.csv` with all segments.

        Where an input is missing, a sentence on the page says so.

        Raises
        ------
        KinedexError
            `takes` or `curves_take` names a take that was not annotated.
        """
        store = context.open()
        data = read_report_data(
            store,
            context.pipeline,
            created=datetime.now().astimezone(),
            title=params.title,
            inputs=context.inputs,
            own_stage=context.stage,
            curves_take=params.curves_take,
        )
        path = context.report_file("report.html")
        shown = shown_takes(data, params.takes, params.max_takes).shown
        motions = embed(store, shown, params.embed, progress=context.progress)
        takes, near = len(motions.motions), None
        if params.embed != "none":
            motions, near = with_hits(
                store, motions, hits_to_play(data), in_order(data.automatic), data.templates, context.progress
            )
        why = explanations_of(store, in_order(data.automatic)[:LOOKS])
        page = annotation_page(
            data, takes=params.takes, max_takes=params.max_takes, motions=motions, near=near, why=why
        )
        size = write_page(page, path)
        table = context.report_file(SEGMENTS)
        write_page("".join(csv_lines(data)), table)
        context.message(f"report: {path.resolve()} ({size / 1e6:.1f} MB, motion of {counted(takes, 'take')})")
        return {
            "files": [file.relative_to(context.store_path).as_posix() for file in (path, table)],
            "bytes": size,
            "takes": len(data.takes),
            "curves_take": data.curves_take,
        }
