"""Set up the Jinja environment for the templates of pages, and define the base class of stages that draw a page."""

from __future__ import annotations

import hashlib
from abc import abstractmethod
from collections.abc import Callable, Mapping
from importlib import resources
from typing import ClassVar

from jinja2 import Environment, PackageLoader, StrictUndefined

from kinedex.ops.intervals import in_seconds, shown_seconds
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.page_files import write_page
from kinedex.pipelines.engine.stage import Parameters, Stage
from kinedex.pipelines.evaluation.annotation_scores import THESIS_NAMES
from kinedex.storage.store.store import Store


def page_environment(filters: Mapping[str, Callable[..., object]] | None = None) -> Environment:
    """Return the environment of the templates in `reports/pages`, with the filters of a page.

    Values are escaped, and an undefined name in a template is an error. All pages have the filters `seconds` and
    `in_seconds`, which convert frames to seconds as a text and as a number.
    """
    environment = Environment(
        loader=PackageLoader("kinedex.reports", "pages"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update({"seconds": shown_seconds, "in_seconds": in_seconds, **(filters or {})})
    environment.globals["thesis_names"] = THESIS_NAMES
    return environment


def pages_digest() -> str:
    """Return a hash of the templates, scripts and styles of all pages."""
    hasher = hashlib.sha256()
    for file in sorted(resources.files("kinedex.reports").joinpath("pages").iterdir(), key=lambda file: file.name):
        hasher.update(file.name.encode() + b"\0" + file.read_bytes() + b"\0")
    return hasher.hexdigest()[:16]


class PageStage(Stage[Parameters]):
    """Base class of the stages that draw one page from the results of other stages.

    Attributes
    ----------
    file : str
        The file of the page, in the pipeline's report folder.
    """

    file: ClassVar[str]

    @abstractmethod
    def page(self, context: StageContext, params: Parameters) -> str:
        """Return the HTML of the page."""

    def external_digest(self, params: Parameters, store: Store | None) -> str:
        """Return a hash of the templates, scripts and styles of pages."""
        return pages_digest()

    def run(self, context: StageContext, params: Parameters) -> dict[str, object]:
        """Write the page into the pipeline's report folder."""
        page = self.page(context, params)
        path = context.report_file(self.file)
        size = write_page(page, path)
        context.message(f"report: {path.resolve()} ({size / 1e3:.0f} kB)")
        return {"files": [path.relative_to(context.store_path).as_posix()], "bytes": size}
