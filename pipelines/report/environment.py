"""How pages are made from their templates: escaped, and with an error for every name that is missing."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from jinja2 import Environment, PackageLoader, StrictUndefined


def page_environment(filters: Mapping[str, Callable[..., object]] | None = None) -> Environment:
    """The environment of the templates in `pipelines/report/pages`, with a page's own filters."""
    environment = Environment(
        loader=PackageLoader("kinedex.pipelines.report", "pages"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(filters or {})
    return environment
