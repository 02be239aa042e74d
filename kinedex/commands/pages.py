"""Write the page of `--html` and the picture of `-o FILE.png` for commands that show motions."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from kinedex.commands.output import print_message, print_path
from kinedex.ops.errors import KinedexError

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pyarrow as pa

    from kinedex.pipelines.ranking.store_ranking import StoreRanking
    from kinedex.pipelines.templates.learning import SubclassTemplate
    from kinedex.storage.store.store import Store


@dataclass
class Pages:
    """The page and the picture that a command was asked to write.

    Parameters
    ----------
    html : Path or None
        The file of the page.
    output : Path or None
        The file of `--output`, a picture if it ends in .png.
    figures : int
        Largest number of figures.

    Raises
    ------
    KinedexError
        The page does not end in .html, or its folder does not exist; this is checked before the search.
    """

    html: Path | None
    output: Path | None = None
    figures: int = 0
    amounts: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        if self.html is not None and self.html.suffix.lower() not in (".html", ".htm"):
            raise KinedexError(f"--html {self.html}: a page ends in .html, for instance {self.html.name}.html")
        for option, path in (("--html", self.html), ("--output", self.picture)):
            if path is not None and not path.absolute().parent.is_dir():
                raise KinedexError(
                    f"{option} {path}: the folder {path.parent} does not exist; make it, or name another"
                )

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
        if self.html is None and self.picture is None:
            return
        from kinedex.reports.motion_pages.hits import write_ranking

        hits = found.table()
        hits = hits if hits.num_rows else found.nearest_table()
        remarks = (*found.remarks, *found.misses(tau))
        self.amounts.append(
            write_ranking(
                store, hits, self.html, self.picture, tau=tau, kind=kind, stage=stage, example=example,
                remarks=remarks, most=self.figures,
            )
        )  # fmt: skip

    def write_search(self, store: Store, hits: pa.Table, title: str, remarks: Sequence[str]) -> None:
        """Write the hits of a search to page and picture."""
        if self.html is None and self.picture is None:
            return
        from kinedex.reports.motion_pages.hits import write_search

        self.amounts.append(write_search(store, hits, self.html, self.picture, title, remarks, self.figures))

    def write_template(self, store: Store, one: SubclassTemplate, delta: float) -> None:
        """Write the page of a template."""
        if self.html is not None:
            from kinedex.reports.motion_pages.template import write_template_page

            self.amounts.append(write_template_page(store, one, delta, self.html, self.figures))

    def write_takes(self, store: Store, takes: pa.Table, group: str | None) -> None:
        """Write the page on which all takes move as small figures."""
        if self.html is not None:
            from kinedex.reports.motion_pages.takes import write_takes_page

            self.amounts.append(write_takes_page(store, takes, self.html, group=group, most=self.figures))

    def report(self) -> None:
        """Print the path of the page, and how many figures are shown."""
        if self.html is not None:
            print_path(self.html)
        for amount in self.amounts:
            print_message(f"figures: {amount}")
