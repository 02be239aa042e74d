"""The SQL side of a store: one connection on which every view and macro stands."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from catalog.views import MACROS, VIEWS, Macro
from ops.errors import KinedexError, StoreError, did_you_mean
from storage import duck, index
from storage.parts import part_file
from storage.schemas import RESULT_KINDS, frames_schema, result_schema, takes_schema

if TYPE_CHECKING:
    from storage.store import Store

NAMES = tuple(view.name for view in VIEWS) + tuple(macro.name for macro in MACROS)
"""Everything that a query can ask for by name."""

INDEXED = frozenset(view.name for view in VIEWS if view.columns and view.name not in ("features", "help"))
"""The views that exist only with an index."""


def connect(store: Store, threads: int | None = None, memory_mb: int | None = None) -> duck.Connection:
    """Open a connection with all views and macros of a store; nothing that is run on it changes the store.

    The index is attached read-only. Frames and results are read from the parts of this version, wherever the store is.
    Where the index is missing or stale, the views `INDEXED` and the macros over them are left out, and the rest works.
    """
    connection = duck.connect(threads, memory_mb)
    generation = index.current(store.path, store.manifest)
    if generation is not None:
        connection.execute(f"ATTACH {duck.quote(str(generation / 'index.duckdb'))} AS idx (READ_ONLY)")
        connection.execute("USE idx")
    else:
        _without_index(connection, store)
    _view(connection, "help", duck.literal_rows(index.help_table()))
    frames = frames_schema(store.feature_set, store.rate_hz)
    files = [(part_file(store.path, part.path), part.dropped) for part in store.manifest.frames]
    _view(connection, "frames", duck.parquet_rows(frames, files))
    for kind in RESULT_KINDS:
        parts = [(part_file(store.path, part.path), ()) for part in store.manifest.results.get(kind, ())]
        _view(connection, kind, duck.parquet_rows(result_schema(kind), parts))
    for macro in MACROS:
        if macro.needs == "frames" or (generation is None and not _reads_index(macro)):
            connection.execute(macro.sql(temporary=True))
    return connection


def explain_unknown(store: Store, fault: duck.UnknownName) -> KinedexError:
    """Say why a name is not there: it needs the index, or it is nobody's; then with the nearest and with all names."""
    name = fault.name.lower()
    if name in INDEXED or any(macro.name == name and _reads_index(macro) for macro in MACROS):
        return index.missing(store.path)
    if name in NAMES:
        return KinedexError(str(fault))
    near = did_you_mean(fault.name, NAMES)
    return KinedexError(
        f"no view or macro is named '{fault.name}'{near if near.startswith('; did') else ''}\n"
        f"  the views and macros of a store: {', '.join(sorted(NAMES))}"
    )


def _reads_index(macro: Macro) -> bool:
    return any(re.search(rf"\b{view}\b", macro.body) for view in INDEXED)


def _without_index(connection: duck.Connection, store: Store) -> None:
    takes = [(part_file(store.path, part.path), part.dropped) for part in store.manifest.takes]
    _view(connection, "takes", duck.parquet_rows(takes_schema(), takes))
    _view(connection, "features", duck.literal_rows(index.features_table(store)))


def _view(connection: duck.Connection, name: str, query: str) -> None:
    try:
        connection.execute(f"CREATE TEMP VIEW {name} AS {query}")
    except duck.Error as fault:
        connection.close()
        raise StoreError(
            f"the parts of {name} cannot be read: {duck.first_line(fault)}; see `kinedex verify`"
        ) from None
