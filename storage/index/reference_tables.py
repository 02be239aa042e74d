"""Make the small tables of the index that describe the others: the features, and the list of views and macros."""

from __future__ import annotations

import pyarrow as pa

from kinedex.catalog.features import FeatureSet
from kinedex.catalog.sql.views import help_rows


def features_table(feature_set: FeatureSet) -> pa.Table:
    """Return the rows of the view `features`."""
    rows = []
    for feature in feature_set.features:
        home = feature_set.set_of(feature.number)
        rows.append(
            {
                "number": feature.number,
                "name": feature.name,
                "description": feature.description,
                "feature_set": home.name,
                "bit": feature.number - home.first,
            }
        )
    small = {"number": pa.uint8(), "bit": pa.uint8()}
    fields = [(name, small.get(name, pa.string())) for name in ("number", "name", "description", "feature_set", "bit")]
    return pa.Table.from_pylist(rows, schema=pa.schema(fields))


def help_table(*, index_only: bool = False) -> pa.Table:
    """Return the rows of the view `help`."""
    columns = ("name", "call", "summary", "example")
    rows = help_rows(index_only=index_only)
    return pa.Table.from_pylist([dict(zip(columns, row, strict=True)) for row in rows])
