"""The environment that renders the templates of pages: values are escaped, and an undefined name is an error."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from jinja2 import Environment, PackageLoader, StrictUndefined

from kinedex.pipelines.evaluation.annotation_scores import THESIS_NAMES


def page_environment(filters: Mapping[str, Callable[..., object]] | None = None) -> Environment:
    """Return the environment of the templates in `reports/pages`, with the filters of a page."""
    environment = Environment(
        loader=PackageLoader("kinedex.reports", "pages"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(filters or {})
    environment.globals["thesis_names"] = THESIS_NAMES
    return environment
