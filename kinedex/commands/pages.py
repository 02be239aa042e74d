"""Write the page of `--html` and the picture of `-o FILE.png` for commands that show motions."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinedex.commands.app import OptionGroup
from kinedex.commands.options import Output
from kinedex.commands.output import print_message, print_path
from kinedex.ops.errors import KinedexError
from kinedex.reports.motion_pages import FIGURES

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pyarrow as pa

    from kinedex.pipelines.templates.store_ranking import StoreRanking
    from kinedex.pipelines.templates.template_learning import SubclassTemplate
    from kinedex.reports.motion_pages.hits_page import HitsPage
    from kinedex.storage.store.store import Store


@dataclass(frozen=True)
class Pages(OptionGroup):
    """The page of moving figures that a command should write, if requested."""

    html: Annotated[
        Path | None,
        typer.Option("--html", metavar="FILE", help="Write a page with a moving figure of each; it needs no network."),
    ] = None
    figures: Annotated[
        int, typer.Option("--figures", min=1, metavar="N", help="Largest number of figures of a page or picture.")
    ] = FIGURES
    amounts: list[str] = field(default_factory=list, init=False)
    """The sentences that state how many figures are shown."""

    @property
    def picture(self) -> Path | None:
        """None; in a subclass, the path of the picture to write."""
        return None

    def check(self) -> None:
        """Raise an error if the page does not end in .html, or the folder of the page or picture does not exist."""
        if self.html is not None and self.html.suffix.lower() not in (".html", ".htm"):
            raise KinedexError(f"--html {self.html}: a page ends in .html, for instance {self.html.name}.html")
        for option, path in (("--html", self.html), ("--output", self.picture)):
            if path is not None and not path.absolute().parent.is_dir():
                raise KinedexError(
                    f"{option} {path}: the folder {path.parent} does not exist; make it, or name another"
                )

    def write_template(self, store: Store, one: SubclassTemplate, delta: float) -> None:
        """Write the page of a template."""
        if self.html is not None:
            from kinedex.reports.motion_pages.template_page import write_template_page

            self.amounts.append(write_template_page(store, one, delta, self.html, self.figures))

    def write_takes(self, store: Store, takes: pa.Table, group: str | None) -> None:
        """Write the page that shows takes as small moving figures."""
        if self.html is not None:
            from kinedex.reports.motion_pages.takes_page import write_takes_page

            self.amounts.append(write_takes_page(store, takes, self.html, group=group, most=self.figures))

    def report(self) -> None:
        """Print the path of the page, and how many figures are shown."""
        if self.html is not None:
            print_path(self.html)
        for amount in self.amounts:
            print_message(f"figures: {amount}")


@dataclass(frozen=True)
class HitsOutput(Pages, Output):
    """The format and the file of a table of hits, and the page and the picture that show the hits."""

    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="Write to this file; its ending (.csv, .json, .parquet) is the format unless given; .png makes a "
            "picture with the frames of each hit.",
        ),
    ] = None

    @property
    def picture(self) -> Path | None:
        """The path given by `--output` if it is a PNG file; else None."""
        return self.output if self.output is not None and self.output.suffix.lower() == ".png" else None

    def write_ranking(
        self,
        store: Store,
        found: StoreRanking,
        example: tuple[str, int, int] | None,
        tau: float,
        kind: str,
        stage: str | None,
    ) -> None:
        """Write the hits of a ranking to page and picture, or the nearest intervals if there is no hit."""
        if self.html is not None or self.picture is not None:
            from kinedex.reports.motion_pages.hits_page import ranking_page

            hits = found.table()
            hits = hits if hits.num_rows else found.nearest_table()
            remarks = (*found.remarks, *found.misses(tau))
            self._write(store, hits, replace(ranking_page(store, hits, tau, kind, stage, example), remarks=remarks))

    def write_search(self, store: Store, hits: pa.Table, title: str, remarks: Sequence[str]) -> None:
        """Write the hits of a search to page and picture."""
        if self.html is not None or self.picture is not None:
            from kinedex.reports.motion_pages.hits_page import search_page

            self._write(store, hits, replace(search_page(store, title), remarks=remarks))

    def _write(self, store: Store, hits: pa.Table, about: HitsPage) -> None:
        from kinedex.reports.motion_pages.hits_page import write_hits_page, write_strip

        amount = ""
        if self.html is not None:
            amount = write_hits_page(store, hits, about, self.html, self.figures)
        if self.picture is not None:
            amount = write_strip(store, hits, about, self.picture, self.figures)
        self.amounts.append(amount)
