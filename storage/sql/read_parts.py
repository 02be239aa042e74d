"""Check the parts that a query will read: those behind the views and macros in its parse tree.

The check is needed because DuckDB does not verify the checksums of Parquet files. Parts that the query does not read
are not checked.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator

from kinedex.catalog.sql.views import MACROS, VIEWS
from kinedex.ops.errors import KinedexError
from kinedex.storage import duckdb_sql
from kinedex.storage.snapshot.manifest import Part, ResultPart
from kinedex.storage.snapshot.schemas import RESULT_KINDS
from kinedex.storage.snapshot.snapshot import Snapshot
from kinedex.storage.sql.read_only import Names, names_in
from kinedex.storage.sql.result_scans import ALL_VIEWS, result_parts

_BODIES = {view.name: view.body for view in VIEWS if view.body} | {
    macro.name: macro.body if macro.table else f"SELECT {macro.body}" for macro in MACROS
}
_VIEWS = frozenset((*(view.name for view in VIEWS), *ALL_VIEWS))

_LISTS = re.compile(r"\b(SHOW|DESCRIBE|SUMMARIZE|PRAGMA)\b", re.IGNORECASE)
"""Keywords of statements that may list the views; matching one inside a literal only costs time."""

_read_by: dict[str, frozenset[str]] = {}
"""A dict from the views and macros needed so far to the names in their bodies."""


def check_parts(store: Snapshot, connection: duckdb_sql.Connection, text: str) -> frozenset[str]:
    """Check the parts that a statement reads, unless they were checked before, and return the names that it reads.

    Parameters
    ----------
    store : Snapshot
        The store of the connection.
    connection : Connection
        The connection whose parser is used; the text is not executed.
    text : str
        A statement that `storage.sql.read_only.checked_statement` allows; other statements are ignored here.

    Returns
    -------
    frozenset of str
        Names of the views and macros; all of them for a statement that may list views or show any view's columns.

    Raises
    ------
    StoreError
        A part is missing or damaged; the message names its file.
    """
    try:
        names = names_in(connection, text)
    except KinedexError:
        return frozenset()  # `checked` reports why this statement is refused
    reached = {
        name for name in _reached(connection, names.tables | names.functions) if name in _BODIES or name in _VIEWS
    }
    views = _VIEWS & reached
    parts = [part for view in sorted(views) for part in parts_of(store, view)]
    if _reads_catalogue(names):
        parts += [part for view in sorted(_VIEWS) for part in _described_by(parts_of(store, view))]
        reached = {*_VIEWS, *_BODIES}
    store.checked.parts(parts)
    return frozenset((*_VIEWS, *_BODIES) if _LISTS.search(text) else reached)


def parts_of(store: Snapshot, view: str) -> tuple[Part | ResultPart, ...]:
    """Return the parts that a view reads directly; empty for views of the index and for views over other views."""
    manifest = store.manifest
    if view in RESULT_KINDS or view in ALL_VIEWS:
        return result_parts(store, view)
    return {"frames": manifest.frames, "takes": manifest.takes}.get(view, ())


def _reached(connection: duckdb_sql.Connection, names: Iterable[str]) -> Iterator[str]:
    """Yield names and, for views and macros among them, the names that their bodies read."""
    waiting, seen = list(names), set()
    while waiting:
        name = waiting.pop()
        if name in seen:
            continue
        seen.add(name)
        yield name
        if name in _BODIES:
            if name not in _read_by:
                found = names_in(connection, _BODIES[name])
                _read_by[name] = found.tables | found.functions
            waiting.extend(_read_by[name])


def _reads_catalogue(names: Names) -> bool:
    """Return whether a statement may show the columns of any view."""
    others = (name for name in names.tables - names.own - _VIEWS if re.fullmatch(r"\w+", name))
    return any(others) or any(name.startswith(("duckdb_", "pragma_")) for name in names.functions)


def _described_by(parts: Iterable[Part | ResultPart]) -> Iterator[Part | ResultPart]:
    """Yield the parts from which DuckDB takes the columns of a view: the first part of each scan."""
    scans = {
        (bool(part.dropped_rows), getattr(part, "columns", 0), getattr(part, "stage", "")): part
        for part in reversed(list(parts))
    }
    return iter(scans.values())
