"""Make the views and macros of an index, a hash of their SQL, and the small tables that describe features and views."""

from __future__ import annotations

import hashlib

import pyarrow as pa

from kinedex.catalog.features import FeatureSet
from kinedex.catalog.sql.views import MACROS, help_rows
from kinedex.storage import duckdb_sql


def views_digest(feature_set: FeatureSet, rate_hz: float) -> str:
    """Return a hash of the views, macros and help of an index, on which its stored rows do not depend."""
    text = "\n".join([*index_statements(feature_set, rate_hz), *map(repr, help_rows(index_only=True))])
    return hashlib.sha256(text.encode()).hexdigest()


def index_statements(feature_set: FeatureSet, rate_hz: float) -> list[str]:
    """Return the SQL statements that create the views and macros over the tables of an index."""
    # every column is qualified by its table: a bare name could be taken for an argument of a macro
    run = "s.take_id::BIGINT AS take_id, s.start, s.start + s.frames AS stop"
    lists = [
        f"SELECT {duckdb_sql.quote(name)} AS feature_set, s.word, {run} FROM {lists_table(name)} AS s"
        for name in sorted(feature_set.sets)
    ]
    return [
        f"CREATE VIEW word_runs AS {' UNION ALL '.join(lists)}",
        f"CREATE VIEW feature_runs AS SELECT s.feature, {run}, "
        f"s.frames / {rate_hz!r}::DOUBLE AS seconds FROM stored_feature_runs AS s",
        *(macro.sql() for macro in MACROS if macro.needs == "index"),
    ]


def lists_table(feature_set: str) -> str:
    """Return the quoted name of the table that holds the word runs of a feature set."""
    return duckdb_sql.identifier(f"stored_word_runs_{feature_set}")


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
    """Return the rows of the view `help`; with `index_only` those of the index file."""
    columns = ("name", "call", "summary", "example")
    rows = help_rows(index_only=index_only)
    return pa.Table.from_pylist([dict(zip(columns, row, strict=True)) for row in rows])
