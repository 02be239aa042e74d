"""`GET /api/store` describes the open store, and returns the names that all pages need.

{name, path, version, takes, hours, rate_hz, read_only, joints: [name], parents: [index or -1],
 features: [{bit, name, group, description}], columns: [{name, type, numeric}], classes: [name],
 stages: {annotate: [name], learn: [name]}, command, python}
"""

from __future__ import annotations

from typing import Any

import pyarrow as pa
from starlette.requests import Request

from kinedex.explorer.answers import command_line, python_lines
from kinedex.explorer.endpoints import get
from kinedex.explorer.open_archive import Archive
from kinedex.ops.body.joint_tree import JOINT_PARENTS
from kinedex.storage.duckdb_sql import sql_type
from kinedex.storage.store.store import Store


def describe(archive: Archive, _request: Request) -> dict[str, Any]:
    """Return the facts about the open store, and the names of its joints, features, columns and classes."""
    store = archive.store()
    seconds = store.take_rows.column("seconds").to_pylist()
    return {
        "name": archive.path.resolve().name,
        "path": str(archive.path.resolve()),
        "version": store.manifest.version,
        "takes": len(seconds),
        "hours": sum(seconds) / 3600,
        "rate_hz": store.rate_hz,
        "read_only": archive.read_only,
        "joints": list(store.feature_set.joints),
        "parents": parents_of(store.feature_set.joints),
        "features": features_of(store),
        "columns": columns_of(store.take_rows.schema),
        "classes": sorted(set(store.take_rows.column("class").to_pylist()) - {None}),
        "stages": {kind: stages_of(store, results) for kind, results in STAGES.items()},
        "command": command_line("kinedex", "takes", "list", archive.path),
        "python": python_lines(archive.path, "store.takes()"),
    }


def parents_of(joints: tuple[str, ...]) -> list[int]:
    """Return the index of each joint's parent, −1 if it is not among the joints."""
    parents = [JOINT_PARENTS.get(joint) for joint in joints]
    return [-1 if parent is None or parent not in joints else joints.index(parent) for parent in parents]


def features_of(store: Store) -> list[dict[str, Any]]:
    """Return the features of the words of a store in the order of their bits."""
    sets = {number: name for name, one in store.feature_set.sets.items() for number in one.numbers}
    return [
        {"bit": one.number - 1, "name": one.name, "group": sets.get(one.number, ""), "description": one.description}
        for one in store.feature_set.features
    ]


STAGES = {"annotate": ("annotations",), "learn": ("templates", "queries")}
"""A dict from the purpose of a stage to the kinds of results that such stages store."""


def stages_of(store: Store, kinds: tuple[str, ...]) -> list[str]:
    """Return the stages whose results of some kinds the store holds, such as `annotate/annotate_takes`."""
    return sorted({part.stage for kind in kinds for part in store.manifest.results.get(kind, ())})


def columns_of(schema: pa.Schema) -> list[dict[str, Any]]:
    """Return the columns of takes with their types in SQL."""
    kinds = ((field.name, sql_type(field.type)) for field in schema)
    return [{"name": name, "type": kind, "numeric": kind in NUMERIC} for name, kind in kinds]


NUMERIC = frozenset({"BIGINT", "INTEGER", "DOUBLE", "FLOAT", "UBIGINT", "SMALLINT", "TINYINT", "UTINYINT"})
"""The types whose values are filtered by ranges."""

routes = [get("/api/store", describe)]
