"""Define keyframe queries for the Python interface, which notebooks show as tables."""

from __future__ import annotations

from collections.abc import Iterable

from kinedex.catalog.features import FeatureSet
from kinedex.catalog.queries import query as catalog_query
from kinedex.catalog.queries.keyframe_query import KeyframeQuery
from kinedex.library.arguments import checked_methods


@checked_methods
class Query(catalog_query.Query):
    __doc__ = catalog_query.Query.__doc__

    def _repr_html_(self) -> str:
        from kinedex.reports.notebook_html import query_html

        return query_html(self.resolve(), self.feature_set)


def resolved_queries(queries: Query | Iterable[Query], feature_set: FeatureSet, rate_hz: float) -> list[KeyframeQuery]:
    """Resolve queries to feature bits and frames, for a store with the given features and analysis rate."""
    return [one.resolve(feature_set, rate_hz) for one in ([queries] if isinstance(queries, Query) else queries)]
