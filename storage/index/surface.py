"""Make the views and macros of an index as SQL text, and a hash of them: they may change while rows stay valid."""

from __future__ import annotations

import hashlib

from kinedex.catalog.features import FeatureSet
from kinedex.catalog.sql.views import MACROS, help_rows
from kinedex.storage import duck


def surface(feature_set: FeatureSet, rate_hz: float) -> str:
    """Return a hash of the views, macros and help of an index; when it changes, the rows stay valid."""
    text = "\n".join([*index_statements(feature_set, rate_hz), *map(repr, help_rows(index_only=True))])
    return hashlib.sha256(text.encode()).hexdigest()


def index_statements(feature_set: FeatureSet, rate_hz: float) -> list[str]:
    """Return the SQL statements that create the views and macros over the tables of an index."""
    # every column is qualified by its table: a bare name could be taken for an argument of a macro
    run = "s.take_id::BIGINT AS take_id, s.start, s.start + s.frames AS stop"
    lists = [
        f"SELECT {duck.quote(name)} AS feature_set, s.word, {run} FROM {lists_table(name)} AS s"
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
    return duck.identifier(f"stored_word_runs_{feature_set}")
